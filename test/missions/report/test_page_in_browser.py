"""The report as people see it: in Chromium, on a desk and on a phone."""

import json
import time

import numpy as np
import pytest

from missions.case_studies.plain_table import PlainTable
from missions.case_studies.study_result import Chart, Claim, Curve, StudyFigure, StudyResult, Verdict
from missions.report.report import write_report

pytestmark = pytest.mark.ros

DESK, PHONE = 1280, 390
PANELS = """
return [...document.querySelectorAll('.plot')].map((plot) => {
  const area = plot.querySelector('.plotly .nsewdrag').getBoundingClientRect();
  const shapes = '.scatterlayer path.js-line, .scatterlayer .point, .heatmaplayer image';
  const drawn = [...plot.querySelectorAll(shapes)].filter((shape) =>
    shape.tagName === 'image' || shape.getAttribute('d'));
  return {
    title: plot.closest('figure').querySelector('h3').textContent,
    points: plot._fullData.map((trace) => trace.x.length),
    finite: plot._fullData.map((trace) => [...trace.x].filter(Number.isFinite).length),
    drawn: drawn.length, width: area.width, height: area.height,
  };
});
"""
SMALLEST_TEXT = """
let smallest = [Infinity, ''];
const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
while (walker.nextNode()) {
  const parent = walker.currentNode.parentElement;
  if (!walker.currentNode.textContent.trim() || parent.closest('script, style')) continue;
  if (!parent.getClientRects().length) continue;
  const size = parseFloat(getComputedStyle(parent).fontSize);
  if (size < smallest[0]) smallest = [size, walker.currentNode.textContent];
}
return smallest;
"""
CLIPPED = """
return [...document.querySelectorAll('h1, h2, h3, p, dt, dd, figcaption, button, nav a')].filter((element) =>
  element.getClientRects().length && (element.scrollWidth > element.clientWidth + 1 && element.clientWidth
    || element.getBoundingClientRect().right > innerWidth + 1)).map((element) => element.textContent);
"""


def drive_report(bag, folder):
    return write_report(bag, folder / "report.html")


def study_report(folder):
    x = tuple(np.linspace(0.0, 0.6, 20).tolist())
    claims = tuple(
        Claim(f"Fig. {number}", "sinkage of the wheel under its stated load", "3 to 4 cm", "38 mm, 36 to 41", verdict)
        for number, verdict in enumerate(Verdict)
    )
    table = PlainTable("slip sweep with many columns", tuple("abcdefghijkl"), (("case", *["12.345"] * 11),) * 3)
    curve = Curve("a curve", x, tuple(value**2 for value in x), (0.01,) * 20)
    figures = (StudyFigure("wheel.png", "The wheel", "in sand"),)
    (folder / "wheel.png").write_bytes(_png())
    StudyResult(
        "single_wheel", "One wheel in sand", False, ("It held.",), ("delta is assumed",), claims, (table,), figures,
        (Chart("Sinkage", "slip [-]", "z [m]", (curve, curve)),),
    ).write(folder)  # fmt: skip
    return write_report(folder)


def _png():
    import struct
    import zlib

    def part(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    rows = (b"\0" + bytes(3 * 2000)) * 4
    head = struct.pack(">IIBBBBB", 2000, 4, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + part(b"IHDR", head) + part(b"IDAT", zlib.compress(rows)) + part(b"IEND", b"")


@pytest.fixture(scope="module")
def pages(real_bag, simulated_bag, tmp_path_factory):
    folder = tmp_path_factory.mktemp("pages")
    made = {"real": write_report(real_bag, folder / "real.html")}
    made["simulated"] = write_report(simulated_bag, folder / "simulated.html")
    made["study"] = study_report(tmp_path_factory.mktemp("study"))
    return made


@pytest.mark.parametrize(
    ("name", "panels", "width"),
    [("real", 20, PHONE), ("simulated", 25, DESK), ("simulated", 25, PHONE), ("study", 1, DESK), ("study", 1, PHONE)],
)
def test_a_page_is_whole_and_readable(look, pages, name, panels, width):
    page = look(pages[name], width)
    assert page.driver.get_log("browser") == []
    assert requests(page) == []

    found = page.run(PANELS)
    assert len(found) == panels, [panel["title"] for panel in found]
    for panel in found:
        assert min(panel["points"]) > 0, panel
        assert min(panel["finite"]) > 0 or panel["title"] == "What the straps say", panel
        assert panel["drawn"] > 0, panel
        assert panel["width"] > 200, panel
        assert panel["height"] > 100, panel

    assert page.run("return document.scrollingElement.scrollWidth") <= page.run("return innerWidth") == width
    size, text = page.run(SMALLEST_TEXT)
    assert size >= 12.0, text
    assert page.run(CLIPPED) == []


def requests(page):
    """Addresses that the page asked for, but for itself and what it holds."""
    said = [json.loads(entry["message"])["message"] for entry in page.driver.get_log("performance")]
    asked = [one["params"]["request"]["url"] for one in said if one["method"] == "Network.requestWillBeSent"]
    return [url for url in asked if not url.startswith(("data:", "blob:", page.driver.current_url.split("#")[0]))]


def test_a_look_finds_what_is_wrong(look, tmp_path):
    """The checks above can fail: a page with every fault they look for."""
    (tmp_path / "bad.html").write_text(
        "<body><p style='width:2000px;font-size:9px'>wide</p><script>console.error('no')</script>"
        "<img src='http://127.0.0.1:9/x.png'>"
    )
    page = look(tmp_path / "bad.html", PHONE)
    assert page.driver.get_log("browser")
    assert requests(page) == ["http://127.0.0.1:9/x.png"]
    assert page.run("return document.scrollingElement.scrollWidth") > PHONE
    assert page.run(SMALLEST_TEXT) == [9, "wide"]
    assert page.run(CLIPPED) == ["wide"]


def test_a_wheel_can_be_hidden_everywhere(look, pages):
    page = look(pages["real"], DESK)
    shown = """return [...document.querySelectorAll('.plot')].flatMap((plot) => plot._fullData)
      .filter((trace) => trace.legendgroup === arguments[0] && trace.visible === true).length;"""
    before = page.run(shown, "left"), page.run(shown, "right")
    page.run("document.querySelector('button[data-wheel=left]').click()")
    assert (page.run(shown, "left"), page.run(shown, "right")) == (0, before[1])
    pressed = (
        "return [...document.querySelectorAll('button[data-wheel=left]')].map((b) => b.getAttribute('aria-pressed'))"
    )
    assert set(page.run(pressed)) == {"false"}
    page.run("document.querySelector('button[data-wheel=left]').click()")
    assert page.run(shown, "left") == before[0] > 0


def test_charts_over_time_zoom_together(look, pages):
    page = look(pages["real"], DESK)
    over = "[...document.querySelectorAll('.plot')].filter((plot) => plot.dataset.over === 'time')"
    page.run(f"Plotly.relayout({over}[0], {{'xaxis.range[0]': 1, 'xaxis.range[1]': 2}})")
    ranges = f"return {over}.map((plot) => plot._fullLayout.xaxis.range)"
    deadline = time.monotonic() + 30.0
    while not all(shown == [1, 2] for shown in page.run(ranges)) and time.monotonic() < deadline:
        time.sleep(0.02)
    found = page.run(ranges)
    assert len(found) > 10
    assert found == [[1, 2]] * len(found)


def test_colours_follow_a_dark_screen(look, pages):
    ink = "return getComputedStyle(document.querySelector('.xtick text')).fill"
    assert look(pages["real"], DESK).run(ink) != look(pages["real"], DESK, is_dark=True).run(ink)


def test_events_are_numbered_in_the_charts(look, pages):
    page = look(pages["real"], DESK)
    labels = page.run("return [...document.querySelectorAll('.annotation-text')].map((text) => text.textContent)")
    assert set(labels) == {"1"}  # the second comes at the same time
    rows = page.run("return [...document.querySelectorAll('#s0 tbody tr')].map((row) => row.textContent)")
    assert [row[:5] for row in rows] == ["15.00", "25.00"]
