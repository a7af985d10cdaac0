"""The report of a long drive: how long it takes to make, how large it is, and when a browser shows it."""

import tempfile
import time
from pathlib import Path
from statistics import median

from mcap.reader import make_reader

from benchmarks.rounds import by_turns
from benchmarks.row import Row, figures
from missions.lockstep import run_lockstep
from missions.plan import plan_run
from missions.report.report import write_report

SECONDS = 600.0
ROUNDS = 3
AT_MOST_MB = 10.0
_DRIVER, _BROWSER = Path("/usr/bin/chromedriver"), Path("/usr/bin/chromium")


def run_report() -> Row:
    """`strap_rover report` on a bag of 600 s of `mars_snag` with six wheels, from reading it to the page on disk.

    The reference goes once through all messages of the same bag with the MCAP library's own reader, and does nothing
    with them. Processor time of this process, warm. First paint is Chromium's, headless, of the file on disk.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        run_lockstep(plan_run("mars_snag", duration_s=2.0), folder / "short")
        run_lockstep(plan_run("mars_snag", duration_s=SECONDS), folder / "long")
        write_report(folder / "short")
        page = folder / "long.html"
        ours, reference = by_turns(
            lambda: _seconds_of_report(folder / "long", page), lambda: _seconds_of_reading(folder / "long"), ROUNDS
        )
        size_mb = page.stat().st_size / 1e6
        paint = _first_paint(page)
    return Row(
        "run_report",
        "report of a 600 s bag, ours over reading its messages once",
        f"{figures(median(ours))} s",
        f"mcap reader {figures(median(reference))} s",
        tuple(mine / theirs for mine, theirs in zip(ours, reference, strict=True)),
        notes=(
            (
                f"the page is {figures(size_mb)} MB, at most {AT_MOST_MB:g} MB wanted: "
                f"{'kept' if size_mb <= AT_MOST_MB else 'NOT KEPT'}"
            ),
            paint,
        ),
    )


def _seconds_of_report(bag: Path, page: Path) -> float:
    start = time.process_time()
    write_report(bag, page)
    return time.process_time() - start


def _seconds_of_reading(bag: Path) -> float:
    start = time.process_time()
    for file in sorted(bag.glob("*.mcap")):
        with file.open("rb") as stream:
            for _ in make_reader(stream).iter_messages():
                pass
    return time.process_time() - start


def _first_paint(page: Path) -> str:
    """First contentful paint and the last chart drawn, in words; why not where there is no browser."""
    try:
        from selenium import webdriver  # noqa: PLC0415 - of the test environment only
        from selenium.webdriver.chrome.service import Service  # noqa: PLC0415
    except ModuleNotFoundError:
        return "first paint not measured: no selenium here (`make test` installs it)"
    if not (_DRIVER.exists() and _BROWSER.exists()):
        return "first paint not measured: no chromium here (sudo apt install chromium chromium-driver)"
    options = webdriver.ChromeOptions()
    options.binary_location = str(_BROWSER)
    for argument in ("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"):
        options.add_argument(argument)
    driver = webdriver.Chrome(options=options, service=Service(str(_DRIVER)))
    try:
        driver.get("about:blank")
        driver.get(page.as_uri())
        while driver.execute_script("return document.documentElement.dataset.drawn") != "all":
            time.sleep(0.01)
        painted_ms, drawn_ms = driver.execute_script(
            "return [performance.getEntriesByName('first-contentful-paint')[0].startTime, performance.now()]"
        )
    finally:
        driver.quit()
    return f"first contentful paint in Chromium {painted_ms:.0f} ms, every chart drawn {drawn_ms / 1000:.1f} s"
