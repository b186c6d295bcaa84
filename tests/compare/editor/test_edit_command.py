"""The command: what cannot be served is refused before any work, in a sentence."""

import importlib.util

import pytest

pytest.importorskip("viser", reason="viser is not installed")


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["spot", "--port", "0"], "--port must be a number from 1 to 65535, but is 0."),
        (["spot", "--code", "-1"], "--code must be at least 0, but is -1."),
        (["spot", "--seed", "-1"], "--seed must be at least 0, but is -1."),
        (["sopt"], "Did you mean spot?"),
        (["there-is-none.obj"], "There is no file there-is-none.obj."),
        (["spot", "--session", "taken"], "taken is a file. Name another."),
    ],
)
def test_what_cannot_be_served_is_refused_in_a_sentence(command, tmp_path, arguments, says):
    (tmp_path / "taken").write_text("")
    ended = command("edit", *arguments, "--no-browser", cwd=tmp_path)
    assert ended.returncode == 2
    assert says in ended.stderr
    assert ended.stdout == ""
    assert not (tmp_path / "results").exists()


def test_without_viser_the_command_says_how_to_install_it(command, tmp_path, monkeypatch):
    found = importlib.util.find_spec
    monkeypatch.setattr("compare.commands.edit.find_spec", lambda name: None if name == "viser" else found(name))
    ended = command("edit", "spot", cwd=tmp_path)
    assert ended.returncode == 2
    assert 'pip install "implicit-vs-mesh[editor]"' in ended.stderr


@pytest.mark.parametrize(("host", "warned"), [("127.0.0.1", False), ("0.0.0.0", True)])
def test_the_command_serves_until_it_is_interrupted(command, shape_file, tmp_path, monkeypatch, host, warned):
    asked = []

    class Page:
        address = "http://127.0.0.1:8123"

        def __init__(self, session, *, host, port):
            asked.append((host, port))

        def stop(self):
            asked.append("stopped")

    def interrupted(seconds):
        raise KeyboardInterrupt

    monkeypatch.setattr("compare.editor.page.EditorPage", Page)
    monkeypatch.setattr("compare.commands.edit.time.sleep", interrupted)
    monkeypatch.setattr("webbrowser.open", lambda address: asked.append(address))
    options = ["--port", "8123", "--session", "kept", *(["--host", host] if warned else [])]
    ended = command("edit", shape_file, *options, cwd=tmp_path)
    assert ended.returncode == 0
    assert asked == [(host, 8123), "http://127.0.0.1:8123", "stopped"]
    assert ended.stdout.split() == ["http://127.0.0.1:8123"]
    assert ("warning" in ended.stderr) == warned
    assert (tmp_path / "kept" / "session.json").is_file()
