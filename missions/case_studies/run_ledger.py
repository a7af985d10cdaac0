"""Many independent runs on all cores, each written down as soon as it is done, so that a stopped study goes on later.

A folder's `runs.jsonl` holds one line that says what the runs are of, then one line per finished run. Every line is
on the disk before the next run counts. Ctrl-C, a crash or a power cut cost the runs under way and nothing else.
"""

import hashlib
import json
import os
import signal
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache, partial
from importlib.util import find_spec
from multiprocessing import TimeoutError, active_children, get_context  # noqa: A004 - the pool's own, not the built-in
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self, TypeVar

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from missions.stop_request import never
from strap_rover import __version__
from strap_rover.file_lock import FileLock, LockHeldError
from strap_rover.installed_data import config_file

RUNS_FILE: Final = "runs.jsonl"
FORMAT: Final = 1
_POLL_S = 0.2
_PACKAGES = (
    "strap_rover",
    "strap_sensor_driver",
    "soil_flow_estimator",
    "traction_controller",
    "sim_bridge",
    "missions",
)
_JobT = TypeVar("_JobT")


class LedgerError(ValueError):
    """A folder's runs cannot be gone on with; says why and what to do."""


class LostRunError(RuntimeError):
    """A run will never end, because its process has."""


@dataclass(frozen=True, slots=True)
class LedgerForm:
    """What runs must have in common to stand in one folder."""

    study: str
    is_short: bool
    settings: Mapping[str, Any]
    """Whatever else decides the runs (number of members, seed); plain JSON values."""


@lru_cache(maxsize=1)
def version_of_code() -> str:
    """The package's version and a digest of every module and shipped parameter file that a run is made of."""
    digest = hashlib.sha256()
    for name in _PACKAGES:
        spec = find_spec(name)
        if spec is None or spec.origin is None:
            raise LedgerError(f"package {name} is not there as files; install strap_rover anew")
        root = Path(spec.origin).parent
        _digest_files(digest.update, root, "*.py")
    _digest_files(digest.update, config_file("sim_bridge.yaml").parent, "*.yaml")
    return f"{__version__}+{digest.hexdigest()[:12]}"


def _digest_files(update: Callable[[bytes], object], root: Path, pattern: str) -> None:
    for file in sorted(root.rglob(pattern)):
        update(str(file.relative_to(root)).encode())
        update(file.read_bytes())


def holds_runs_of(study: str, folder: Path) -> bool:
    """Whether a study by that name has left runs in a folder, whatever their form."""
    path = folder / RUNS_FILE
    if not path.is_file():
        return False
    first, newline, _ = path.read_bytes().partition(b"\n")
    if not newline:  # ended before its first line was whole: nothing is in it
        return True
    try:
        return bool(json.loads(first)["study"] == study)
    except (ValueError, TypeError, KeyError):
        return False


class RunLedger:
    """The runs of one form in one folder; a context manager. Only one process at a time writes to a folder.

    Raises LedgerError when the folder's runs are of another form, study or version, are damaged, or are being written.
    """

    def __init__(self, folder: Path, form: LedgerForm) -> None:
        self._path = folder / RUNS_FILE
        self.done: dict[str, Any] = {}
        """What is written down, by key, as it reads back from JSON."""
        header = {
            "ledger": FORMAT,
            "study": form.study,
            "version": version_of_code(),
            "is_short": form.is_short,
            "settings": dict(form.settings),
        }
        header = json.loads(json.dumps(header, allow_nan=False))  # tuples read back as lists
        try:
            self._lock = FileLock(self._path)
        except LockHeldError as error:
            raise LedgerError(f"{self._path}: another process is writing it; wait for it to end") from error
        self._file = os.open(self._path, os.O_RDWR | os.O_APPEND | os.O_CLOEXEC)
        try:
            self._take_up(header)
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Let others have the folder; doing it twice is harmless."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1
        self._lock.release()

    def add(self, key: str, result: Any) -> None:
        """Write a finished run down, on the disk when this returns. ValueError when JSON cannot hold the result."""
        line = self._write({"key": key, "result": result})
        self.done[key] = line["result"]

    def _write(self, record: Mapping[str, Any]) -> dict[str, Any]:
        line = json.dumps(record, allow_nan=False).encode()
        whole = line + b"\n"
        while whole:
            whole = whole[os.write(self._file, whole) :]
        os.fsync(self._file)
        read_back: dict[str, Any] = json.loads(line)
        return read_back

    def _take_up(self, header: Mapping[str, Any]) -> None:
        content = self._path.read_bytes()
        whole = content.rpartition(b"\n")[0] + b"\n" if b"\n" in content else b""
        if len(whole) < len(content):  # the last line was being written when power or process went
            os.ftruncate(self._file, len(whole))
        lines = [self._parsed(number, line) for number, line in enumerate(whole.splitlines(), 1)]
        if not lines:
            self._write(header)
            return
        self._compare(lines[0], header)
        for number, line in enumerate(lines[1:], 2):
            if not {"key", "result"} <= line.keys():
                raise LedgerError(f"{self._path}: line {number} is no run; give a new folder with --out")
            self.done[line["key"]] = line["result"]

    def _parsed(self, number: int, line: bytes) -> dict[str, Any]:
        try:
            record = json.loads(line)
        except ValueError:
            record = None
        if not isinstance(record, dict):
            raise LedgerError(
                f"{self._path}: line {number} is damaged; remove that line, or give a new folder with --out"
            )
        return record

    def _compare(self, found: Mapping[str, Any], wanted: Mapping[str, Any]) -> None:
        differing = [name for name in wanted if found.get(name) != wanted[name]]
        if differing:
            what = "; ".join(f"{name} {found.get(name)!r} there, {wanted[name]!r} here" for name in differing)
            raise LedgerError(
                f"{self._path}: holds runs of another form ({what}); ask for that form, or give a new folder with --out"
            )


def run_jobs(
    folder: Path,
    form: LedgerForm,
    jobs: Mapping[str, _JobT],
    run: Callable[[_JobT], Any],
    console: Console,
    stopped: Callable[[], bool] = never,
) -> dict[str, Any]:
    """Results of all jobs by key, in the jobs' order, running on all cores those that the folder does not hold yet.

    `run` is a module's own function that takes a job and returns plain JSON values; both travel to worker processes.
    When `stopped()` says so the workers are ended, what is done is kept and returned, and a line says how to go on.
    Raises LedgerError as `RunLedger` does, and LostRunError when a worker process ends by itself.
    """
    with RunLedger(folder, form) as ledger:
        due = {key: job for key, job in jobs.items() if key not in ledger.done}
        if len(due) < len(jobs):
            console.print(f"{len(jobs) - len(due)} of {len(jobs)} runs are there already")
        with _bar(console) as progress:
            task = progress.add_task(f"{form.study}, runs", total=len(jobs), completed=len(jobs) - len(due))
            for key, result in _in_parallel(due, run, stopped):
                ledger.add(key, result)
                progress.advance(task)
        found = {key: ledger.done[key] for key in jobs if key in ledger.done}
    if len(found) < len(jobs):
        console.print(
            f"stopped: {len(found)} of {len(jobs)} runs are kept; to go on: "
            f"strap_rover case_study {form.study}{' --short' if form.is_short else ''} --out {escape(str(folder))}"
        )
    return found


def _bar(console: Console) -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=console,
        transient=True,
    )


def _in_parallel(
    jobs: Mapping[str, _JobT], run: Callable[[_JobT], Any], stopped: Callable[[], bool]
) -> Iterator[tuple[str, Any]]:
    """Keys and results as they come, from a pool over all cores, until `stopped()`; then its workers end at once."""
    if not jobs:
        return
    others = set(active_children())
    with get_context("spawn").Pool(min(len(os.sched_getaffinity(0)), len(jobs)), _leave_signals_to_parent) as pool:
        workers = set(active_children()) - others
        arriving = pool.imap_unordered(partial(_keyed, run), jobs.items())
        due = len(jobs)
        while due and not stopped():
            try:
                arrived = arriving.next(_POLL_S)
            except TimeoutError:
                # The pool replaces a worker that was killed, but never its job: it would wait for ever.
                if not all(worker.is_alive() for worker in workers):
                    raise LostRunError(
                        "a worker process ended by itself (killed? out of memory?); what is done is kept, run it again"
                    ) from None
                continue
            due -= 1
            yield arrived


def _keyed(run: Callable[[_JobT], Any], item: tuple[str, _JobT]) -> tuple[str, Any]:
    key, job = item
    return key, run(job)


def _leave_signals_to_parent() -> None:
    """Ctrl-C reaches every process of the terminal: the parent decides, and ends the pool."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
