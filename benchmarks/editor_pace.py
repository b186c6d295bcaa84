"""Pace of the editor's page in a real browser: how long a frame of a drag, a pick and an edit take.

    python benchmarks/editor_pace.py [SHAPE ...] [--frames N] [--json FILE]

It needs Chromium and playwright (extra "test"). The hand is a mouse on the gizmo. A frame counts from the message that
the browser sends of a drag to the message with new vertices that it gets back, both by the browser's own clock; the
hand waits for the frame before it goes on, so that each has its own drag. "ready" is from a click to the linear model
being there, "edit" from the release to the edited surface being sent; both by the clock of this process.
"""

import argparse
import json
import shutil
import statistics
import time

import numpy as np
from playwright.sync_api import sync_playwright
from scipy.spatial.transform import Rotation

from compare.editor.page import EditorPage
from compare.editor.session import EditSession

FLAGS = ["--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking"]
FLAGS += ["--disable-component-update", "--disable-sync"]
SIZE = {"width": 1000, "height": 600}
MESH = 10_000  # bytes above which a message to the browser holds vertices


def on_screen(camera, place):
    """Return where a place of the scene is on the page, in pixels."""
    w, x, y, z = camera.wxyz
    seen = Rotation.from_quat([x, y, z, w]).inv().apply(np.asarray(place) - camera.position)
    half = np.tan(camera.fov / 2)
    across, down = seen[0] / seen[2] / half / camera.aspect, seen[1] / seen[2] / half
    return (across + 1) / 2 * camera.image_width, (down + 1) / 2 * camera.image_height


def facing(surface, camera):
    """Return the place of a surface that faces the camera and is nearest to it."""
    away = camera.position - surface.V
    distance = np.linalg.norm(away, axis=1)
    turned = (surface.N * away).sum(axis=1) / distance
    return surface.V[np.argmin(distance + 100 * (turned < 0.8))]


def paced(shape, frames, browser):
    """Return the measures of a shape."""
    session = EditSession.open(shape)
    editor = EditorPage(session, port=8765)
    page = browser.new_page(viewport=SIZE)
    page.set_default_timeout(120_000)
    sent, got = [], []
    listen(page, sent, got)
    try:
        page.goto(editor.address)
        while not editor.server.get_clients():
            page.wait_for_timeout(100)
        page.wait_for_timeout(4000)
        camera = next(iter(editor.server.get_clients().values())).camera
        place = facing(session.surface, camera)
        x, y = on_screen(camera, place)
        page.mouse.move(x, y)
        page.wait_for_timeout(300)
        begin = time.perf_counter()
        page.mouse.click(x, y)
        while not session.regions or editor.worker.waiting:
            page.wait_for_timeout(5)
        ready = time.perf_counter() - begin
        up = np.array([0.0, 0.12 * session.field.size, 0.0])
        start, end = (
            on_screen(camera, session.regions[0].grip + up),
            on_screen(camera, session.regions[0].grip + 1.3 * up),
        )
        page.mouse.move(*start)
        page.wait_for_timeout(800)
        sent.clear(), got.clear()
        page.mouse.down()
        k = 0
        while editor.frames < frames and k < 20 * frames:
            share = 0.5 - 0.5 * np.cos(k / 8)
            before, until = editor.frames, time.perf_counter() + 2
            page.mouse.move(*(np.array(start) + share * (np.array(end) - np.array(start))))
            while editor.frames == before and time.perf_counter() < until:
                page.wait_for_timeout(2)
            page.wait_for_timeout(15)
            k += 1
        page.wait_for_timeout(500)
        drags = [at for at, _ in sent]
        meshes = [at for at, size in got if size > MESH]
        taken = []
        for at, last in zip(meshes, [0.0, *meshes]):
            own = [drag for drag in drags if last < drag < at]
            taken += [1000 * (at - own[0])] if own else []
        shown, number = editor.frames, len(session.history)
        begin = time.perf_counter()
        page.mouse.up()
        while len(session.history) == number and time.perf_counter() - begin < 60:
            page.wait_for_timeout(5)
        edited = time.perf_counter() - begin
        editor.worker.wait(60)
    finally:
        page.close()
        editor.stop()
    return {
        "shape": shape,
        "frames": len(taken),
        "shown": shown,
        "preview_ms_median": statistics.median(taken) if taken else None,
        "preview_ms_90": float(np.quantile(taken, 0.9)) if taken else None,
        "ready_s": ready,
        "edit_s": edited if len(session.history) > number else None,
        "edit_loop_s": session.history[-1].seconds if session.history else None,
    }


def listen(page, sent, got):
    """Note time and bytes of each message of the page's worker, which holds the connection."""
    wire = page.context.new_cdp_session(page)
    wire.on(
        "Target.attachedToTarget",
        lambda m: wire.send(
            "Target.sendMessageToTarget",
            {"sessionId": m["sessionId"], "message": json.dumps({"id": 1, "method": "Network.enable"})},
        ),
    )

    def told(event):
        message = json.loads(event["message"])
        notes = {"Network.webSocketFrameSent": sent, "Network.webSocketFrameReceived": got}.get(message.get("method"))
        if notes is not None:
            content = message["params"]
            notes.append((content["timestamp"], len(content["response"]["payloadData"]) * 3 // 4))  # in base 64

    wire.on("Target.receivedMessageFromTarget", told)
    wire.send("Target.setAutoAttach", {"autoAttach": True, "waitForDebuggerOnStart": False, "flatten": False})


def main():
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("shapes", nargs="*", default=["spot", "cactus", "bracket"])
    parser.add_argument("--frames", type=int, default=100)
    parser.add_argument("--json")
    options = parser.parse_args()
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=chromium, headless=True, args=FLAGS)
        rows = []
        for shape in options.shapes:
            rows.append(paced(shape, options.frames, browser))
            print(json.dumps(rows[-1]), flush=True)
        browser.close()
    if options.json:
        with open(options.json, "w") as file:
            json.dump(rows, file, indent=1)


if __name__ == "__main__":
    main()
