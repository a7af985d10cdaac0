"""The study `early_warning`: how well and how early a halt is foreseen, beside every simpler alarm; and acted on.

Runs without ROS on all cores, on members of the families A to D with their two kinds of sand. Thresholds of the
simpler alarms are tuned on one half of family B to cry as often as the forecast does there, and frozen.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import count, islice
from pathlib import Path
from typing import Any, Final

from rich.console import Console
from rich.markup import escape

from missions.case_studies.early_warning_claims import claims
from missions.case_studies.early_warning_families import B_TUNE, EARLY_WARNING_SEED, member
from missions.case_studies.early_warning_results import (
    FORECAST,
    JUDGED,
    SCALES,
    SETS,
    SLIP_MATCHED,
    TEST,
    TUNE,
    ClosedRun,
    Results,
    thresholds,
)
from missions.case_studies.early_warning_rig import drive_constantly
from missions.case_studies.early_warning_runs import (
    DRIVERS,
    EVERYTHING,
    RETURN_DRIVERS,
    SNAG_DRIVERS,
    WATCHERS,
    Job,
    run_item,
)
from missions.case_studies.early_warning_scoring import FAR_M, ScoredRun, score_runs
from missions.case_studies.early_warning_tables import all_tables
from missions.case_studies.early_warning_trace import Trace
from missions.case_studies.run_ledger import RUNS_FILE, LedgerForm, run_jobs
from missions.case_studies.study_result import StudyResult
from missions.stop_request import never

STUDY: Final = "early_warning"
TABLES_FILE: Final = "tables.md"
SNAG_FAMILY: Final = "B"
_FAMILIES: Final = (
    "The estimator assumes one law of the soil; family A has that law and is no evidence, B has it with other "
    "numbers, C other laws, and in D following wheels meet softer sand than the scouts."
)
_PROTOCOL: Final = (
    "An alarm is two samples (0.1 s) above a threshold, after the first metre. It counts when it comes before the "
    f"halt, not before the first wheel touches what stops the rover and not more than {FAR_M:g} m before; else its "
    "lead is zero. Halts that are not told have lead zero, too."
)


@dataclass(frozen=True, slots=True)
class Form:
    """How many members are run."""

    open: Mapping[str, int]
    """By set, at constant speed."""
    ablated: int
    """First members of B-test that every estimator watches."""
    closed: int
    """First members of B-test that every controller drives."""
    snags: int
    dips: int
    least_radps: float = 0.0
    """Members that are asked for less are left out: they take long."""
    skipped: int = 0
    """So many first numbers of every set are left out."""


FULL = Form({"A": 60, TUNE: 400, TEST: 700, "C": 720, "D": 900}, ablated=200, closed=120, snags=100, dips=120)
"""By the share that passes in a trial, about 450 runs that pass in B-test and in C, and 500 in D."""
SHORT = Form(
    {"A": 1, TUNE: 3, TEST: 3, "C": 2, "D": 2}, ablated=1, closed=1, snags=1, dips=1, least_radps=1.65, skipped=13
)
"""To see that it all works, on quick members, one halt in B-test: too few for its verdicts to say anything."""


def with_members(form: Form, members: int) -> Form:
    """The form with so many members of B-test, and the rest in proportion; ValueError for none."""
    if members < 1:
        raise ValueError(f"a study of {members} members has nothing to judge; give at least 1")
    share = members / form.open[TEST]

    def scaled(number: int) -> int:
        return max(1, round(share * number))

    return replace(
        form,
        open={
            name: min(scaled(number), B_TUNE) if name == TUNE else scaled(number) for name, number in form.open.items()
        },
        ablated=min(members, scaled(form.ablated)),
        closed=min(members, scaled(form.closed)),
        snags=scaled(form.snags),
        dips=scaled(form.dips),
    )


def numbers(name: str, form: Form, wanted: int) -> list[int]:
    """Numbers of the first members of a set or a family; B-tune and B-test have none in common."""
    first = form.skipped + (B_TUNE if name == TEST else 0)
    if form.least_radps > 0.0:
        found = list(islice((n for n in count(first) if _wheel_speed(name[0], n) >= form.least_radps), wanted))
    else:
        found = list(range(first, first + wanted))
    if name == TUNE and found and found[-1] >= B_TUNE:
        raise ValueError(f"{TUNE} has {B_TUNE} members, {wanted} are asked for; give fewer")
    return found


@lru_cache(maxsize=1000)
def _wheel_speed(family: str, number: int) -> float:
    """Drawing a member takes some ten milliseconds."""
    return member(family, number).wheel_speed


def open_jobs(form: Form) -> dict[str, list[Job]]:
    """Set -> its members at constant speed."""
    jobs = {}
    for name in SETS:
        chosen = numbers(name, form, form.open[name])
        ablated = frozenset(chosen[: form.ablated] if name == TEST else ())
        jobs[name] = [Job(name[0], number, is_ablated=number in ablated) for number in chosen]
    return jobs


def snag_numbers(form: Form) -> list[int]:
    """Members of family B that meet a snag: of those that nothing is tuned on."""
    return numbers(TEST, form, form.snags)


def jobs_of(form: Form) -> list[Job]:
    """Every run of the study."""
    jobs = [job for group in open_jobs(form).values() for job in group]
    for number in snag_numbers(form):
        jobs += [Job(SNAG_FAMILY, number, variant) for variant in ("snag", "counterfactual")]
        jobs += [Job(SNAG_FAMILY, number, "snag", driver) for driver in SNAG_DRIVERS]
    for number in numbers(TEST, form, form.closed):
        jobs += [Job(TEST[0], number, driver=driver) for driver in DRIVERS]
    for number in numbers(TEST, form, form.dips):
        jobs.append(Job(TEST[0], number, "dip"))
        jobs += [Job(TEST[0], number, "dip", driver) for driver in RETURN_DRIVERS]
    return jobs


def results_from(form: Form, found: Mapping[str, Any]) -> Results:
    """What was run, read back from the ledger of a study that came to its end."""

    def watched(jobs: Iterable[Job], watcher: str = EVERYTHING) -> list[ScoredRun]:
        runs = [ScoredRun.from_json(found[job.key][watcher], SCALES) for job in jobs]
        return [run for run in runs if run.is_decided]

    def driven(chosen: Sequence[int], variant: str, drivers: Iterable[str]) -> dict[str, list[ClosedRun]]:
        return {
            driver: [ClosedRun.from_json(found[Job(TEST[0], number, variant, driver).key]) for number in chosen]
            for driver in drivers
        }

    groups = open_jobs(form)
    snags, dips = snag_numbers(form), numbers(TEST, form, form.dips)
    return Results(
        open={name: watched(jobs) for name, jobs in groups.items()},
        ablated={
            name: watched([job for job in groups[TEST] if job.is_ablated], name)
            for name in WATCHERS
            if name != EVERYTHING
        },
        snags=watched([Job(SNAG_FAMILY, number, "snag") for number in snags]),
        without_snag=watched([Job(SNAG_FAMILY, number, "counterfactual") for number in snags]),
        closed=driven(numbers(TEST, form, form.closed), "plain", DRIVERS),
        snags_driven=driven(snags, "snag", SNAG_DRIVERS),
        dips=driven(dips, "dip", RETURN_DRIVERS),
        dips_open=watched([Job(TEST[0], number, "dip") for number in dips]),
    )


def run_study(
    folder: Path,
    console: Console,
    stopped: Callable[[], bool] = never,
    *,
    short: bool = False,
    members: int | None = None,
) -> bool:
    """Run the study on all cores into `folder`; False when `stopped()` ended it early (what is done is kept)."""
    from missions.case_studies.early_warning_pictures import draw_all  # noqa: PLC0415 - matplotlib is slow

    form = SHORT if short else FULL
    form = form if members is None else with_members(form, members)
    jobs = {job.key: job for job in jobs_of(form)}
    settings = {"members": dict(form.open), "closed": form.closed, "seed": EARLY_WARNING_SEED}
    found = run_jobs(folder, LedgerForm(STUDY, short, settings), jobs, run_item, console, stopped)
    if len(found) < len(jobs):
        return False
    results = results_from(form, found)
    tuned = thresholds(results.open[TUNE])
    figures = draw_all(results, tuned, example_of(results.open[TEST]), folder)
    result = replace(study_result(results, tuned, len(jobs), short=short), figures=figures)
    result.write(folder)
    write_tables(result, folder / TABLES_FILE)
    console.print(result.claims_table().drawn())
    for words in result.words:
        console.print(escape(words))
    console.print(
        f"all {len(result.tables)} tables: {escape(str(folder / TABLES_FILE))}; pictures and summary.json beside it; "
        f"every run: {escape(str(folder / RUNS_FILE))}"
    )
    return True


def example_of(runs: Sequence[ScoredRun]) -> Trace | None:
    """A halt that is told with a middling lead, driven once more for its trace; None without any."""
    from missions.case_studies.early_warning_pictures import example_run  # noqa: PLC0415 - matplotlib is slow

    chosen = example_run(runs)
    if chosen is None:
        return None
    drives = drive_constantly(member(chosen.family, chosen.number), {EVERYTHING: WATCHERS[EVERYTHING]})
    return drives[EVERYTHING]


def study_result(results: Results, tuned: Mapping[str, float], runs: int, *, short: bool) -> StudyResult:
    """The study as a record that a report can read, without its pictures."""
    return StudyResult(
        study=STUDY,
        title="Foreseeing a halt before slip says so",
        is_short=short,
        words=(f"{runs} runs.", *(_words(name, results.open[name], tuned) for name in JUDGED)),
        assumptions=(
            "Plants, grounds and sensors of the members are drawn; no measured halt is among them.",
            "Whether sand keeps the hole a wheel digs (trapping) or flows back (refilling) is assumed: both are told.",
            _FAMILIES,
            _PROTOCOL,
            "Intervals in brackets are 90 % of a bootstrap over runs; of shares of driven runs 95 %, after Wilson.",
            "Passable are the members that a constant wheel speed passes; those on which it does not end are left out.",
        ),
        claims=tuple(claims(results, tuned)),
        tables=tuple(all_tables(results, tuned)),
        source="goal",
    )


def _words(name: str, runs: Sequence[ScoredRun], tuned: Mapping[str, float]) -> str:
    ours, slip = (score_runs(runs, rule.score, tuned[rule.name], draws=0) for rule in (FORECAST, SLIP_MATCHED))
    return (
        f"Family {name}: the forecast tells {100 * ours.found.recall:.0f} % of {ours.halts} halts in time, a median "
        f"{ours.found.lead_rim_m:.2f} m of rim travel ({ours.found.lead_time_s:.1f} s) before, at "
        f"{100 * ours.found.false_rate:.1f} % false alarms in {ours.passes} runs that pass; slip at its matched "
        f"threshold {tuned[SLIP_MATCHED.name]:g} tells {100 * slip.found.recall:.0f} %, {slip.found.lead_rim_m:.2f} m "
        f"({slip.found.lead_time_s:.1f} s) before, at {100 * slip.found.false_rate:.1f} %."
    )


def write_tables(result: StudyResult, path: Path) -> None:
    """All tables and claims as a document."""
    parts = [table.as_markdown() for table in (result.claims_table(), *result.tables)]
    path.write_text("\n".join(parts), encoding="utf-8")
