"""The report opens from disk in a browser, alone: views are drawn, cameras are linked, nothing is asked of outside."""

import base64
import dataclasses
import itertools
import re
import shutil
import sys
from html.parser import HTMLParser
from urllib.parse import unquote

import numpy as np
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


@pytest.fixture(scope="module")
def opened(browser, small_run):
    """The report in a window too small for all cases, with what it said and asked for; tests go on with it in turn."""
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
    page.locator("#results th button", has_text="Killing").click()
    cells = "Array.from(document.querySelectorAll('#results tbody tr'), row => Number(row.cells[4].dataset.value))"
    up = page.evaluate(cells)
    assert up == sorted(up)
    page.locator("#results th button", has_text="Killing").click()
    assert page.evaluate(cells) == sorted(up, reverse=True)


def test_what_has_no_value_stands_last_whichever_way_one_sorts(opened):
    """Only geometric edits have the error along the normal; two clicks turn the rest round and leave it."""
    page, _, _ = opened
    titles = page.locator("#results th").all_inner_texts()
    column = [title.strip() for title in titles].index("normal")
    values = f"Array.from(document.querySelectorAll('#results tbody tr'), row => row.cells[{column}].dataset.value)"
    for _ in range(2):
        page.locator("#results th").nth(column).locator("button").click()
        seen = [value != "" for value in page.evaluate(values)]
        assert any(seen)
        assert seen == sorted(seen, reverse=True)


def test_every_curve_of_every_case_is_drawn_with_the_numbers_of_the_record(opened, small_run):
    page, _, _ = opened
    for number, record in enumerate(small_run.records):
        show(page, number)
        lines = page.evaluate(
            f"""() => Array.from(document.querySelectorAll("#case-{number} .chart"), chart => [chart.dataset.chart,
            chart.querySelectorAll(".scatterlayer .js-line").length,
            chart.data.map(line => [line.name, Array.from(line.y)])])"""
        )
        assert [name for name, _, _ in lines] == ["volume_drift", "area_drift", "killing_energy"]
        for name, drawn, curves in lines:
            assert drawn == len(record.sides)
            for (side, values), row in zip(curves, record.sides.values(), strict=True):
                unit = 1 if name == "killing_energy" else 100
                steps = [unit * at[name] for at in row["curve"]]
                wanted = steps if len(steps) > 2 else [steps[1], steps[1]]  # a level for what is solved at once
                assert values == pytest.approx(wanted, rel=1e-12, abs=1e-15), (name, side)


def test_at_most_four_cases_have_their_views_at_a_time_and_none_is_blank(browser, small_run, tmp_path):
    """Six cases made so flat that a window shows them all: they would need 18 contexts."""
    many = [dataclasses.replace(r, key=f"{r.key}-{k}") for k in range(2) for r in small_run.records]
    path = report(many, tmp_path / "report.html", folder=small_run.folder)
    page = browser.new_page(viewport={"width": 900, "height": 500})
    said = []
    page.on("console", lambda message: said.append(message.text))
    page.goto(path.as_uri())
    flat = ".pane { height: 50px } .bar, .charts, .key, ul, p, details, .scroll { display: none } h2 { margin: 0 }"
    page.add_style_tag(content=flat)
    drawn = "Array.from(document.querySelectorAll('section.case'), s => s.dataset.drawn === 'yes')"
    page.wait_for_function(f"{drawn}.filter(Boolean).length === 4", timeout=120_000)
    page.evaluate("scrollTo(0, document.body.scrollHeight)")
    page.wait_for_function(f"!{drawn}[0] && {drawn}[5] && {drawn}.filter(Boolean).length === 4", timeout=120_000)
    for number in [k for k, is_drawn in enumerate(page.evaluate(drawn)) if is_drawn]:
        assert min(page.evaluate(COLOURS_DRAWN, number)) > 20, "a view is blank"
    assert not [text for text in said if "context" in text.lower()]
    page.close()


def test_a_narrow_window_shows_a_case_without_scrolling_sideways(browser, small_run):
    page = browser.new_page(viewport={"width": 400, "height": 800})
    page.goto((small_run.folder / "report.html").as_uri())
    show(page, 0)
    page.evaluate("document.querySelectorAll('details').forEach(one => { one.open = true; })")
    assert page.evaluate("document.documentElement.scrollWidth") <= 400
    page.close()


def test_it_is_one_file_of_less_than_ten_megabytes_and_loads_no_other(small_run):
    content = (small_run.folder / "report.html").read_text(encoding="utf-8")
    assert len(content.encode()) < 10e6
    without_scripts = re.sub(r"<script.*?</script>", "", content, flags=re.DOTALL)
    assert not re.findall(r"""src=["'](?!data:)""", without_scripts)
    assert re.findall(r"""<link [^>]*href=["'](?!data:)""", without_scripts) == []


@pytest.mark.parametrize("place", ["beside", "elsewhere: 100 %"])
def test_every_link_leads_to_a_file_of_the_run(small_run, tmp_path, place):
    """Also from a page that lies elsewhere, in a folder whose name means something in an address."""
    path = small_run.folder / "report.html"
    if place != "beside":
        path = tmp_path / place / "report.html"
        path.parent.mkdir()
        report(small_run.records, path, folder=small_run.folder)
    tags = Tags()
    tags.feed(path.read_text(encoding="utf-8"))
    links = [link for link in tags.links if not link.startswith(("#", "data:"))]
    reached = {(path.parent / unquote(link)).resolve() for link in links}
    files = {small_run.folder / a.path for r in small_run.records for a in r.artefacts.values()}
    assert reached == {file.resolve() for file in files | {small_run.folder / "results.jsonl"}}
    assert all(file.is_file() for file in reached)
    assert not [link for link in links if ":" in link]


def test_a_link_is_taken(opened, small_run):
    page, _, _ = opened
    with page.expect_download() as download:
        page.locator("#case-0 .files a").first.click()
    artefact = small_run.records[0].artefacts["field"]
    assert download.value.path().read_bytes() == (small_run.folder / artefact.path).read_bytes()


def test_cases_without_meshes_have_a_row_and_curves(browser, small_run, tmp_path):
    bare = [dataclasses.replace(record, artefacts={}) for record in small_run.records]
    path = report(bare, tmp_path / "report.html")
    page = browser.new_page(viewport={"width": 1200, "height": 900})
    said = []
    page.on("pageerror", lambda error: said.append(str(error)))
    page.goto(path.as_uri())
    page.wait_for_function("document.querySelectorAll('#case-0 .chart .js-line').length > 0", timeout=60_000)
    assert page.locator(".pane").count() == 0
    assert page.locator("#results tbody tr").count() == sum(len(r.sides) for r in bare)
    assert said == []
    page.close()


def test_a_report_of_many_cases_stays_below_ten_megabytes(small_run, tmp_path, monkeypatch):
    """Though no two of them had a mesh in common. Beyond 64 cases the later ones have files and curves, no views."""
    names = itertools.count()

    def keep_each(arrays, array):
        name = f"{next(names):012d}"
        arrays[name] = base64.b64encode(np.ascontiguousarray(array).tobytes()).decode()
        return name

    monkeypatch.setattr(sys.modules["compare.reports.report"], "_keep", keep_each)
    many = [dataclasses.replace(r, key=f"{r.key}-{k}") for k in range(34) for r in small_run.records]
    path = report(many, tmp_path / "report.html", folder=small_run.folder)
    assert 7e6 < path.stat().st_size < 10e6
    tags = Tags()
    tags.feed(path.read_text(encoding="utf-8"))
    assert tags.seen.count("section") == len(many) == 102
    assert tags.classes.count("pane") == 3 * 64


def test_cases_of_one_shape_and_edit_are_told_apart_by_what_differs(small_run, tmp_path):
    first, second, third = small_run.records
    finer = dataclasses.replace(first.case, seed=7, vertices=700)
    study = [first, dataclasses.replace(first, case=finer, key="1"), second, third]
    page = report(study, tmp_path / "report.html", folder=small_run.folder).read_text(encoding="utf-8")
    assert "<h2>bulb: geometric, vertices 700, seed 7</h2>" in page
    assert "<button>setting</button>" in page
    assert "<button>setting</button>" not in (small_run.folder / "report.html").read_text(encoding="utf-8")


def test_rows_of_before_there_were_curves_are_still_shown(small_run, tmp_path):
    old = small_run.records[0]
    later = ("curve", "seconds_by_phase", "peak_memory")
    sides = {side: {k: v for k, v in row.items() if k not in later} for side, row in old.sides.items()}
    path = report([dataclasses.replace(old, sides=sides)], tmp_path / "report.html", folder=small_run.folder)
    tags = Tags()
    tags.feed(path.read_text(encoding="utf-8"))
    assert "chart" not in tags.classes
    assert tags.classes.count("pane") == 3


class Tags(HTMLParser):
    """The names of the elements of a page, their classes, and where links lead."""

    def __init__(self):
        super().__init__()
        self.seen, self.classes, self.links = [], [], []

    def handle_starttag(self, tag, attrs):
        self.seen.append(tag)
        self.classes += (dict(attrs).get("class") or "").split()
        if "href" in dict(attrs):
            self.links.append(dict(attrs)["href"])


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
