"""The digging law beside measured single wheels, and beside the laws it replaces.

Each law is fitted to a test with the contact terms held: one set of parameters per sand, all slips at once. Then one
slip after the other is left out and predicted. The sand of the slip-angle rows is that of the straight ones; braking
is also predicted from a fit to driving alone. Errors are given at the median and at the worst: medians hide failures.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np
from rich.console import Console
from rich.progress import Progress
from scipy.optimize import least_squares

from missions.case_studies.plain_table import PlainTable
from missions.case_studies.study_result import Chart, Claim, Curve, StudyFigure, StudyResult, Verdict
from missions.stop_request import never
from strap_rover.arrays import BoolArray, FloatArray
from strap_rover.terramechanics.contact import solve_sinkage
from strap_rover.terramechanics.measured_soils import (
    CMU_FIT,
    CMU_SMOOTH,
    DING_2011_FIT,
    DING_2011_SMOOTH,
    REFILLING,
    TESTS,
    SingleWheelTest,
    fitted_sand,
    trapping,
)
from strap_rover.terramechanics.slip_sinkage import DiggableSoil, steady_wheel
from strap_rover.terramechanics.soil import Soil

STUDY_SEED = 20110127
STARTS, SHORT_STARTS = 12, 2
NO_SLIP = 0.05
"""Below this slip a driven wheel's relative errors mean nothing: the pull goes through zero."""
DING_GOALS = MappingProxyType({"drawbar pull": 0.08, "sinkage": 0.06, "torque": 0.06})
"""Median relative error at slips of 0.1 and more."""
DING_LEFT_OUT_GOALS = MappingProxyType({"drawbar pull": 0.12, "sinkage": 0.08, "torque": 0.08})
DING_LARGEST_SINKAGE_ERROR = 0.20
DING_GROWTH = (2.8, 4.4)
"""z(0.6)/z(0): measured 3.5, read off a picture."""
CMU_PULL_DRIVING_N, CMU_PULL_N, CMU_LATERAL_N = 0.4, 1.0, 1.0
"""Root mean square errors; driving counts at no slip angle."""
CMU_SINKAGE_GOALS = MappingProxyType({"driving": 0.06, "braking": 0.08})
"""Median relative error."""
_PULL_SCALE, _PULL_SHARE = 0.3, 0.03
_SINKAGE_SCALE, _SINKAGE_SHARE = 0.25e-3, 0.04
_TORQUE_SCALE, _TORQUE_SHARE = 0.1, 0.03
"""What a residual is worth: readings are uncertain by about so much, plus a share of their size."""
_NOT_CARRIED = 100.0
"""Residual where a law finds no depth that carries the load."""
_SPREAD = 0.5
"""Of the logarithms of further starting points, 1-sigma."""


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """What a law says of the rows of a test; NaN where it has no answer."""

    drawbar_pull: FloatArray
    sinkage: FloatArray
    torque: FloatArray
    lateral: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Law:
    """A law with its free parameters, positive ones; they are fitted as logarithms."""

    name: str
    predict: Callable[[SingleWheelTest, Sequence[float]], Prediction]
    starts: MappingProxyType[str, tuple[float, ...]]
    """By the test's name; empty where nothing is fitted."""
    parameters: tuple[str, ...]


def _as_digging(test: SingleWheelTest, values: Sequence[float]) -> Prediction:
    return _steady(test, fitted_sand(test, *values))


def _steady(test: SingleWheelTest, sand: DiggableSoil) -> Prediction:
    found = steady_wheel(test.wheel, sand, test.load, test.slip, test.slip_angle)
    return Prediction(
        np.asarray(found.drawbar_pull), np.asarray(found.sinkage), np.asarray(found.torque), np.asarray(found.lateral)
    )


def _as_growing_exponent(test: SingleWheelTest, values: Sequence[float]) -> Prediction:
    """N = n_0 + n_1 |s| after Ding, with the contact terms of the digging law and nothing dug: no memory."""
    stiffness, tan_friction, shear_modulus, growth = values
    parts = []
    for row in range(test.slip.size):
        one = test.rows(np.array([row]))
        soil = Soil(
            n=float(test.published.n) + growth * abs(float(one.slip[0])),
            k_c=stiffness * test.published.k_c,
            k_phi=stiffness * test.published.k_phi,
            cohesion=0.0,
            friction_angle=math.atan(tan_friction),
            shear_deformation_modulus=shear_modulus,
        )
        parts.append(_steady(one, DiggableSoil(soil, 0.0, REFILLING)))
    return Prediction(
        *(np.concatenate([getattr(part, name) for part in parts]) for name in _OUTPUTS),
    )


_OUTPUTS = ("drawbar_pull", "sinkage", "torque", "lateral")


def _as_bekker_wong(test: SingleWheelTest, soil: Soil) -> Prediction:
    """Known for a wheel that rolls straight; braking loads beyond what it carries stay without an answer."""
    found = solve_sinkage(test.wheel, soil, test.load, test.slip, 0.0, unsolved="mask")
    rolls = straight(test)
    none = np.full(test.slip.shape, math.nan)
    return Prediction(
        np.where(rolls, found.forces.drawbar_pull, none),
        np.where(rolls, found.sinkage, none),
        np.where(rolls, found.forces.torque, none),
        none,
    )


def _as_published(test: SingleWheelTest, _: Sequence[float]) -> Prediction:
    return _as_bekker_wong(test, test.published)


def _as_refitted(test: SingleWheelTest, values: Sequence[float]) -> Prediction:
    stiffness, tan_friction, shear_modulus = values
    published = test.published
    return _as_bekker_wong(
        test,
        Soil(
            n=published.n,
            k_c=stiffness * published.k_c,
            k_phi=stiffness * published.k_phi,
            cohesion=0.0,
            friction_angle=math.atan(tan_friction),
            shear_deformation_modulus=shear_modulus,
        ),
    )


def _starts(ding: tuple[float, ...], cmu: tuple[float, ...]) -> MappingProxyType[str, tuple[float, ...]]:
    return MappingProxyType({DING_2011_SMOOTH.name: ding, CMU_SMOOTH.name: cmu})


_COMMON = ("stiffness over published", "tan phi_w", "K [m]")
DIGGING = Law("digging", _as_digging, _starts(DING_2011_FIT, CMU_FIT), (*_COMMON, "delta [m]"))
PUBLISHED = Law("Bekker-Wong, published", _as_published, _starts((), ()), ())
REFITTED = Law("Bekker-Wong, refitted", _as_refitted, _starts((1.0, 0.5, 0.005), (1.0, 0.5, 0.02)), _COMMON)
GROWING = Law(
    "n = n0 + n1 s",
    _as_growing_exponent,
    _starts((4.0, 0.43, 0.003, 0.3), (1.2, 0.6, 0.02, 0.3)),
    (*_COMMON, "n1"),
)
LAWS = (PUBLISHED, REFITTED, GROWING, DIGGING)


def fit(law: Law, test: SingleWheelTest, starts: int = 1) -> tuple[float, ...]:
    """Parameters that fit a test's rows best, from `starts` starting points drawn from a seed."""
    first = np.log(law.starts[test.name])
    if not first.size:
        return ()
    rng = np.random.default_rng(STUDY_SEED)
    best_cost, best = math.inf, first
    for number in range(starts):
        start = first + (_SPREAD * rng.standard_normal(first.size) if number else 0.0)
        found = least_squares(
            lambda logs: _residuals(law.predict(test, np.exp(logs).tolist()), test),
            start,
            bounds=(first - math.log(20.0), first + math.log(20.0)),
            xtol=1e-10,
            ftol=1e-12,
        )
        if found.cost < best_cost:
            best_cost, best = found.cost, found.x
    return tuple(float(value) for value in np.exp(best))


def _residuals(said: Prediction, test: SingleWheelTest) -> FloatArray:
    parts = [
        (said.drawbar_pull - test.drawbar_pull) / (_PULL_SCALE + _PULL_SHARE * np.abs(test.drawbar_pull)),
        (said.sinkage - test.sinkage) / (_SINKAGE_SCALE + _SINKAGE_SHARE * test.sinkage),
        (said.torque - test.torque) / (_TORQUE_SCALE + _TORQUE_SHARE * np.abs(test.torque)),
    ]
    # A torque of nothing at no slip was not read but drawn so.
    measured = [test.drawbar_pull, test.sinkage, np.where(test.torque == 0.0, math.nan, test.torque)]
    kept = [part[np.isfinite(value)] for part, value in zip(parts, measured, strict=True)]
    together = np.concatenate(kept)
    return np.where(np.isfinite(together), together, _NOT_CARRIED)


def left_out(law: Law, test: SingleWheelTest) -> Prediction:
    """Each row as predicted from a fit to the others."""
    parts = []
    for row in range(test.slip.size):
        others = np.arange(test.slip.size) != row
        values = fit(law, test.rows(others))
        parts.append(law.predict(test.rows(~others), values))
    return Prediction(*(np.concatenate([getattr(part, name) for part in parts]) for name in _OUTPUTS))


@dataclass(frozen=True, slots=True)
class Errors:
    """Of one quantity over some rows: median and largest of the relative error, rms in its unit."""

    median: float
    largest: float
    rms: float
    unanswered: int
    """Measured rows to which the law has no answer, since it finds no depth that carries the load."""


def errors(said: FloatArray, measured: FloatArray) -> Errors:
    """Of the rows that were measured and answered; NaN if there is none."""
    known = np.isfinite(measured)
    answered = known & np.isfinite(said)
    unanswered = int(known.sum() - answered.sum())
    if not answered.any():
        return Errors(math.nan, math.nan, math.nan, unanswered)
    off = said[answered] - measured[answered]
    relative = np.abs(off / measured[answered])
    return Errors(float(np.median(relative)), float(relative.max()), float(np.sqrt(np.mean(off**2))), unanswered)


@dataclass(frozen=True, slots=True, eq=False)
class LawOnTest:
    """A law on one test: fitted to the rows that roll straight, and said of all."""

    law: Law
    test: SingleWheelTest
    values: tuple[float, ...]
    said: Prediction
    left_out: Prediction | None
    """Of the straight rows; None where nothing is fitted."""


def straight(test: SingleWheelTest) -> BoolArray:
    """The rows at no slip angle."""
    return np.asarray(test.slip_angle == 0.0)


def law_on_test(law: Law, test: SingleWheelTest, starts: int) -> LawOnTest:
    """Fit, prediction and prediction of what was left out."""
    rolling = test.rows(straight(test))
    values = fit(law, rolling, starts)
    return LawOnTest(law, test, values, law.predict(test, values), left_out(law, rolling) if values else None)


def ding_errors(said: Prediction) -> tuple[Errors, Errors, Errors]:
    """Of drawbar pull, sinkage and torque at slips of 0.1 and more."""
    test, rows = DING_2011_SMOOTH, DING_2011_SMOOTH.slip > NO_SLIP
    return (
        errors(said.drawbar_pull[rows], test.drawbar_pull[rows]),
        errors(said.sinkage[rows], test.sinkage[rows]),
        errors(said.torque[rows], test.torque[rows]),
    )


def cmu_rows(angle_deg: float, kind: str) -> BoolArray:
    """Rows of CMU_SMOOTH at a slip angle: `driving` (with the rolling one), `braking` or `all`."""
    at = np.isclose(CMU_SMOOTH.slip_angle, math.radians(angle_deg))
    drives = CMU_SMOOTH.slip > -NO_SLIP
    return np.asarray(at & {"driving": drives, "braking": ~drives, "all": np.ones_like(drives)}[kind])


def goals_met(ding: LawOnTest, cmu: LawOnTest) -> tuple[Claim, ...]:
    """The goals beside what came out."""
    return (*_ding_goals(ding), *(claim for angle in (0, 15) for claim in _cmu_goals(cmu, angle)))


def _ding_goals(ding: LawOnTest) -> list[Claim]:
    test = "Ding 2011, slip >= 0.1"
    found = dict(zip(DING_GOALS, ding_errors(ding.said), strict=True))
    claims = [_share_claim(test, f"{what}, median error", DING_GOALS[what], found[what]) for what in DING_GOALS]
    if ding.left_out is not None:
        blind = dict(zip(DING_GOALS, ding_errors(ding.left_out), strict=True))
        claims += [
            _share_claim(test, f"{what}, each slip left out, median", DING_LEFT_OUT_GOALS[what], blind[what])
            for what in DING_GOALS
        ]
    largest = found["sinkage"].largest
    is_close = largest <= DING_LARGEST_SINKAGE_ERROR
    claims.append(
        Claim(
            test, "sinkage, largest error", f"within {DING_LARGEST_SINKAGE_ERROR:.0%}", f"{largest:.0%}", _as(is_close)
        )
    )
    growth = float(ding.said.sinkage[-1] / ding.said.sinkage[0])
    low, high = DING_GROWTH
    claims.append(
        Claim("Ding 2011", "z(0.6)/z(0), measured 3.5", f"{low} to {high}", f"{growth:.2f}", _as(low <= growth <= high))
    )
    return claims


def _cmu_goals(cmu: LawOnTest, angle_deg: int) -> list[Claim]:
    test = f"CMU smooth, {angle_deg} deg"
    claims = []
    if angle_deg == 0:
        rows = cmu_rows(0, "driving")
        claims.append(_force_claim(test, "drawbar pull, rms, driving", CMU_PULL_DRIVING_N, cmu, "drawbar_pull", rows))
    every = cmu_rows(angle_deg, "all")
    claims.append(_force_claim(test, "drawbar pull, rms, locked to 0.9", CMU_PULL_N, cmu, "drawbar_pull", every))
    for kind, limit in CMU_SINKAGE_GOALS.items():
        rows = cmu_rows(angle_deg, kind)
        found = errors(cmu.said.sinkage[rows], CMU_SMOOTH.sinkage[rows])
        claims.append(_share_claim(test, f"sinkage, median error, {kind}", limit, found))
    if angle_deg:
        claims.append(_force_claim(test, "lateral force, rms, locked to 0.9", CMU_LATERAL_N, cmu, "lateral", every))
    return claims


def _share_claim(test: str, quantity: str, limit: float, found: Errors) -> Claim:
    text = f"{found.median:.1%}, largest {found.largest:.0%}"
    return Claim(test, quantity, f"within {limit:.0%}", text, _as(found.median <= limit))


def _force_claim(test: str, quantity: str, limit: float, cmu: LawOnTest, name: str, rows: BoolArray) -> Claim:
    said, measured = getattr(cmu.said, name)[rows], getattr(CMU_SMOOTH, name)[rows]
    found = errors(said, measured)
    text = f"{found.rms:.2f} N, largest {np.abs(said - measured).max():.2f} N"
    return Claim(test, quantity, f"within {limit:g} N", text, _as(found.rms <= limit))


def _as(is_met: bool) -> Verdict:
    return Verdict.REPRODUCED if is_met else Verdict.NOT_REPRODUCED


def law_table(found: Sequence[LawOnTest]) -> PlainTable:
    """Every law on both tests."""
    rows = []
    for law in LAWS:
        ding = next(item for item in found if item.law is law and item.test is DING_2011_SMOOTH)
        cmu = next(item for item in found if item.law is law and item.test is CMU_SMOOTH)
        cells = [law.name, str(len(law.parameters))]
        cells.append("/".join(_percent(item.median) for item in ding_errors(ding.said)))
        cells.append("/".join(_percent(item.largest) for item in ding_errors(ding.said)))
        cells.append("-" if ding.left_out is None else "/".join(_percent(e.median) for e in ding_errors(ding.left_out)))
        cells += [_on_cmu(cmu.said, kind, CMU_SMOOTH) for kind in _DIRECTIONS]
        rolling = CMU_SMOOTH.rows(straight(CMU_SMOOTH))
        cells += ["-" if cmu.left_out is None else _on_cmu(cmu.left_out, kind, rolling) for kind in _DIRECTIONS]
        rows.append(tuple(cells))
    headings = (
        "law", "fitted", "Ding: DP/z/T % median", "largest", "left out",
        "CMU driving: DP rms, z % median/largest", "braking", "driving, left out", "braking, left out",
    )  # fmt: skip
    return PlainTable("laws beside two measured sands (Ding at slip 0.1 and more)", headings, tuple(rows))


_DIRECTIONS = ("driving", "braking")


def _on_cmu(said: Prediction, kind: str, test: SingleWheelTest) -> str:
    """Errors of the rows that roll straight, of all of the test's or of those alone."""
    at = cmu_rows(0, kind)[: test.slip.size]
    pull = errors(said.drawbar_pull[at], test.drawbar_pull[at])
    sinkage = errors(said.sinkage[at], test.sinkage[at])
    missing = f" ({pull.unanswered} of {at.sum()} no answer)" if pull.unanswered else ""
    return f"{pull.rms:.2f} N, {_percent(sinkage.median)}/{_percent(sinkage.largest)}{missing}"


def _percent(share: float) -> str:
    return f"{100.0 * share:.0f}" if math.isfinite(share) else "-"


def point_table(found: LawOnTest) -> PlainTable:
    """Every row of a test, measured and said."""
    test, said = found.test, found.said
    has_torque, has_lateral = np.isfinite(test.torque).any(), np.isfinite(test.lateral).any()
    headings = ["slip angle, slip", "DP [N]", "law", "off", "z [mm]", "law", "off %"]
    headings += ["T [N m]", "law"] if has_torque else []
    headings += ["F_y [N]", "law"] if has_lateral else []
    rows = []
    for i in range(test.slip.size):
        cells = [f"{math.degrees(test.slip_angle[i]):.0f} deg, {test.slip[i]:.3g}"]
        cells += [f"{test.drawbar_pull[i]:.2f}", f"{said.drawbar_pull[i]:.2f}"]
        cells += [f"{said.drawbar_pull[i] - test.drawbar_pull[i]:+.2f}"]
        cells += [f"{1e3 * test.sinkage[i]:.1f}", f"{1e3 * said.sinkage[i]:.1f}"]
        cells += [f"{100.0 * (said.sinkage[i] / test.sinkage[i] - 1.0):+.0f}"]
        cells += [f"{test.torque[i]:.2f}", f"{said.torque[i]:.2f}"] if has_torque else []
        cells += [f"{test.lateral[i]:.2f}", f"{said.lateral[i]:.2f}"] if has_lateral else []
        rows.append(tuple(cells))
    return PlainTable(f"{test.name}: measured beside the digging law", tuple(headings), tuple(rows))


def parameter_table(found: Sequence[LawOnTest]) -> PlainTable:
    """What was fitted."""
    rows = [
        (f"{item.law.name}, {item.test.name}", name, f"{value:.4g}")
        for item in found
        for name, value in zip(item.law.parameters, item.values, strict=True)
    ]
    return PlainTable("fitted parameters", ("law, test", "parameter", "value"), tuple(rows))


def braking_from_driving(starts: int) -> PlainTable:
    """CMU braking as predicted from a fit to its driving rows alone."""
    rows = cmu_rows(0, "braking")
    values = fit(DIGGING, CMU_SMOOTH.rows(cmu_rows(0, "driving")), starts)
    blind = CMU_SMOOTH.rows(rows)
    said = DIGGING.predict(blind, values)
    cells = tuple(
        (
            f"{blind.slip[i]:.3g}",
            f"{blind.drawbar_pull[i]:.2f}",
            f"{said.drawbar_pull[i]:.2f}",
            f"{1e3 * blind.sinkage[i]:.1f}",
            f"{1e3 * said.sinkage[i]:.1f}",
        )
        for i in range(blind.slip.size)
    )
    return PlainTable("CMU: braking predicted from driving alone", ("slip", "DP [N]", "law", "z [mm]", "law"), cells)


def curves(found: LawOnTest) -> tuple[Chart, ...]:
    """Pull and sinkage over slip, measured and said, per slip angle; and how the trapping kind would differ."""
    test = found.test
    slips = np.linspace(float(test.slip.min()), 0.98 if test.slip.min() < 0.0 else 0.8, 120)
    sand = fitted_sand(test, *found.values)
    charts = []
    for quantity, label, scale in (("drawbar_pull", "drawbar pull [N]", 1.0), ("sinkage", "sinkage [mm]", 1e3)):
        lines = []
        for angle in np.unique(test.slip_angle):
            at = test.slip_angle == angle
            load = np.interp(slips, test.slip[at], test.load[at])
            name = f"{math.degrees(angle):.0f} deg"
            std = test.drawbar_pull_std[at]
            is_known = quantity == "drawbar_pull" and bool(np.isfinite(std).all())
            lines.append(
                Curve(
                    f"measured, {name}",
                    _numbers(test.slip[at]),
                    _numbers(scale * getattr(test, quantity)[at]),
                    _numbers(std) if is_known else (),
                )
            )
            for kind, ground in (("refilling", sand), ("trapping", trapping(sand))):
                if kind == "trapping" and angle != 0.0:
                    continue
                said = steady_wheel(test.wheel, ground, load, slips, float(angle))
                lines.append(
                    Curve(f"{kind}, {name}", _numbers(slips), _numbers(scale * np.asarray(getattr(said, quantity))))
                )
        charts.append(Chart(f"{test.name}: {label}", "slip", label, tuple(lines)))
    return tuple(charts)


def _numbers(values: FloatArray) -> tuple[float, ...]:
    return tuple(float(f"{value:.6g}") for value in values)


def run_study(
    folder: Path,
    console: Console,
    stopped: Callable[[], bool] = never,
    *,
    starts: int = STARTS,
    is_short: bool = False,
) -> bool:
    """All laws on both tests into `folder`: tables, pictures and `summary.json`; True when every goal is met."""
    found: list[LawOnTest] = []
    with Progress(console=console, transient=True) as progress:
        task = progress.add_task("fits", total=len(LAWS) * len(TESTS))
        for law in LAWS:
            for test in TESTS:
                if stopped():
                    return False
                progress.update(task, description=f"{law.name}, {test.name}")
                found.append(law_on_test(law, test, starts))
                progress.advance(task)
    ding, cmu = (next(item for item in found if item.law is DIGGING and item.test is test) for test in TESTS)
    claims = goals_met(ding, cmu)
    tables = (
        law_table(found), point_table(ding), point_table(cmu), braking_from_driving(starts), parameter_table(found)
    )  # fmt: skip
    charts = (*curves(ding), *curves(cmu))
    from missions.case_studies.slip_sinkage_picture import draw_test  # noqa: PLC0415 - matplotlib is slow

    figures = []
    for item, pair in ((ding, charts[:2]), (cmu, charts[2:])):
        file = f"{item.test.name.lower().replace(' ', '_')}.png"
        draw_test(pair, folder / file)
        caption = (
            f"Points: {item.test.source}. Lines: the digging law; dashed: the same sand, had it the trapping kind."
        )
        figures.append(StudyFigure(file, f"{item.test.name}: measured and said", caption))
    result = StudyResult(
        study="slip_sinkage",
        title="Drawbar pull and sinkage over slip, beside measured single wheels",
        is_short=is_short,
        words=_words(found),
        assumptions=(
            f"The refill ratio of both sands is held at {REFILLING:g}; steady tests determine delta/(1 + kappa) only.",
            "The contact terms are shared by both sands and were fitted to these tests too: the scores are optimistic.",
            "n as published, no cohesion.",
        ),
        claims=claims,
        tables=tables,
        figures=tuple(figures),
        charts=charts,
    )
    for table in (*tables, result.claims_table()):
        console.print(table.drawn())
    result.write(folder)
    return all(claim.verdict is Verdict.REPRODUCED for claim in claims)


def _words(found: Sequence[LawOnTest]) -> tuple[str, ...]:
    def on_ding(law: Law) -> tuple[Errors, Errors, Errors]:
        return ding_errors(next(item.said for item in found if item.law is law and item.test is DING_2011_SMOOTH))

    old, new = on_ding(PUBLISHED), on_ding(DIGGING)
    return (
        (
            f"With published parameters the classical law misses Ding's pull by {old[0].median:.0%} and sinkage by "
            f"{old[1].median:.0%} at the median: its sinkage hardly grows with slip. The digging law, with "
            f"{len(DIGGING.parameters)} numbers per sand, misses them by {new[0].median:.0%} and {new[1].median:.0%}."
        ),
        "Braking does not follow cleanly from driving: fitted to driving alone, the law is far off at a locked wheel.",
    )
