"""The parts of the paper as a whole: what is kept, what is made again, and what the user is told meanwhile."""

import sys
from types import SimpleNamespace

import pytest

from compare.errors import InputError
from compare.paper import PARTS, Finding, Request, draw_parts
from compare.paper.findings import FILE, Measured, read_measured, table, write_measured


@pytest.fixture
def drawn(monkeypatch):
    """Parts that do nothing but count: the name of each that is drawn, in order. "smoothing" may be told to fail."""
    names = []

    def part(name):
        def draw(request):
            names.append(name)
            if name == "smoothing" and names.count(name) == 1:
                raise FloatingPointError("lost")
            return [Finding(name, f"how often it was drawn, seed {request.seed} [count]", float(names.count(name)))]

        return SimpleNamespace(draw=draw)

    for name in PARTS:
        monkeypatch.setitem(sys.modules, f"compare.paper.{name}", part(name))
    return names


def test_a_part_made_again_takes_its_place_and_the_others_stay(drawn, tmp_path):
    draw_parts(Request(tmp_path), ["rope", "basis"])
    (again,) = draw_parts(Request(tmp_path, seed=5), ["rope"])
    kept = read_measured(tmp_path / FILE)
    assert [part.part for part in kept] == ["basis", "rope"]  # in the order of the paper
    assert [part.settings["seed"] for part in kept] == [0, 5]
    assert kept[1].findings == (again,)
    assert (tmp_path / "findings.md").read_text() == table(kept)


def test_to_resume_is_to_make_only_what_the_folder_has_not_with_these_settings(drawn, tmp_path):
    with pytest.raises(FloatingPointError):
        draw_parts(Request(tmp_path), ["basis", "smoothing", "rigid"])
    assert drawn == ["basis", "smoothing"]
    findings = draw_parts(Request(tmp_path), ["basis", "smoothing", "rigid"], resume=True)
    assert drawn == ["basis", "smoothing", "smoothing", "rigid"]
    assert [finding.part for finding in findings] == ["basis", "smoothing", "rigid"]
    draw_parts(Request(tmp_path, quick=True), ["basis"], resume=True)
    assert drawn[4:] == ["basis"]


def test_another_mesh_in_the_folder_is_another_setting(drawn, tmp_path):
    meshes = tmp_path / "meshes"
    meshes.mkdir()
    (meshes / "bunny.off").write_text("one")
    request = Request(tmp_path, meshes)
    draw_parts(request, ["basis"])
    draw_parts(request, ["basis"], resume=True)
    assert drawn == ["basis"]
    (meshes / "bunny.off").write_text("another")
    draw_parts(request, ["basis"], resume=True)
    assert drawn == ["basis", "basis"]


def test_the_user_is_told_which_part_runs_and_what_is_left(drawn, monkeypatch, tmp_path):
    """On a machine where each part takes half as long as it did where the costs were noted."""
    parts = ["basis", "geometric", "rigid"]
    monkeypatch.setattr("compare.paper.perf_counter", lambda: 0.5 * sum(PARTS[name][1] for name in drawn))
    told = []
    draw_parts(Request(tmp_path), parts, progress=lambda *row: told.append(row))
    left = [sum(PARTS[part][1] for part in parts[k:]) / 60 for k in range(3)]
    assert told == [
        (0, 3, f"basis, about {left[0]:.0f} min left"),  # nothing is known yet of this machine
        (1, 3, f"geometric, about {left[1] / 2:.0f} min left"),
        (2, 3, f"rigid, about {left[2] / 2:.0f} min left"),
        (3, 3, "done"),
    ]


def test_a_table_says_which_findings_are_quick_and_keeps_its_columns():
    found = Finding("rope", "int |b| [length]", 0.12345678, "under 15", "A note.", True)
    others = [Finding("rope", "lost [count]", None), Finding("rope", "left [count]", 2, note="Another.")]
    again = Finding("rope", "turns [count]", 1, note="A note.")
    measured = [Measured("rope", (found, *others, again), {"quick": q}, {}, 1.0, 1.0) for q in (False, True)]
    full, quick = table(measured[:1]).splitlines()[2:], table(measured[1:], headlines=True).splitlines()[2:]
    rows, notes = full[:4], full[4:]
    assert rows[0] == "| rope | int \\|b\\| [length] | under 15 | 0.1235 | 1 |"
    assert rows[1] == "| rope | lost [count] |  |  |  |"
    assert [row.split(" | ")[-1] for row in rows[2:]] == ["2 |", "1 |"]
    assert notes == ["", "Notes:", "", "1. A note.", "2. Another."]
    assert quick == ["| rope (quick) | int \\|b\\| [length] | under 15 | 0.1235 | 1 |", *notes[:4]]


def test_what_json_has_no_words_for_is_kept_as_nothing(tmp_path):
    settings = {"quick": False}
    part = Measured("rope", (Finding("rope", "κ² [1/length²]", float("nan")),), settings, {}, 1.0, 1.0)
    write_measured([part], tmp_path / FILE)
    (back,) = read_measured(tmp_path / FILE)
    assert back.findings == (Finding("rope", "κ² [1/length²]", None),)
    assert back.settings == settings


@pytest.mark.parametrize("content", ["[]", "{}", '{"schema": 1, "par', '{"schema": 2, "parts": []}'])
def test_a_file_of_something_else_is_refused_and_stays(content, drawn, tmp_path):
    (tmp_path / FILE).write_text(content)
    with pytest.raises(ValueError, match="holds no findings of `paper` that can be read"):
        draw_parts(Request(tmp_path), ["basis"])
    assert drawn == []
    assert (tmp_path / FILE).read_text() == content


def test_a_mesh_that_cannot_be_used_is_refused_before_any_work(tmp_path):
    with pytest.raises(InputError, match="holds none of bunny"):
        Request(tmp_path, tmp_path).check()
    (tmp_path / "rocker-arm.obj").write_text("nothing")
    with pytest.raises(InputError, match="rocker-arm"):
        Request(tmp_path, tmp_path).check()


def test_the_command_refuses_an_output_that_holds_something_else(command, tmp_path):
    (tmp_path / FILE).write_text("[]")
    result = command("paper", "basis", "--quick", "-o", tmp_path, cwd=tmp_path)
    assert result.returncode == 2
    assert result.stdout == ""
    assert "holds no findings of `paper`" in result.stderr
