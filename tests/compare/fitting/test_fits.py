"""The table of fits is made of reports, row by row."""

from functools import partial

import pytest

import meshref
from compare.fitting.fit import fit_mesh
from compare.fitting.fits import COLUMNS, main, table


@pytest.mark.nightly
def test_a_folder_of_meshes_becomes_a_table(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("compare.fitting.fits.fit_mesh", partial(fit_mesh, steps=600))
    V, F = meshref.icosphere(3, radius=2.0)
    meshref.write_mesh(tmp_path / "ball.obj", V, F)
    (tmp_path / "cut.off").write_text("OFF\n4 2 0\n0 0 0\n")  # named, and costs the others nothing
    output = tmp_path / "docs" / "fits.md"
    assert main([str(tmp_path), "--widths", "16", "-o", str(output)]) == 0
    line = next(x for x in output.read_text().splitlines() if x.startswith("| ball.obj"))
    cells = [x.strip() for x in line.strip("|").split("|")]
    assert len(cells) == len(COLUMNS)
    assert float(cells[2]) < 0.4  # mean distance in per cent of the diagonal
    assert cells[7] == "0 (0)"
    printed = capsys.readouterr()
    assert line.strip("| ") in printed.out
    assert "cut.off is left out: " in printed.err


def test_an_empty_folder_is_refused(tmp_path, capsys):
    assert main([str(tmp_path)]) == 2
    assert "There is no mesh in" in capsys.readouterr().err


def test_the_table_is_markdown():
    assert table([["a"] * len(COLUMNS)]).splitlines()[1].count("---") == len(COLUMNS)
