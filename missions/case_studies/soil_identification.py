"""How well de and st of a rolling wheel are identified: bias, spread, what the estimator claims, how soon it is there.

Every row is 100 seeds of a rover that stands, then rolls, with noise on all that is measured. On the stand of the law
the wheels obey the law that the estimator assumes, so that what is seen is the filter; on the plant the law is another
one each time. NEES is the squared error over the variance claimed, averaged over seeds for one wheel: 1 when the
estimator knows how good it is, within the chi-square band of that many seeds.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from rich.console import Console
from rich.markup import escape
from scipy.stats import chi2

from missions.case_studies.plain_table import PlainTable
from missions.case_studies.run_ledger import RUNS_FILE, LedgerForm, run_jobs
from missions.case_studies.soil_identification_runs import DE_GOAL, NOISE, ST_GOAL, Job, Outcome, run_job
from missions.case_studies.study_result import Chart, Claim, Curve, StudyResult, Verdict
from missions.stop_request import never
from strap_rover.arrays import FloatArray

STUDY: Final = "soil_identification"
STUDY_SEED: Final = 20261124
SOILS: Final = ((0.15, 0.3), (0.3, 0.4), (0.5, 0.6))
"""(de, st), firm to soft."""
LOAD_STDS: Final = (0.0, 0.1)
BAND: Final = 0.95
TURN_M: Final = 2.0 * np.pi * 0.25
"""Rim travel of one turn of the wheels of the rover used."""
WHEEL: Final = 0
"""The wheel of which NEES is told: the wheels of one run share the noise of the body's speed."""


CHANGE_S: Final = 16.0
"""Rolling until the rear wheels have met the other soil, too, and gone on for a turn and more."""


@dataclass(frozen=True, slots=True)
class Form:
    """How much is run."""

    seeds: int
    soils: tuple[tuple[float, float], ...]
    roll_s: float


FULL = Form(100, SOILS, 9.0)
SHORT = Form(6, SOILS[1:2], 7.0)
"""To see that it all works; its bands are wide."""


@dataclass(frozen=True, slots=True, eq=False)
class RowFigures:
    """What all seeds of a row came to; de first, then st."""

    seeds: int
    static_rms: float
    """Of de when the rover sets off."""
    static_claimed: float
    bias: tuple[float, float]
    spread: tuple[float, float]
    rms: tuple[float, float]
    claimed: tuple[float, float]
    """The estimator's 1-sigma, root mean square."""
    turned_rms: tuple[float, float]
    """After one turn of the wheels."""
    nees: tuple[float, float]
    band: tuple[float, float]

    @property
    def is_consistent(self) -> bool:
        """Whether both lie in the band."""
        return all(self.band[0] <= value <= self.band[1] for value in self.nees)

    @property
    def is_accurate(self) -> bool:
        """Whether both root mean square errors, bias included, are within the goals."""
        return self.rms[0] <= DE_GOAL and self.rms[1] <= ST_GOAL


def figures_of(outcomes: Sequence[Outcome]) -> RowFigures:
    """Of the seeds of one row; errors over all wheels, NEES of the first."""
    claimed = np.array([[o.de_std, o.st_std] for o in outcomes])  # (seeds, 2, W)
    true = np.array([[o.true_de, o.true_st] for o in outcomes])
    error = np.array([[o.de, o.st] for o in outcomes]) - true
    static = np.array([o.static_de for o in outcomes]) - np.array([o.true_static_de for o in outcomes])
    turned = np.array([[o.turned_de, o.turned_st] for o in outcomes])
    turned_true = np.array([[o.true_turned_de, o.true_turned_st] for o in outcomes])
    nees = np.mean((error[:, :, WHEEL] / claimed[:, :, WHEEL]) ** 2, axis=0)
    seeds = len(outcomes)
    low, high = chi2.interval(BAND, seeds)
    return RowFigures(
        seeds=seeds,
        static_rms=_rms(static),
        static_claimed=_rms(np.array([o.static_de_std for o in outcomes])),
        bias=_pair(error.mean(axis=(0, 2))),
        spread=_pair(error.std(axis=(0, 2))),
        rms=(_rms(error[:, 0]), _rms(error[:, 1])),
        claimed=(_rms(claimed[:, 0]), _rms(claimed[:, 1])),
        turned_rms=(_rms((turned - turned_true)[:, 0]), _rms((turned - turned_true)[:, 1])),
        nees=_pair(nees),
        band=(float(low) / seeds, float(high) / seeds),
    )


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _pair(values: FloatArray) -> tuple[float, float]:
    return float(values[0]), float(values[1])


def jobs_of(form: Form) -> dict[str, Job]:
    """Every run by a name."""
    jobs: dict[str, Job] = {}
    for stand, soil, told in (
        ("law", "calm", True),
        ("law", "constant", False),
        ("law", "wandering", False),
        ("plant", "constant", False),
    ):
        for de, st in form.soils:
            for uses_torque in (True, False):
                for load_std in LOAD_STDS:
                    _add(jobs, form, (stand, soil, de, st, uses_torque, load_std, told))
    for number, (de, st) in enumerate(form.soils):
        after = SOILS[(SOILS.index((de, st)) + 1) % len(SOILS)] if number < len(SOILS) else SOILS[0]
        for uses_torque in (True, False):
            _add(jobs, form, ("law", "changing", de, st, uses_torque, LOAD_STDS[-1], False), after)
    return jobs


def _add(
    jobs: dict[str, Job],
    form: Form,
    row: tuple[str, str, float, float, bool, float, bool],
    after: tuple[float, float] = (-1.0, -1.0),
) -> None:
    stand, soil, de, st, uses_torque, load_std, told = row
    for seed in range(form.seeds):
        roll_s = CHANGE_S if soil == "changing" else form.roll_s
        job = Job(stand, soil, de, st, uses_torque, load_std, told, STUDY_SEED + seed, roll_s, *after)
        jobs[f"{row_name(job)}, seed {seed}"] = job


def row_name(job: Job) -> str:
    """A row in words."""
    torque = _torque(uses_torque=job.uses_torque)
    return f"{job.stand}, {job.soil}, de {job.de:g} st {job.st:g}, {torque}, load {100.0 * job.load_std:g} %" + (
        ", told calm" if job.is_told_calm else ""
    )


def run_study(
    folder: Path,
    console: Console,
    stopped: Callable[[], bool] = never,
    *,
    short: bool = False,
    runs: int | None = None,
) -> bool:
    """Run the study on all cores into `folder`; False when `stopped()` ended it early (what is done is kept)."""
    form = SHORT if short else FULL
    form = form if runs is None else Form(runs, form.soils, form.roll_s)
    jobs = jobs_of(form)
    settings = {"seeds": form.seeds, "seed": STUDY_SEED, "roll_s": form.roll_s}
    found = run_jobs(folder, LedgerForm(STUDY, short, settings), jobs, run_job, console, stopped)
    if len(found) < len(jobs):
        return False
    result = study_result([Outcome.from_json(item) for item in found.values()], short=short)
    result.write(folder)
    for table in (*result.tables, result.claims_table()):
        console.print(table.drawn())
    console.print(f"every run: {escape(str(folder / RUNS_FILE))}")
    return True


def study_result(outcomes: Sequence[Outcome], *, short: bool) -> StudyResult:
    """All rows as a record that a report can read."""
    rows: dict[tuple[Any, ...], list[Outcome]] = {}
    for outcome in outcomes:
        rows.setdefault(outcome.job.row, []).append(outcome)
    figures = {row: figures_of(seeds) for row, seeds in rows.items() if row[1] != "changing"}
    changing = {row: seeds for row, seeds in rows.items() if row[1] == "changing"}
    noise = (
        f"Noise, white, 20 Hz: angles {np.degrees(NOISE.angle_rad):.2f} deg, torque {NOISE.torque_nm:g} N m, slip "
        f"{NOISE.slip:g} (one reading of the body's speed for all wheels), load 0 or 10 % of each wheel, not changing."
    )
    return StudyResult(
        study=STUDY,
        title="Identifying de and st on a rolling wheel",
        is_short=short,
        words=(
            noise,
            "Errors are over all wheels and seeds at the end of the drive; NEES is of one wheel.",
        ),
        assumptions=(
            "On the stand of the law wheels obey the law that the estimator assumes, digging included.",
            (
                "On the plant stiffness exponent, shear modulus, place of the stress peak, rear contact, digging, kind "
                "of sand and torque gain differ from it in every run; de and st are those the soil was drawn around."
            ),
        ),
        claims=tuple(_claims(figures, changing)),
        tables=(
            _table("Soil that hardly changes, and told so", figures, ("law", "calm"), told=True),
            _table("Constant soil, settings as shipped", figures, ("law", "constant"), told=False),
            _table("Soil that wanders as the shipped settings assume", figures, ("law", "wandering"), told=False),
            _table("The plant with other laws, settings as shipped", figures, ("plant", "constant"), told=False),
            _change_table(changing),
        ),
        charts=(_chart(changing),) if changing else (),
        source="goal",
    )


_HEADINGS = (
    "soil", "torque", "load", "de standing", "de bias", "de sd", "de claimed", "st bias", "st sd", "st claimed",
    "NEES de", "NEES st", "band",
)  # fmt: skip


def _table(
    title: str, figures: Mapping[tuple[Any, ...], RowFigures], kind: tuple[str, str], *, told: bool
) -> PlainTable:
    rows = []
    seeds = 0
    for row, found in figures.items():
        if row[:2] != kind or row[-1] is not told:
            continue
        _, _, de, st, uses_torque, load_std, _ = row
        seeds = found.seeds
        rows.append(
            (
                f"de {de:g}, st {st:g}",
                "yes" if uses_torque else "no",
                "known" if load_std == 0.0 else f"{100.0 * load_std:g} %",
                f"{found.static_rms:.3f}",
                f"{found.bias[0]:+.3f}",
                f"{found.spread[0]:.3f}",
                f"{found.claimed[0]:.3f}",
                f"{found.bias[1]:+.3f}",
                f"{found.spread[1]:.3f}",
                f"{found.claimed[1]:.3f}",
                f"{found.nees[0]:.2f}",
                f"{found.nees[1]:.2f}",
                f"{found.band[0]:.2f} to {found.band[1]:.2f}",
            )
        )
    return PlainTable(f"{title} ({seeds} seeds)", _HEADINGS, tuple(rows))


def _change_table(changing: Mapping[tuple[Any, ...], Sequence[Outcome]]) -> PlainTable:
    rows = []
    for outcomes in changing.values():
        job = outcomes[0].job
        for axle, wheels in (("front", (0, 3)), ("middle", (1, 4)), ("rear", (2, 5))):
            settled = settled_of(outcomes, wheels)
            by_std = settled_of(outcomes, wheels, by_std=True)
            rows.append(
                (
                    f"de {job.de:g}, st {job.st:g} to {job.de_after:g}, {job.st_after:g}",
                    "yes" if job.uses_torque else "no",
                    axle,
                    *(_metres(_quantile(settled, share)) for share in (0.5, 0.9)),
                    f"{100.0 * np.mean(settled <= TURN_M):.0f} %",
                    *(_metres(_quantile(by_std, share)) for share in (0.5, 0.9)),
                )
            )
    return PlainTable(
        f"After a change of soil, load 10 %: rim travel until settled (a turn is {TURN_M:.2f} m)",
        ("soil", "torque", "axle", "median m", "p90 m", "in a turn", "2 sigma: median m", "p90 m"),
        tuple(rows),
    )


def _quantile(values: FloatArray, share: float) -> float:
    """One of the values, some of which may be inf."""
    return float(np.quantile(values, share, method="inverted_cdf"))


def _metres(value: float) -> str:
    return f"{value:.2f}" if np.isfinite(value) else "never"


def settled_of(outcomes: Iterable[Outcome], wheels: Sequence[int], *, by_std: bool = False) -> FloatArray:
    """Rim travel [m] until settled, of each seed and wheel; inf where it never was."""
    way = np.array([o.settled_by_std_m if by_std else o.settled_m for o in outcomes])[:, list(wheels)].ravel()
    return np.where(way < 0.0, np.inf, way)


def _claims(
    figures: Mapping[tuple[Any, ...], RowFigures], changing: Mapping[tuple[Any, ...], Sequence[Outcome]]
) -> Iterable[Claim]:
    for row, found in figures.items():
        stand, soil, de, st, uses_torque, load_std, told = row
        if stand != "law" or not uses_torque or soil == "wandering" or load_std == 0.0:
            continue
        yield Claim(
            f"de {de:g}, st {st:g}",
            f"1 sd with torque, load +-10 %, {'calm soil, told so' if told else 'constant soil, settings as shipped'}",
            f"<= {DE_GOAL:g} / {ST_GOAL:g}",
            f"{found.rms[0]:.3f} / {found.rms[1]:.3f}",
            _verdict(met=found.is_accurate),
            "rms over seeds and wheels, bias included",
        )
    for kind, told, uses_torque in (
        (("law", "calm"), True, True),
        (("law", "calm"), True, False),
        (("law", "wandering"), False, True),
        (("law", "wandering"), False, False),
    ):
        chosen = [
            found
            for row, found in figures.items()
            if row[:2] == kind and row[-1] is told and row[4] is uses_torque and row[5] > 0.0
        ]
        low, high = chosen[0].band
        every = [value for found in chosen for value in found.nees]
        inside = sum(low <= value <= high for value in every)
        yield Claim(
            "NEES",
            f"{kind[1]} soil{', told so' if told else ', settings as shipped'}, {_torque(uses_torque=uses_torque)}",
            f"in its 95 % band, {low:.2f} to {high:.2f}",
            f"{min(every):.2f} to {max(every):.2f}; {inside} of {len(every)} inside",
            _verdict(met=inside == len(every)),
            "load +-10 %; every soil, de and st apart; below the band is too modest, above it too sure",
        )
    for outcomes in changing.values():
        job = outcomes[0].job
        if not job.uses_torque:
            continue
        settled = settled_of(outcomes, (0, 3))
        yield Claim(
            f"de {job.de:g} to {job.de_after:g}",
            "rim travel of the front wheels until de and st are settled, median",
            f"<= {TURN_M:.2f} m (one turn)",
            f"{_metres(_quantile(settled, 0.5))} m, in {100.0 * np.mean(settled <= TURN_M):.0f} % within a turn",
            _verdict(met=_quantile(settled, 0.5) <= TURN_M),
            f"within {2.0 * DE_GOAL:g} / {2.0 * ST_GOAL:g} of the truth, for half a second running",
        )


def _torque(*, uses_torque: bool) -> str:
    return "with torque" if uses_torque else "no torque"


def _verdict(*, met: bool) -> Verdict:
    return Verdict.MET if met else Verdict.NOT_MET


def _chart(changing: Mapping[tuple[Any, ...], Sequence[Outcome]]) -> Chart:
    curves = []
    for outcomes in changing.values():
        job = outcomes[0].job
        way = np.sort(settled_of(outcomes, (0, 3)))
        way = way[np.isfinite(way)]
        share = 100.0 * np.arange(1, way.size + 1) / (2 * len(outcomes))
        name = f"de {job.de:g} to {job.de_after:g}, {'torque' if job.uses_torque else 'no torque'}"
        curves.append(Curve(name, tuple(way.tolist()), tuple(share.tolist())))
    return Chart(
        "Settled after a change of soil", "rim travel of the front wheels [m]", "share of runs [%]", tuple(curves)
    )
