"""The report opens from disk in a browser, alone: views are drawn, cameras are linked, nothing is asked of outside."""

import dataclasses
import re
import shutil
from html.parser import HTMLParser

import pytest

from compare import Record, report

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
FLAGS = ["--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking"]
FLAGS += ["--disable-component-update", "--disable-sync"]


@pytest.fixture(scope="module")
def browser():
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    if CHROMIUM is None:
        pytest.skip("there is no Chromium on this machine")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, headless=True, args=FLAGS)
        yield browser
        browser.close()


@pytest.fixture
def opened(browser, small_run):
    """The report in a window too small for all cases, with what it said and asked for."""
    page = browser.new_page(viewport={"width": 1200, "height": 700})
    said, asked = [], []
    page.on("console", lambda message: said.append((message.type, message.text)))
    page.on("pageerror", lambda error: said.append(("error", str(error))))
    page.on("request", lambda request: asked.append(request.url))
    page.goto((small_run.folder / "report.html").as_uri())
    yield page, said, asked
    page.close()


def show(page, number):
    page.evaluate(f"document.getElementById('case-{number}').scrollIntoView()")
    page.wait_for_function(f"document.getElementById('case-{number}').dataset.drawn === 'yes'", timeout=60_000)


# The brightest and the darkest value of a view's drawing buffer, read in the frame in which it is drawn.
COLOURS_DRAWN = """number => new Promise(done => {
  const panes = document.querySelectorAll(`#case-${number} .pane`);
  Promise.all(Array.from(panes, pane => Plotly.toImage(pane, {format: "png", width: 200, height: 200}).then(url => {
    const picture = new Image();
    return new Promise(ready => { picture.onload = () => {
      const canvas = document.createElement("canvas"); canvas.width = canvas.height = 200;
      const context = canvas.getContext("2d"); context.drawImage(picture, 0, 0);
      const pixels = context.getImageData(0, 0, 200, 200).data, seen = new Set();
      for (let k = 0; k < pixels.length; k += 4) if (pixels[k + 3] > 0) seen.add(pixels.slice(k, k + 3).join());
      ready(seen.size);
    }; picture.src = url; });
  }))).then(done);
})"""


def test_every_view_is_drawn_without_an_error_or_an_outside_request(opened, small_run):
    page, said, asked = opened
    for number in range(len(small_run.records)):
        show(page, number)
        colours = page.evaluate(COLOURS_DRAWN, number)
        assert len(colours) == 3
        assert min(colours) > 20, "a view is blank"
    assert [text for kind, text in said if kind == "error"] == []
    assert [url for url in asked if not url.startswith(("file:", "data:", "blob:"))] == []


def test_views_are_dropped_when_they_leave_the_window(opened, small_run):
    page, _, _ = opened
    last = len(small_run.records) - 1
    show(page, 0)
    show(page, last)
    page.wait_for_function("document.getElementById('case-0').dataset.drawn === 'no'", timeout=60_000)
    assert page.locator("#case-0 canvas").count() == 0
    show(page, 0)
    assert page.locator("#case-0 canvas").count() >= 3


def test_turning_one_view_turns_the_others_of_its_case(opened):
    page, _, _ = opened
    show(page, 0)
    box = page.locator("#case-0 .pane").nth(1).bounding_box()
    eyes = """() => Array.from(document.querySelectorAll("#case-0 .pane"),
        pane => { const eye = pane._fullLayout.scene.camera.eye; return [eye.x, eye.y, eye.z]; })"""
    before = page.evaluate(eyes)
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 60, y + 20, steps=6)
    page.mouse.up()
    page.wait_for_function(
        f"""() => {{ const eyes = ({eyes})();
        return eyes.every(eye => Math.abs(eye[0] - eyes[1][0]) + Math.abs(eye[2] - eyes[1][2]) < 1e-6)
            && Math.abs(eyes[1][0] - {before[1][0]}) > 0.01; }}""",
        timeout=30_000,
    )


def test_a_click_on_a_column_sorts_by_its_numbers(opened):
    page, _, _ = opened
    page.locator("#results th", has_text="Killing").click()
    cells = "Array.from(document.querySelectorAll('#results tbody tr'), row => Number(row.cells[4].dataset.value))"
    up = page.evaluate(cells)
    assert up == sorted(up)
    page.locator("#results th", has_text="Killing").click()
    assert page.evaluate(cells) == sorted(up, reverse=True)


def test_it_is_one_file_of_less_than_ten_megabytes_and_names_no_other(small_run):
    content = (small_run.folder / "report.html").read_text(encoding="utf-8")
    assert len(content.encode()) < 10e6
    without_scripts = re.sub(r"<script.*?</script>", "", content, flags=re.DOTALL)
    assert not re.findall(r"""(?:src|href)=["'](?!data:)""", without_scripts)


class Tags(HTMLParser):
    """The names of the elements of a page."""

    def __init__(self):
        super().__init__()
        self.seen = []

    def handle_starttag(self, tag, attrs):
        self.seen.append(tag)


def test_words_of_a_user_stay_words(small_run, tmp_path):
    """Names, notes and reasons that look like HTML are shown, not obeyed."""
    evil = "</script><img src=x onerror=alert(1)>"
    failed = Record(small_run.cases[0], "0", f"Failed. {evil}", failed=True)
    noted = dataclasses.replace(small_run.records[0], notes=(evil,))
    path = report([noted, failed], tmp_path / "report.html", folder=small_run.folder)
    tags = Tags()
    tags.feed(path.read_text(encoding="utf-8"))
    assert "img" not in tags.seen
    assert tags.seen.count("script") == 3


def test_a_report_without_records_is_refused(tmp_path):
    with pytest.raises(ValueError, match="needs at least one record"):
        report([], tmp_path / "report.html")
    assert not (tmp_path / "report.html").exists()


def test_a_mesh_that_is_gone_is_named(small_run, tmp_path):
    with pytest.raises(FileNotFoundError, match=r"before\.ply, though results.jsonl names it"):
        report(small_run.records, tmp_path / "report.html")
