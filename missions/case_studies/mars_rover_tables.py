"""What the drives of case study 2 say: tables, claims beside the source paper, and words."""

import math
from collections.abc import Callable, Sequence

import numpy as np

from missions.case_studies.baselines import BASELINES, SOIL_FLOW
from missions.case_studies.mars_rover import AS_PRINTED, SANDS, SENSOR_LESS, STUDY, Form, Results
from missions.case_studies.mars_rover_claims import PASSED, claims, count, number, spread, told, trace_of_drive
from missions.case_studies.mars_rover_runs import Trace
from missions.case_studies.plain_table import PlainTable
from missions.case_studies.study_result import Chart, Curve, StudyFigure, StudyResult
from sim_bridge.scenarios import MarsCase
from strap_rover.arrays import FloatArray
from strap_rover.rover import load_rover

_OVER_TIME: tuple[tuple[str, str, Callable[[Trace], FloatArray]], ...] = (
    ("Total traction", "N", lambda trace: trace.traction_n),
    ("Widest contact zone", "deg", lambda trace: np.asarray(trace.zone_deg.max(axis=1))),
    ("Deepest wheel", "mm", lambda trace: np.asarray(trace.sinkage_mm.max(axis=1))),
    ("Mean commanded wheel speed", "rad/s", lambda trace: np.asarray(trace.omega_radps.mean(axis=1))),
)
_OUTCOMES = ("drove off", "halted", "stuck", "buried", "undecided")


def study_result(results: Results, form: Form, figures: Sequence[StudyFigure], *, short: bool) -> StudyResult:
    """The study as a record that a report can read."""
    return StudyResult(
        study=STUDY,
        title="Curiosity comes from stones into soft sand, with and without the straps' help",
        is_short=short,
        words=words(results, form),
        assumptions=assumptions(form.reference),
        claims=tuple(claims(results, form)),
        tables=(
            platform_table(results),
            variants_table(results),
            *(family_table(results, sand) for sand in SANDS),
            energy_table(results),
            lockstep_table(results),
        ),
        figures=tuple(figures),
        charts=charts(results),
    )


def assumptions(case: MarsCase) -> tuple[str, ...]:
    """What is assumed beyond the source paper, or other than in it."""
    sand = case.sand
    held = f"the soft sand rises by {sand.slope_deg:g} deg and a snag of {sand.snag_n:g} N holds for {sand.snag_s:g} s"
    places = f"The soft sand begins at {case.soft_from_m:g} m, and the snag is {case.snag_after_m:g} m further on"
    depth_mm = 1e3 * sand.excavation_depth_m
    soft = f"The soft sand has de {sand.de:g}, st {sand.st:g} and a digging depth of {depth_mm:g} mm"
    return (
        f"Slope and snag, not in the paper: {held}. What happens without them is in a table of its own.",
        f"{places}; in the full form the sensor-less rover so meets them near the paper's 50 and 68 s.",
        f"{soft}; the paper gives no numbers for it.",
        "Trapping sand keeps the hole a wheel digs: assumed, it is what reproduces the paper.",
        "Refilling sand flows back as measured sands do. Every result is told for both.",
        "Stones and rock come from a seeded generator, not from NASA's model of the ground, which the paper used.",
        "Members of the family start nearer to the soft sand than the reference case, to save time.",
        "Axles, pivots and centre of gravity of the rover are approximate or assumed (config/rovers/curiosity.yaml).",
    )


def words(results: Results, form: Form) -> tuple[str, ...]:
    """What was found, in words made from the counts."""
    said = []
    for sand in SANDS:
        free, less = results.reference[sand, SOIL_FLOW], results.reference[sand, SENSOR_LESS]
        said.append(
            f"Reference case, {sand} sand: with the straps the rover {told(free)}; without them, at a constant "
            f"2 rad/s, it {told(less)}."
        )
        counts = ", ".join(
            f"{controller} {count(results.family[sand, controller], PASSED)}" for controller in BASELINES
        )
        said.append(f"Of {form.members} random members on {sand} sand these come clear: {counts}.")
    printed = [results.variants[AS_PRINTED, sand, SENSOR_LESS] for sand in SANDS]
    said.append(
        "On level soft sand without a snag, as the paper describes it, the sensor-less rover "
        + " and ".join(f"{told(result)} ({sand} sand)" for sand, result in zip(SANDS, printed, strict=True))
        + "."
    )
    softest = [(key, result) for key, result in results.variants.items() if "very soft" in key[0]]
    if softest:
        there = "; ".join(f"{sand} sand, {controller}: {told(result)}" for (_, sand, controller), result in softest)
        said.append(f"On level sand far softer than that, without a snag: {there}.")
    return tuple(said)


def platform_table(results: Results) -> PlainTable:
    """Fig. 6(a) in numbers, and what each wheel carries on level firm sand and on the slope."""
    rover = load_rover("curiosity")
    rows = [
        ("mass", f"{rover.mass_kg:g} kg"),
        ("gravity", f"{rover.gravity_mps2:g} m/s2"),
        ("weight", f"{rover.vertical_load_n:.0f} N"),
        ("weight per wheel", f"{rover.vertical_load_n / len(rover.wheels):.0f} N"),
        (
            "wheels, radius x width",
            f"{len(rover.wheels)}, {rover.wheels[0].radius_m:g} x {rover.wheels[0].width_m:g} m",
        ),
        (
            "axles behind the front one",
            ", ".join(f"{x:g}" for x in sorted({abs(w.x_m) for w in rover.wheels})),
        ),
        ("deepest in firm sand and stones", _deepest_before(results)),
    ]
    return PlainTable("Curiosity (Fig. 6a)", ("what", "value"), tuple(rows))


def variants_table(results: Results) -> PlainTable:
    """The reference case and what is left of it without its assumptions."""
    rows = [
        (
            variant,
            sand,
            controller,
            result.outcome,
            f"{result.largest_sinkage_mm:.0f}",
            f"{result.largest_zone_deg:.0f}",
            number(result.soft_omega_radps, "{:.2f}"),
            number(result.least_driven_n, "{:.0f}"),
        )
        for (variant, sand, controller), result in results.variants.items()
    ]
    headings = ("ground", "sand", "controller", "outcome", "sinkage, mm", "zone, deg", "omega, rad/s", "traction, N")
    return PlainTable(
        "The changed assumptions taken away one by one (largest, largest, mean, least)", headings, tuple(rows)
    )


def family_table(results: Results, sand: str) -> PlainTable:
    """All controllers on one kind of sand: counts, then medians with the 10 and 90 % quantiles."""
    rows = []
    for controller in BASELINES:
        drives = results.family[sand, controller]
        counts = [count(drives, PASSED if name == "drove off" else {name}) for name in _OUTCOMES]
        rows.append(
            (
                controller,
                *(str(times) for times in counts),
                spread((drive.largest_sinkage_mm for drive in drives), "{:.0f}"),
                spread((drive.largest_zone_deg for drive in drives), "{:.0f}"),
                spread((drive.held_omega_radps for drive in drives), "{:.2f}"),
                spread((drive.least_driven_n for drive in drives), "{:.0f}"),
            )
        )
    headings = (
        "controller",
        *_OUTCOMES,
        "sinkage, mm",
        "zone, deg",
        "omega while held, rad/s",
        "least traction while driven, N",
    )
    members = len(results.family[sand, SOIL_FLOW])
    return PlainTable(f"{members} random members, {sand} sand (median, 10 .. 90 %)", headings, tuple(rows))


def energy_table(results: Results) -> PlainTable:
    """Whether the motors put in at least what came out, over every drive."""
    drives = results.drives()
    shares = np.array([drive.useful_work_j / drive.wheel_work_j for drive in drives])
    rows = (
        ("drives", str(len(drives))),
        ("more work out than in", str(int((shares > 1.0).sum()))),
        ("work out / work in, median", f"{np.median(shares):.2f}"),
        ("work out / work in, largest", f"{shares.max():.2f}"),
    )
    return PlainTable("Energy: snag, slope and rolling losses against the motors' work", ("what", "value"), rows)


def lockstep_table(results: Results) -> PlainTable:
    """A part of one drive through the ROS graph, beside the drive without ROS."""
    found = results.lockstep
    differing = ", ".join(found["differing"]) or "none"
    rows = (
        ("control periods", str(found["cycles"])),
        ("numbers compared", str(found["numbers"])),
        ("series that differ", differing),
    )
    return PlainTable("Through the ROS graph in lockstep, and without ROS", ("what", "value"), rows)


def charts(results: Results) -> tuple[Chart, ...]:
    """Curves over time of the reference case, and the family in order of depth."""
    found = []
    for sand in SANDS:
        traces = {name: trace_of_drive(results.reference[sand, name]) for name in (SOIL_FLOW, SENSOR_LESS)}
        for title, unit, of in _OVER_TIME:
            curves = tuple(
                Curve(name, tuple(trace.time_s.tolist()), tuple(np.round(of(trace), 4).tolist()))
                for name, trace in traces.items()
            )
            found.append(Chart(f"{title}, {sand} sand", "time [s]", f"{title.lower()} [{unit}]", curves))
        depth = tuple(
            Curve(
                controller,
                tuple(float(number) for number in range(1, len(drives) + 1)),
                tuple(sorted(drive.largest_sinkage_mm for drive in drives)),
            )
            for controller, drives in ((name, results.family[sand, name]) for name in BASELINES)
        )
        found.append(Chart(f"Deepest sinkage of the members, {sand} sand", "members, by depth", "sinkage [mm]", depth))
    return tuple(found)


def _deepest_before(results: Results) -> str:
    trace = trace_of_drive(results.reference["trapping", SENSOR_LESS])
    at = results.reference["trapping", SENSOR_LESS].soft_at_s or math.inf
    chosen = trace.sinkage_mm[(trace.time_s > 2.0) & (trace.time_s < at - 1.0)]
    return f"{chosen.max():.0f} mm" if chosen.size else "-"
