import io
import json
import re
from dataclasses import replace

import pytest

from missions import demo
from missions.demo import OutputFolderError, output_folder, print_result, run_demo
from missions.report.page import ReportError
from missions.summary import Outcome
from strap_rover.flight_recorder.bag_reader import read_bag_summary

pytestmark = pytest.mark.ros


def test_a_demo_leaves_bag_summary_and_picture(demonstrated):
    folder, summary = demonstrated.result.folder, demonstrated.result.summary
    assert demonstrated.result.complete
    assert {path.name for path in folder.iterdir()} == {"bag", "summary.json", "run.png", "report.html"}
    assert read_bag_summary(folder / "bag").duration_s == pytest.approx(17.99)
    written = json.loads((folder / "summary.json").read_text(encoding="utf-8"), parse_constant=pytest.fail)
    assert written == json.loads(summary.to_json())
    assert summary.outcome == Outcome.DROVE_OFF.value


def test_progress_is_shown_while_it_runs(demonstrated):
    seconds = [int(match) for match in re.findall(r"(\d+)/18 s", demonstrated.text)]
    assert len(set(seconds)) > 5
    assert seconds == sorted(seconds)
    assert seconds[-1] == 18
    assert "reading the bag back" in demonstrated.text
    assert "a snag soon after the start" in demonstrated.text


def test_the_result_is_told_in_words(demonstrated, capsys):
    from rich.console import Console

    print_result(demonstrated.result, Console(width=200))
    text = capsys.readouterr().out
    for part in (
        "drove off",
        "RETRY",
        "snag of 600 N catches",
        "rms error 0.1",
        "bag",
        "run.png",
        "summary.json",
        "report.html",
    ):
        assert part in text
    assert "stopped early" not in text
    print_result(replace(demonstrated.result, complete=False), Console(width=200))
    assert "stopped early" in capsys.readouterr().out
    for stop_s, words in ((-1.0, "CAUTION at the end, largest score 0.50, never STOP"), (7.25, "STOP first at 7.2 s")):
        summary = replace(
            demonstrated.result.summary, forecast_at_end="CAUTION", largest_scout_z=0.5, forecast_stop_s=stop_s
        )
        print_result(replace(demonstrated.result, summary=summary), Console(width=200))
        assert words in capsys.readouterr().out


def test_the_output_folder_is_the_one_asked_for_or_the_next_free_number(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert output_folder(tmp_path / "a" / "b", "stem") == tmp_path / "a" / "b"
    assert (tmp_path / "a" / "b").is_dir()
    names = [output_folder(None, "stem").name for _ in range(3)]
    assert names == ["stem-001", "stem-002", "stem-003"]


def test_a_folder_that_is_occupied_or_impossible_is_refused(tmp_path):
    (tmp_path / "file").write_text("x", encoding="utf-8")
    with pytest.raises(OutputFolderError, match="is not empty; give an empty or new folder with --out"):
        output_folder(tmp_path, "stem")
    with pytest.raises(OutputFolderError, match=r"file.*give another folder with --out"):
        output_folder(tmp_path / "file" / "deeper", "stem")
    with pytest.raises(OutputFolderError, match=r"file: .*give another folder with --out"):
        output_folder(tmp_path / "file", "stem")


def test_without_plotly_the_run_is_whole_and_says_why_there_is_no_report(tmp_path, monkeypatch, make_plan):
    from rich.console import Console

    def refused(bag, out):
        raise ReportError("plotly is not installed")

    monkeypatch.setattr(demo, "write_report", refused)
    result = run_demo(make_plan(duration_s=0.3), tmp_path, Console(file=io.StringIO()))
    assert (result.complete, result.report) == (True, None)
    screen = io.StringIO()
    print_result(result, Console(file=screen, width=200))
    assert "plotly is not installed" in screen.getvalue()
    assert (tmp_path / "run.png").exists()
