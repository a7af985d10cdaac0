"""`strap_rover report`: which page for which path, where it goes, and one clear message when there is none."""

import resource
import shutil
import signal
from pathlib import Path

import pytest

from missions.case_studies.study_result import StudyResult
from missions.command_line import main
from missions.report import page as page_module
from missions.report.page import ReportError
from missions.report.report import write_report
from strap_rover.flight_recorder.bag_format import BagError

pytestmark = pytest.mark.ros


@pytest.fixture(autouse=True)
def _keep_signals():
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def write_study(folder):
    folder.mkdir(parents=True, exist_ok=True)
    StudyResult("s", "A study", True, ("words",), (), (), ()).write(folder)
    return folder


def test_a_bag_has_its_report_beside_it_whole_and_the_same_each_time(tmp_path, real_bag):
    bag = tmp_path / "dune"
    shutil.copytree(real_bag, bag)
    out = write_report(bag)
    assert out == tmp_path / "dune.html"
    text = out.read_text(encoding="utf-8")
    assert "Drive of a rover: halted" in text
    assert out.stat().st_size < 10_000_000
    (file,) = bag.glob("*.mcap")
    assert write_report(file).read_text(encoding="utf-8") == text
    assert write_report(bag).read_text(encoding="utf-8") == text  # over its own
    assert sorted(path.name for path in tmp_path.iterdir()) == ["dune", "dune.html"]


def test_the_folder_of_a_run_has_its_report_in_it(tmp_path, real_bag):
    shutil.copytree(real_bag, tmp_path / "bag")
    (tmp_path / "summary.json").write_text("{}")
    assert write_report(tmp_path) == tmp_path / "report.html"


def test_the_folder_of_a_study_has_its_report_in_it(tmp_path):
    out = write_report(write_study(tmp_path / "study"))
    assert out == tmp_path / "study" / "report.html"
    assert "A study" in out.read_text(encoding="utf-8")


def test_another_place_can_be_asked_for(tmp_path):
    assert write_report(write_study(tmp_path / "study"), tmp_path / "x.html") == tmp_path / "x.html"


def test_the_command_says_where_the_report_is(tmp_path, capsys):
    study = write_study(tmp_path / "[study]")
    assert main(["report", str(study)]) == 0
    out, err = capsys.readouterr()
    assert (out.strip(), err) == (str(study / "report.html"), "")


def test_a_bag_of_another_version_says_so(tmp_path, make_real_bag):
    bag = make_real_bag(tmp_path / "bag", duration_s=1.0, custom_data={"strap_rover_version": "0.0.1"})
    assert "Recorded by strap_rover 0.0.1, reported by" in write_report(bag).read_text(encoding="utf-8")


def test_a_damaged_bag_says_so_first(tmp_path, make_real_bag):
    bag = make_real_bag(tmp_path / "bag", chunk_size_bytes=20_000)
    (file,) = bag.glob("*.mcap")
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    assert "This bag is not whole. bag_0.mcap breaks off" in write_report(bag).read_text(encoding="utf-8")


def test_faults_and_warnings_stand_in_words_with_remedies(tmp_path, real_bag):
    text = write_report(real_bag, tmp_path / "x.html").read_text(encoding="utf-8")
    assert "end A reads 0 V in contact: check the lead and slip ring of end A, and its pull-down" in text
    assert "too many straps without a usable reading" in text
    assert text.count("old: does the rover send it?") == 1  # complaints that differ in numbers only are one row
    assert "<td>100</td>" in text


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda folder: folder / "nothing", "nothing: no such file or folder; give a bag, a demo's folder or"),
        (lambda folder: folder, "is neither a bag (metadata.yaml or .mcap), nor the folder of a demo or of a case"),
        (lambda folder: _written(folder / "notes.txt", b"hello"), "notes.txt: is not an MCAP file"),
        (lambda folder: _written(folder / "empty.mcap", b""), "empty.mcap: is not an MCAP file"),
        (lambda folder: _written(folder / "summary.json", b"{").parent, "summary.json: is no JSON"),
    ],
)
def test_what_has_no_report_gets_one_clear_message(tmp_path, capsys, make, message):
    assert main(["report", str(make(tmp_path))]) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("strap_rover: ")
    assert message in err
    assert err.count("\n") == 1


def _written(path: Path, content: bytes) -> Path:
    path.write_bytes(content)
    return path


@pytest.mark.parametrize(
    ("out", "message"),
    [
        ("study/summary.json", "summary.json: is there already, and no report; give another file with --out"),
        ("study", "study: is a folder; give the name of an HTML file with --out"),
        ("missing/x.html", r"x.html: cannot be written (No such file or directory); give another file with --out"),
    ],
)
def test_other_files_are_not_written_over(tmp_path, capsys, out, message):
    study = write_study(tmp_path / "study")
    before = (study / "summary.json").read_bytes()
    assert main(["report", str(study), "--out", str(tmp_path / out)]) == 1
    assert message in capsys.readouterr().err
    assert (study / "summary.json").read_bytes() == before


def test_a_disk_that_takes_no_more_leaves_what_was_there(tmp_path):
    study = write_study(tmp_path / "study")
    out = tmp_path / "x.html"
    out.write_text(page_module.MARK)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
    try:
        with pytest.raises(ReportError, match=r"x\.html: cannot be written \(File too large\)"):
            write_report(study, out)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert out.read_text() == page_module.MARK
    assert sorted(path.name for path in tmp_path.iterdir()) == ["study", "x.html"]


def test_a_bag_without_anything_known_is_named(tmp_path, make_real_bag):
    bag = make_real_bag(tmp_path / "bag", duration_s=0.1, rows=())
    with pytest.raises(BagError, match="holds no message that a report can be made of"):
        write_report(bag)
