"""The tables of results are just what the command makes of the findings that are kept beside them."""

import dataclasses
import re
import shutil
from pathlib import Path

import pytest

from compare.paper import PARTS, Finding, Measured
from compare.paper.findings import FILE, read_measured, write_measured
from compare.paper.readme_table import FIRST, first_section, main, section, with_section

ROOT = Path(__file__).resolve().parents[3]
RESULTS = ROOT / "docs" / "results.json"
PAGE = ROOT / "docs" / "results.md"


@pytest.fixture(scope="module")
def kept():
    return read_measured(RESULTS)


def test_the_tables_are_what_the_command_makes_of_the_findings(tmp_path):
    pages = {"--readme": ROOT / "README.md", "--page": PAGE}
    options = [word for option, page in pages.items() for word in (option, shutil.copy(page, tmp_path))]
    assert main([*options, "--results", str(RESULTS)]) == 0
    for page in pages.values():
        assert (tmp_path / page.name).read_text(encoding="utf-8") == page.read_text(encoding="utf-8")


def test_the_first_page_has_each_of_its_rows(kept):
    rows = [line.split(" | ")[1] for line in first_section(kept).splitlines() if line.startswith("| ")]
    assert sorted(rows[1:]) == sorted(FIRST)


def test_another_finding_makes_another_table(kept):
    text = PAGE.read_text(encoding="utf-8")
    (part,) = (part for part in kept if part.part == "basis")
    found = dataclasses.replace(next(f for f in part.findings if f.headline), ours=2274)
    changed = [dataclasses.replace(part, findings=(found,)) if old is part else old for old in kept]
    assert with_section(text, section(changed)) != text


def test_the_findings_are_at_full_settings_and_the_page_names_the_parts_that_have_none(kept):
    text = " ".join(PAGE.read_text(encoding="utf-8").split())
    said = re.search(r"Not measured yet: ([\w, ]+)\.", text)
    missing = said[1].split(", ") if said else []
    names = [part.part for part in kept]
    assert sorted([*names, *missing]) == sorted(PARTS)
    assert names == [name for name in PARTS if name in names]
    assert not any(part.quick for part in kept)
    assert all(part.settings == kept[0].settings for part in kept)
    assert {"bunny.off", "cactus.off", "rocker-arm.obj"} <= set(kept[0].settings["meshes"])
    assert all(finding.part == part.part for part in kept for finding in part.findings)


def test_every_finding_names_its_unit_and_says_why_where_it_differs_from_the_paper(kept):
    findings = [finding for part in kept for finding in part.findings]
    assert [f.what for f in findings if not re.search(r" \[[^\[\]]+\]$", f.what)] == []
    apart = [f for f in findings if isinstance(f.paper, float | int) and abs(f.ours - f.paper) > 0.05 * abs(f.paper)]
    assert apart
    assert [f.what for f in apart if not f.note.endswith(".")] == []
    assert len({f.what for f in findings}) == len(findings)


def made(part, settings):
    where = {"time": "2026-01-02T03:04:05+00:00", "processor": "abacus", "cores": 2, "threads": 1}
    return Measured(part, (Finding(part, "beads [count]", 7, headline=True),), settings, where, 3600.0, 1800.0)


@pytest.fixture
def page(tmp_path):
    """A page with room for the table, and options that name it."""
    for source in (ROOT / "README.md", PAGE):
        text = with_section(source.read_text(encoding="utf-8"), "nothing yet")
        (tmp_path / source.name).write_text(text, encoding="utf-8")
    path = tmp_path / PAGE.name
    options = ["--readme", tmp_path / "README.md", "--page", path, "--results", tmp_path / "results.json"]
    return path, [str(option) for option in options]


def test_parts_are_taken_over_folder_by_folder_and_newer_ones_take_the_place_of_older(page, tmp_path):
    settings = {"quick": False, "seed": 0, "meshes": {}}
    parts = [made(name, settings) for name in PARTS]
    path, options = page
    write_measured([dataclasses.replace(part, seconds=9.0) for part in parts[:4]], tmp_path / "a" / FILE)
    assert main([str(tmp_path / "a"), *options]) == 0
    assert f"Not measured yet: {', '.join(list(PARTS)[4:])}." in " ".join(path.read_text(encoding="utf-8").split())
    write_measured(parts, tmp_path / "b" / FILE)
    assert main([str(tmp_path / "b"), *options]) == 0
    assert read_measured(tmp_path / "results.json") == parts
    text = " ".join(path.read_text(encoding="utf-8").split())
    assert "Not measured yet" not in text
    assert "| rope | beads [count] | | 7 | |" in text
    assert f"2026-01-02; abacus, 2 cores, 1 thread; {len(PARTS)}.0 h by the clock" in text


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [(None, "holds no findings"), ({"quick": True}, "are quick ones"), ({"seed": 1}, "other settings")],
)
def test_what_is_not_for_showing_is_refused_and_nothing_is_written(settings, sentence, page, tmp_path, capsys):
    usual = {"quick": False, "seed": 0, "meshes": {}}
    write_measured([made("basis", usual)], tmp_path / "results.json")
    if settings is not None:
        write_measured([made("rope", {**usual, **settings})], tmp_path / FILE)
    path, options = page
    before = path.read_bytes(), (tmp_path / "results.json").read_bytes()
    assert main([str(tmp_path), *options]) == 2
    assert sentence in capsys.readouterr().err
    assert (path.read_bytes(), (tmp_path / "results.json").read_bytes()) == before


def test_a_page_without_room_for_the_table_is_refused(tmp_path, capsys):
    (tmp_path / "README.md").write_text("# Nothing\n")
    assert main(["--readme", str(tmp_path / "README.md"), "--page", str(PAGE), "--results", str(RESULTS)]) == 2
    assert "must hold <!-- results" in capsys.readouterr().err
