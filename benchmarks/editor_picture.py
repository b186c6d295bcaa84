"""The animated picture of docs/editor.md: a region picked on the cow, dragged, let go, and what was missed in colours.

    python benchmarks/editor_picture.py [docs/editor.webp]

It is made of what a headless Chromium shows, with the pointer drawn in, for a browser's own is on no picture.
"""

import io
import shutil
import sys
import time

import numpy as np
from PIL import Image, ImageDraw
from playwright.sync_api import sync_playwright

from benchmarks.editor_pace import FLAGS, facing, on_screen
from compare.editor.page import EditorPage
from compare.editor.session import EditSession
from compare.editor.tools import Settings

SIZE = {"width": 1100, "height": 640}
WIDTH = 800
POINTER = [(0, 0), (0, 17), (4, 13), (7, 20), (10, 19), (7, 12), (12, 12)]


class Film:
    """Pictures of a page and how long each is shown."""

    def __init__(self, page):
        self.page, self.pictures, self.lasts = page, [], []

    def shot(self, milliseconds, pointer):
        """Add a picture with the pointer in it."""
        picture = Image.open(io.BytesIO(self.page.screenshot())).convert("RGB")
        outline = [(pointer[0] + x, pointer[1] + y) for x, y in POINTER]
        ImageDraw.Draw(picture).polygon(outline, fill=(20, 20, 20), outline=(255, 255, 255))
        height = round(picture.height * WIDTH / picture.width)
        self.pictures.append(picture.resize((WIDTH, height), Image.Resampling.LANCZOS))
        self.lasts.append(milliseconds)

    def write(self, path):
        """Write the film, which begins anew at its end."""
        first, *rest = self.pictures
        first.save(path, save_all=True, append_images=rest, duration=self.lasts, loop=0, quality=80, method=6)


def until(page, true):
    """Wait until something is so, a minute at most."""
    end = time.monotonic() + 60
    while not true():
        if time.monotonic() > end:
            raise SystemExit("The page did not come to it within a minute.")
        page.wait_for_timeout(50)


def filmed(editor, page):
    """Return the film of one drag."""
    page.goto(editor.address)
    until(page, editor.server.get_clients)
    page.wait_for_timeout(4000)
    page.locator("text=Software WebGL rendering detected").locator("xpath=ancestor::*[.//button][1]").locator(
        "button"
    ).first.click()
    page.wait_for_timeout(800)
    camera, session, film = next(iter(editor.server.get_clients().values())).camera, editor.session, Film(page)
    place = facing(session.surface, camera)
    at = on_screen(camera, place)
    film.shot(900, at)
    page.mouse.move(*at)
    page.wait_for_timeout(300)
    page.mouse.click(*at)
    until(page, lambda: session.regions and not editor.worker.waiting)
    page.wait_for_timeout(800)
    film.shot(1200, at)
    grip, size = np.array(session.regions[0].grip), session.field.size
    start = np.array(on_screen(camera, grip + np.array([0.0, 0.12 * size, 0.0])))
    end = np.array(on_screen(camera, grip + np.array([0.0, 0.19 * size, 0.0])))
    page.mouse.move(*start)
    page.wait_for_timeout(800)
    film.shot(500, start)
    page.mouse.down()
    for share in np.linspace(0.1, 1.0, 10):
        hand = start + share * (end - start)
        page.mouse.move(*hand)
        page.wait_for_timeout(400)
        film.shot(110, hand)
    page.mouse.up()
    until(page, lambda: session.history)
    page.wait_for_timeout(800)
    film.shot(900, hand)
    until(page, lambda: editor.worker.wait(0.01))
    page.wait_for_timeout(800)
    film.shot(1500, hand)
    editor.controls.view.value = "achieved minus wanted"
    editor.worker.do(editor._recolour)
    until(page, lambda: editor.worker.wait(0.01))
    page.wait_for_timeout(1000)
    film.shot(2500, hand)
    return film


def main():
    """Make the picture."""
    path = sys.argv[1] if len(sys.argv) > 1 else "docs/editor.webp"
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    editor = EditorPage(EditSession.open("spot", settings=Settings(points=1000)), port=8766)
    editor.controls.points.value = "1000"
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=chromium, headless=True, args=FLAGS)
        page = browser.new_page(viewport=SIZE)
        page.set_default_timeout(120_000)
        film = filmed(editor, page)
        browser.close()
    editor.stop()
    film.write(path)


if __name__ == "__main__":
    main()
