"""The page in a headless browser: pick, drag, let go, undo and export by mouse, with nothing asked of other hosts."""

import io
import socket
import threading
from urllib.parse import urlparse

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from compare.editor import EditSession, Motion, Settings, ball
from compare.editor.worker import Worker

pytest.importorskip("viser", reason="viser is not installed")
VIEW = {"x": 0, "y": 0, "width": 520, "height": 480}  # left of the controls
NOTICE = 170  # height of what the browser says of itself, at the upper left


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def served(session):
    from compare.editor.page import EditorPage

    page = EditorPage(session, port=free_port())
    yield page
    page.stop()


@pytest.fixture
def editor(bulb):
    yield from served(bulb)


@pytest.fixture
def cow(tmp_path):
    """A network, whose edits are local, drawn coarsely."""
    yield from served(EditSession.open("spot", tmp_path / "cow", settings=Settings(points=250), drawn=24))


class Hand:
    """A page in a browser, with what it said and asked for, and a mouse that knows where things of the scene are."""

    def __init__(self, browser, editor):
        self.editor, self.said, self.asked = editor, [], []
        self.page = browser.new_page(viewport={"width": 900, "height": 480})
        self.page.set_default_timeout(120_000)
        self.page.on("console", lambda message: self.said.append((message.type, message.text)))
        self.page.on("pageerror", lambda error: self.said.append(("error", str(error))))
        self.page.on("request", lambda request: self.asked.append(request.url))
        self.page.on("websocket", lambda socket: self.asked.append(socket.url))
        self.page.goto(editor.address)
        self.until(lambda: editor.server.get_clients())
        self.until(lambda: self.camera.image_width < 800)  # the controls have taken their place at the side
        self.page.wait_for_timeout(1500)

    @property
    def camera(self):
        return next(iter(self.editor.server.get_clients().values())).camera

    def until(self, true, seconds=60):
        for _ in range(int(seconds / 0.05)):
            if true():
                return
            self.page.wait_for_timeout(50)
        raise AssertionError(f"nothing came of it: {self.editor.controls.status.content}")

    def settled(self):
        self.until(lambda: self.editor.worker.wait(0.01))
        self.page.wait_for_timeout(700)

    def at(self, place):
        camera = self.camera
        w, x, y, z = camera.wxyz
        seen = Rotation.from_quat([x, y, z, w]).inv().apply(np.asarray(place) - camera.position)
        half = np.tan(camera.fov / 2)
        across, down = seen[0] / seen[2] / half / camera.aspect, seen[1] / seen[2] / half
        return (across + 1) / 2 * camera.image_width, (down + 1) / 2 * camera.image_height

    def nearest(self):
        surface, camera = self.editor.session.surface, self.camera
        away = camera.position - surface.V
        distance = np.linalg.norm(away, axis=1)
        turned = (surface.N * away).sum(axis=1) / distance
        return surface.V[np.argmin(distance + 100 * (turned < 0.8))]

    def click(self, place):
        x, y = self.at(place)
        self.page.mouse.move(x, y)
        self.page.wait_for_timeout(150)
        self.page.mouse.click(x, y)

    def drag_gizmo(self, length, moves=8):
        """Take the upward arrow of the gizmo up by a length."""
        grip = np.array(self.editor.session.regions[0].grip)
        arrow = np.array([0.0, 0.12 * self.editor.session.field.size, 0.0])
        start, end = self.at(grip + arrow), self.at(grip + arrow + [0.0, length, 0.0])
        self.page.mouse.move(*start)
        self.page.wait_for_timeout(500)
        self.page.mouse.down()
        for k in range(1, moves + 1):
            self.page.mouse.move(*(np.array(start) + k / moves * (np.array(end) - np.array(start))))
            self.page.wait_for_timeout(30)

    def press(self, name):
        self.page.get_by_role("button", name=name, exact=True).click()

    def picture(self):
        from PIL import Image

        drawn = self.page.screenshot(clip=VIEW)
        return np.asarray(Image.open(io.BytesIO(drawn)).convert("L"), dtype=float)[NOTICE:]


def changed(one, other):
    return np.abs(one - other) > 24


def test_a_shape_is_picked_dragged_edited_undone_and_exported_by_mouse(browser, cow):
    editor, session = cow, cow.session
    start = session.field.theta.clone()
    hand = Hand(browser, editor)
    try:
        first = hand.picture()
        assert changed(first, np.full_like(first, first[-1, 0])).mean() > 0.02  # there is a shape on the page
        place = hand.nearest()
        hand.click(place)
        hand.until(lambda: session.regions)
        assert np.linalg.norm(np.array(session.regions[0].grip) - place) < 0.1
        hand.settled()
        assert "will be missed" in editor.controls.status.content

        hand.drag_gizmo(0.15)
        hand.until(lambda: editor.frames > 0)
        assert torch.equal(session.field.theta, start)  # frames are shown, and nothing is edited yet
        hand.page.mouse.up()
        hand.until(lambda: session.history)
        hand.settled()
        (entry,) = session.history
        assert entry.handles[0].motion["vector"][1] == pytest.approx(0.15, abs=0.05)
        assert (session.folder / "session.json").is_file()
        value = session.field.value(torch.tensor([session.regions[0].grip], dtype=torch.float32))
        assert abs(float(value)) < 1e-5
        np.testing.assert_allclose(editor._gizmo.position, session.regions[0].grip, atol=1e-6)  # back on the surface

        hand.press("Forget regions")
        hand.settled()
        edited = hand.picture()
        x, y = hand.at(place)
        there = changed(first, edited)
        rows, columns = np.nonzero(there)
        assert there.mean() > 0.003
        size = abs(hand.at(place + np.array([0.0, 0.4, 0.0]))[1] - y)
        near = np.hypot(columns - x, rows + NOTICE - y) < size
        assert near.mean() > 0.8  # where it was dragged, and hardly elsewhere

        hand.press("Undo")
        hand.until(lambda: session.position == 0)
        hand.settled()
        assert torch.equal(session.field.theta, start)
        assert changed(first, hand.picture()).mean() < 0.3 * there.mean()
        hand.press("Redo")
        hand.until(lambda: session.position == 1)

        hand.page.get_by_text("Export", exact=True).click()
        with hand.page.expect_download() as download:
            hand.press("Download")
        exported = session.folder / "exports" / download.value.suggested_filename
        hand.until(exported.is_file)
        assert exported.suffix == ".obj"

        assert [text for kind, text in hand.said if kind == "error"] == []
        hosts = {urlparse(url.removeprefix("blob:")).hostname for url in hand.asked if not url.startswith("data:")}
        assert hosts == {"127.0.0.1"}
    finally:
        hand.page.close()


@pytest.mark.nightly
def test_a_lost_connection_loses_no_edit_and_a_new_page_shows_it(browser, editor):
    session = editor.session
    hand = Hand(browser, editor)
    session.pick(ball(hand.nearest(), 0.1, 0.1))
    editor.worker.do(lambda: editor._edit(Motion(along=0.02)))
    hand.page.close()
    assert editor.worker.wait(60)
    assert len(session.history) == 1
    assert torch.equal(EditSession.load(session.folder, drawn=session.drawn).field.theta, session.field.theta)
    again = Hand(browser, editor)
    try:
        assert again.page.get_by_text("geometric 1").first.is_visible()
    finally:
        again.page.close()


def test_the_page_listens_on_the_loopback_address_alone(editor):
    """On Linux all of 127.0.0.0/8 is this machine: a server on all interfaces would answer at 127.0.0.2 too."""
    port = urlparse(editor.address).port
    assert editor.server.get_host() == "127.0.0.1"
    socket.create_connection(("127.0.0.1", port), timeout=10).close()
    with pytest.raises(OSError):
        socket.create_connection(("127.0.0.2", port), timeout=10).close()


def test_refusals_are_sentences_on_the_page_and_the_next_drag_works(editor):
    session = editor.session
    editor.worker.do(editor._undo)
    assert editor.worker.wait(10)
    assert editor.controls.status.content == "**Not done.** There is nothing to undo."
    session.pick(ball(session.surface.V[0], 0.1, 0.1))
    editor.worker.do(lambda: editor._edit(Motion(translation=(40.0, 0.0, 0.0))))
    assert editor.worker.wait(60)
    assert "out of the field's bounds" in editor.controls.status.content
    assert not editor.controls.progress.visible
    editor.worker.show(lambda: editor._frame(Motion(along=0.01)))
    assert editor.worker.wait(60)
    assert editor.frames == 1
    editor.worker.do(lambda: editor._export(None))
    assert editor.worker.wait(60)
    assert (session.folder / "exports").is_dir()


def test_of_the_frames_that_wait_only_the_newest_is_shown():
    done, failed, gate = [], [], threading.Event()
    worker = Worker(failed.append)
    worker.do(gate.wait)
    for k in range(5):
        worker.show(lambda k=k: done.append(k))
    gate.set()
    assert worker.wait(10)
    assert done == [4]
    gate.clear()
    worker.do(gate.wait)
    worker.show(lambda: done.append("stale"))
    worker.do(lambda: 1 / 0)  # frames before a job are of what it changes
    worker.when_idle(lambda: done.append("idle"))
    gate.set()
    assert worker.wait(10)
    assert done == [4, "idle"]
    assert [type(error) for error in failed] == [ZeroDivisionError]
    worker.stop()
