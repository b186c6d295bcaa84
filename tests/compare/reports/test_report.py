"""The report opens from disk in a browser, alone: findings first, every method drawn, nothing is asked of outside."""

import base64
import dataclasses
import itertools
import re
import sys
import time
from html.parser import HTMLParser
from urllib.parse import unquote

import numpy as np
import pytest

from compare import Record, report


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


# How many colours each view of a case has: one that is blank has one.
COLOURS_DRAWN = """number => Array.from(document.querySelectorAll(`#case-${number} canvas.pane`), canvas => {
  const pixels = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data, seen = new Set();
  for (let k = 0; k < pixels.length; k += 4) if (pixels[k + 3] > 0) seen.add(pixels.slice(k, k + 3).join());
  return seen.size;
})"""


def wait_until(page, expression):
    """Not by playwright's own call, which the page forbids: it would evaluate a text."""
    end = time.monotonic() + 60
    while not page.evaluate(expression):
        assert time.monotonic() < end, expression
        page.wait_for_timeout(20)


def drawn_of(record):
    """The meshes that a case has to show: before, and by every method."""
    return ["before", *record.sides]


def show(page, number):
    page.evaluate(f"document.querySelector('#case-{number} .panes').scrollIntoView()")
    every = f"Array.from(document.querySelectorAll('#case-{number} canvas.pane'))"
    wait_until(page, f"{every}.every(canvas => canvas.dataset.drawn === 'yes')")


def test_every_method_is_drawn_without_an_error_or_an_outside_request(opened, small_run):
    page, said, asked = opened
    for number, record in enumerate(small_run.records):
        show(page, number)
        panes = "Array.from(document.querySelectorAll('#case-%d canvas.pane'), c => c.dataset.pane)"
        assert page.evaluate(panes % number) == drawn_of(record)
        colours = page.evaluate(COLOURS_DRAWN, number)
        assert min(colours) > 20, "a view is blank"
    assert [text for kind, text in said if kind == "error"] == []
    assert [url for url in asked if not url.startswith(("file:", "data:", "blob:"))] == []


def test_views_give_their_memory_back_when_they_leave_the_window(opened, small_run):
    page, _, _ = opened
    last = len(small_run.records) - 1
    show(page, 0)
    show(page, last)
    first = "document.querySelector('#case-0 canvas.pane')"
    wait_until(page, f"{first}.dataset.drawn === 'no' && {first}.width === 0")
    show(page, 0)
    assert page.evaluate(f"{first}.width") > 0


def pixels_of(page, number):
    return page.evaluate(
        f"Array.from(document.querySelectorAll('#case-{number} canvas.pane'), canvas => canvas.toDataURL())"
    )


def camera_of(page, number):
    return [float(word) for word in page.get_attribute(f"#case-{number}", "data-camera").split()[:5]]


def middle_of(page, selector, nth=1):
    box = page.locator(selector).nth(nth).bounding_box()
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def settle(page):
    page.evaluate("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => setTimeout(done, 60))))")


def test_turning_and_zooming_one_view_changes_all_of_its_case_and_reset_brings_them_back(opened):
    page, _, _ = opened
    show(page, 0)
    before, at_first = pixels_of(page, 0), camera_of(page, 0)
    x, y = middle_of(page, "#case-0 canvas.pane")
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 60, y + 20, steps=3)
    page.mouse.up()
    settle(page)
    turned = pixels_of(page, 0)
    assert all(a != b for a, b in zip(before, turned, strict=True))
    assert camera_of(page, 0)[0] < at_first[0]
    page.keyboard.down("Control")
    page.mouse.wheel(0, -100)
    page.keyboard.up("Control")
    settle(page)
    assert camera_of(page, 0)[2] > 1
    assert all(a != b for a, b in zip(turned, pixels_of(page, 0), strict=True))
    page.locator("#case-0 button.reset").click()
    settle(page)
    assert camera_of(page, 0) == at_first
    assert pixels_of(page, 0) == before


def test_the_wheel_alone_scrolls_the_page_over_a_view_and_a_word_says_how_to_zoom(opened):
    page, _, _ = opened
    show(page, 0)
    page.mouse.move(*middle_of(page, "#case-0 canvas.pane"))
    zoom, top = camera_of(page, 0)[2], page.evaluate("scrollY")
    page.mouse.wheel(0, 200)
    wait_until(page, f"scrollY > {top} + 100")
    assert camera_of(page, 0)[2] == zoom
    assert "Ctrl" in page.locator("#case-0 .said").inner_text()
    assert "Drag to turn" in page.locator("#case-0 .tools").inner_text()


def test_another_axis_can_be_up(opened):
    page, _, _ = opened
    show(page, 0)
    before = pixels_of(page, 0)
    page.locator("#case-0 button[data-up=z]").click()
    settle(page)
    assert all(a != b for a, b in zip(before, pixels_of(page, 0), strict=True))
    page.locator("#case-0 button[data-up=y]").click()
    settle(page)
    assert pixels_of(page, 0) == before


def test_the_value_under_the_pointer_is_that_of_the_record(opened, small_run):
    """On the mesh of a geometric edit, which is exact: nowhere another value than zero."""
    page, _, _ = opened
    number = next(k for k, r in enumerate(small_run.records) if r.case.operation == "geometric")
    show(page, number)
    page.mouse.move(*middle_of(page, f"#case-{number} canvas.pane[data-pane=mesh]", 0))
    wait_until(page, "document.getElementById('tip').style.display === 'block'")
    assert page.locator("#tip").inner_text() == "0 % of the motion (0)"


def test_a_click_on_a_column_sorts_by_its_numbers(opened):
    page, _, _ = opened
    table = page.locator("table.results[data-kind=rigid]")
    values = "table => Array.from(table.tBodies[0].rows, row => Number(row.cells[2].dataset.value))"
    for up in (True, False):
        table.locator("th button", has_text="Killing").click()
        seen = table.evaluate(values)
        assert seen == sorted(seen, reverse=not up)


def test_rows_stand_by_kind_of_edit_with_the_columns_that_have_numbers_there_and_their_units(opened, small_run):
    page, _, _ = opened
    for record in small_run.records:
        table = page.locator(f"table.results[data-kind={record.case.operation}]")
        assert table.locator("tbody tr").count() == len(record.sides)
        heads = [text.replace("\n", " ") for text in table.locator("thead th").all_inner_texts()]
        assert ("normal %" in heads) == (record.case.operation == "geometric")
        assert ("strain %" in heads) == (record.case.operation == "rigid")
        assert {"Killing length²", "time s", "memory MB"} <= set(heads)
    details = page.locator("details.meanings").first
    assert not details.locator("dl").is_visible()
    details.locator("summary").click()
    assert "integral of" in details.locator("dl").inner_text()


def test_colours_are_in_per_cent_of_the_motion_not_below_one_and_from_zero_where_nothing_is_below(opened, small_run):
    page, _, _ = opened
    for number, record in enumerate(small_run.records):
        low, high = (page.locator(f"#case-{number} .bar .{end}").inner_text() for end in ("low", "high"))
        share = float(high.strip("+ %"))
        assert share >= 1
        if record.case.operation == "rigid":
            assert low == "0"
        else:
            assert low == f"\u2212{high.strip('+')}"
            errors = [row["error_max"] for row in record.sides.values()]
            assert share <= max(1.0, 100 * max(errors) / record.sides["mesh"]["displacement_max"]) * 1.05


def test_every_curve_of_every_case_ends_at_the_number_of_the_record(opened, small_run):
    """The last point of a line, in the picture's units, against where the ticks say that its value is."""
    page, _, _ = opened
    for number, record in enumerate(small_run.records):
        for name in ("volume_drift", "area_drift", "killing_energy"):
            ticks, ends = page.evaluate(
                f"""() => {{ const box = document.querySelector("#case-{number} [data-chart={name}] svg");
                const ticks = Array.from(box.querySelectorAll("text.tick[text-anchor=end]"),
                    text => [Number(text.textContent.replace("\u2212", "-")), Number(text.getAttribute("y")) - 3.5]);
                const ends = Array.from(box.querySelectorAll(".curve, .level"), line => line.matches(".level")
                    ? Number(line.getAttribute("y1"))
                    : Number(line.querySelector("circle:last-child").getAttribute("cy")));
                return [ticks, ends]; }}"""
            )
            (low, at_low), (high, at_high) = ticks[0], ticks[-1]
            assert len(ends) == len(record.sides)
            for y, row in zip(ends, record.sides.values(), strict=True):
                value = row["curve"][-1][name] * (1 if name == "killing_energy" else 100)
                drawn = low + (high - low) * (y - at_low) / (at_high - at_low)
                assert drawn == pytest.approx(value, abs=0.006 * (high - low)), name


def test_the_page_says_what_was_asked_and_found_and_shows_each_edit_before_any_table(opened, small_run):
    page, _, _ = opened
    page.evaluate("scrollTo(0, 0)")
    cards = page.locator(".finding")
    assert cards.count() == len(small_run.records)
    tops = [page.locator(selector).first.bounding_box()["y"] for selector in (".finding", "table")]
    assert tops[0] < tops[1]
    for card, record in zip(cards.all(), small_run.records, strict=True):
        text = card.inner_text()
        assert "Asked: to" in text
        assert "Time: neural" in text
        assert card.locator("canvas.thumb").count() == 1
        missed = record.sides["implicit"].get("handle_error_relative")
        if missed is not None:
            assert f"{100 * missed:.2g}" in text


def test_the_first_picture_is_there_at_once(opened):
    page, _, _ = opened
    assert page.evaluate("Number(document.documentElement.dataset.firstPicture)") > 0


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_page_follows_the_colour_scheme(browser, small_run, scheme):
    page = browser.new_page(color_scheme=scheme)
    page.goto((small_run.folder / "report.html").as_uri())
    colour = page.evaluate("getComputedStyle(document.body).backgroundColor")
    assert (sum(int(n) for n in re.findall(r"\d+", colour)[:3]) > 600) == (scheme == "light")
    page.close()


def test_a_printed_page_has_every_view(browser, small_run, tmp_path):
    """Also those that were never in sight: each is a picture of its own in the PDF."""
    page = browser.new_page(viewport={"width": 1200, "height": 300})
    page.goto((small_run.folder / "report.html").as_uri())
    page.evaluate("addEventListener('afterprint', () => {}); window.drawnInPrint = 0")
    page.evaluate(
        "addEventListener('beforeprint', () => { window.drawnInPrint = "
        "Array.from(document.querySelectorAll('canvas[data-pane]')).filter(c => c.dataset.drawn === 'yes').length; })"
    )
    pdf = page.pdf(path=tmp_path / "page.pdf", print_background=True)
    views = sum(len(drawn_of(record)) + 1 for record in small_run.records)  # and a thumbnail each
    assert page.evaluate("window.drawnInPrint") == views
    assert pdf.count(b"/Subtype /Image") >= views
    page.close()


@pytest.mark.parametrize("width", [400, 800])
def test_a_narrow_window_shows_all_without_scrolling_sideways_or_says_what_is_hidden(browser, small_run, width):
    page = browser.new_page(viewport={"width": width, "height": 800})
    page.goto((small_run.folder / "report.html").as_uri())
    page.evaluate("document.querySelectorAll('details').forEach(one => { one.open = true; })")
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    hidden = page.evaluate(
        """Array.from(document.querySelectorAll('.table'), box => [box.querySelector('.scroll').scrollWidth
        > box.querySelector('.scroll').clientWidth + 1, box.querySelector('.more-columns').textContent])"""
    )
    for is_hidden, words in hidden:
        assert is_hidden == ("more column" in words)
    if width == 800:
        assert not any(is_hidden for is_hidden, _ in hidden)
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
    assert page.locator("#case-0 svg.chart .curve, #case-0 svg.chart .level").count() > 0
    assert page.locator("canvas").count() == 0
    assert page.locator("table.results tbody tr").count() == sum(len(r.sides) for r in bare)
    assert said == []
    page.close()


def test_a_report_of_many_cases_stays_below_ten_megabytes(small_run, tmp_path, monkeypatch):
    """Though no two of them had a mesh in common. Beyond a hundred the later ones have files and curves, no views."""
    names = itertools.count()

    def keep_each(arrays, array):
        name = f"{next(names):012d}"
        arrays[name] = base64.b64encode(np.ascontiguousarray(array).tobytes()).decode()
        return name

    monkeypatch.setattr(sys.modules["compare.reports.report"], "_keep", keep_each)
    many = [dataclasses.replace(r, key=f"{r.key}-{k}") for k in range(38) for r in small_run.records]
    path = report(many, tmp_path / "report.html", folder=small_run.folder)
    assert 4e6 < path.stat().st_size < 10e6
    tags = Tags()
    tags.feed(path.read_text(encoding="utf-8"))
    assert tags.classes.count("case") == len(many) == 114
    drawn = [many[k] for k in range(107)]
    assert tags.classes.count("pane") == sum(len(drawn_of(record)) for record in drawn)


def test_cases_of_one_shape_and_edit_are_told_apart_by_what_differs(small_run, tmp_path):
    first, second, third = small_run.records
    finer = dataclasses.replace(first.case, seed=7, vertices=700)
    study = [first, dataclasses.replace(first, case=finer, key="1"), second, third]
    page = report(study, tmp_path / "report.html", folder=small_run.folder).read_text(encoding="utf-8")
    assert "<h2>bulb: geometric, vertices 700, seed 7</h2>" in page
    assert "<button>setting</button>" in page
    assert "2 settings; the field" in page
    assert "<button>setting</button>" not in (small_run.folder / "report.html").read_text(encoding="utf-8")


def test_a_study_has_its_title_and_its_charts_on_top(small_run, tmp_path):
    (tmp_path / "study.json").write_text('{"study": {"name": "points", "title": "How many <points>?"}}')
    (tmp_path / "chart.png").write_bytes(b"\x89PNG of the chart")
    (tmp_path / "work-precision.svg").write_text("<svg/>")
    (tmp_path / "work-precision.png").write_bytes(b"the same again")
    bare = [dataclasses.replace(record, artefacts={}) for record in small_run.records]
    page = report(bare, tmp_path / "report.html").read_text(encoding="utf-8")
    assert "<h1>How many &lt;points&gt;?</h1>" in page
    shown = re.findall(r'src="data:([^;]+);base64,([^"]+)"', page)
    assert [kind for kind, _ in shown] == ["image/png", "image/svg+xml"]
    assert base64.b64decode(shown[0][1]) == b"\x89PNG of the chart"
    assert page.index(shown[1][1]) < page.index('id="findings"')
    assert "<h1>Another</h1>" in report(bare, tmp_path / "a.html", title="Another").read_text(encoding="utf-8")


def test_rows_of_before_there_were_curves_are_still_shown(small_run, tmp_path):
    old = small_run.records[0]
    later = ("curve", "seconds_by_phase", "peak_memory")
    sides = {side: {k: v for k, v in row.items() if k not in later} for side, row in old.sides.items()}
    path = report([dataclasses.replace(old, sides=sides)], tmp_path / "report.html", folder=small_run.folder)
    tags = Tags()
    tags.feed(path.read_text(encoding="utf-8"))
    assert "chart" not in tags.classes
    assert tags.classes.count("pane") == len(drawn_of(old))


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
    assert tags.seen.count("script") == 2


def test_a_report_without_records_is_refused(tmp_path):
    with pytest.raises(ValueError, match="needs at least one record"):
        report([], tmp_path / "report.html")
    assert not (tmp_path / "report.html").exists()


def test_a_mesh_that_is_gone_is_named(small_run, tmp_path):
    with pytest.raises(FileNotFoundError, match=r"before\.ply, though results.jsonl names it"):
        report(small_run.records, tmp_path / "report.html")
