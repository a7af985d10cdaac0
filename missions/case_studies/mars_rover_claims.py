"""What case study 2 finds, stated value by stated value beside the source paper, in the order of the figures."""

import math
from collections.abc import Iterable

import numpy as np

from missions.case_studies.baselines import SOIL_FLOW
from missions.case_studies.mars_rover import AS_PRINTED, SANDS, SENSOR_LESS, Form, Results
from missions.case_studies.mars_rover_runs import DriveResult, Trace
from missions.case_studies.study_result import Claim, Verdict
from missions.summary import BURIED_ZONE_DEG, MOVING_MPS, Outcome
from strap_rover.arrays import FloatArray
from strap_rover.rover import RoverDescription, load_rover

STATED_TRACTION_N = 280.0
"""The source paper: with the sensor the traction does not fall below this."""
STATED_SOFT_AT_S = 50.0
ROVER_WEIGHT = (899.0, 3.711, 0.25, 0.40)
"""Stated: mass [kg], gravity [m/s^2], wheel radius and width [m]."""
PASSED = frozenset({Outcome.PASSED.value, Outcome.DROVE_OFF.value})
LOST = frozenset({Outcome.BURIED.value, Outcome.STUCK.value})


def claims(results: Results, form: Form) -> list[Claim]:
    """Stated values beside ours, in the order of the figures."""
    rover = load_rover("curiosity")
    free, less = results.reference["trapping", SOIL_FLOW], results.reference["trapping", SENSOR_LESS]
    free_trace, less_trace = trace_of_drive(free), trace_of_drive(less)
    weight = rover.vertical_load_n / len(rover.wheels)
    return [
        Claim(
            "Fig. 6(a)",
            "platform",
            "899 kg, 3.711 m/s2, wheels 0.25 x 0.40 m",
            f"{rover.mass_kg:g} kg, {rover.gravity_mps2:g} m/s2, wheels {rover.wheels[0].radius_m:g} x "
            f"{rover.wheels[0].width_m:g} m, {weight:.0f} N each",
            _if(_is_stated_rover(rover), Verdict.REPRODUCED),
            "put in, not a result",
        ),
        Claim(
            "Fig. 6(b), 15",
            "mission field",
            "picture of a NASA model",
            "stones, rock and soft sand from a seed",
            Verdict.NO_NUMBER,
            "picture mars_rover_field.png",
        ),
        Claim(
            "Sec. 5.2",
            "soft sand is reached at 2 rad/s",
            "after 50 s",
            seconds(less.soft_at_s),
            _if(abs((less.soft_at_s or math.inf) - STATED_SOFT_AT_S) < 5.0, Verdict.REPRODUCED),
            f"its place, {form.reference.soft_from_m:g} m, is chosen for it",
        ),
        _sinkage_claim(less, form.reference.soft_from_m),
        Claim(
            "Fig. 16(a)",
            "sensor-based rover",
            "moves on without sticking",
            told(free),
            _if(free.outcome in PASSED, Verdict.CHANGED),
            "slope and snag",
        ),
        Claim(
            "Fig. 16(b)",
            "sensor-less rover sticks",
            "after 90 s",
            told(less),
            _if(less.outcome in LOST, Verdict.CHANGED),
            "slope and snag; it stands from where the snag caught it",
        ),
        Claim(
            "Fig. 17(a)",
            "sensor-less contact zone",
            "critical, 80 deg",
            f"{less.largest_zone_deg:.0f} deg, over 80 from {seconds(less.zone_critical_at_s)}",
            _if(less.largest_zone_deg > BURIED_ZONE_DEG, Verdict.CHANGED),
            "slope, snag, trapping sand",
        ),
        Claim(
            "Fig. 17(a)",
            "sensor-based contact zone",
            "stays below 80 deg",
            f"{free.largest_zone_deg:.0f} deg at most",
            _if(free.largest_zone_deg < BURIED_ZONE_DEG, Verdict.CHANGED),
            f"straps read it to {free.angle_error_rms_deg:.2f} deg rms per end",
        ),
        _omega_claim(free, free_trace),
        _first_pull_claim(free, less),
        _overload_claim(free, less),
        _fall_claim(less, less_trace),
        _zero_claim(less_trace),
        Claim(
            "Fig. 18",
            "sensor-less rover after 150 s",
            "completely stuck",
            _late_speed(less_trace),
            _if(_late_mps(less_trace) < MOVING_MPS, Verdict.CHANGED),
            "",
        ),
        _least_traction_claim(results, free),
        *_printed_claims(results),
        *_family_claims(results, form),
    ]


def _sinkage_claim(less: DriveResult, soft_from: float) -> Claim:
    """Of all wheels while the rover drives freely."""
    trace = trace_of_drive(less)
    is_free = trace.time_s < (less.snag_at_s or math.inf)
    firm = trace.sinkage_mm[(trace.x_m > 1.0) & (trace.x_m < soft_from)]
    soft = trace.sinkage_mm[is_free & (trace.x_m > soft_from + 2.0)]
    if not (firm.size and soft.size):
        return Claim("Fig. 15, 16", "sinkage", "more in soft sand", "not reached", Verdict.NOT_REPRODUCED)
    return Claim(
        "Fig. 15, 16",
        "sinkage of the wheels",
        "more in the soft sand; no number",
        f"median {np.median(firm):.0f} mm on firm sand and stones, {np.median(soft):.0f} mm in soft sand",
        _if(float(np.median(soft)) > 1.2 * float(np.median(firm)), Verdict.REPRODUCED),
        "sensor-less rover before the snag, trapping sand",
    )


def _omega_claim(free: DriveResult, trace: Trace) -> Claim:
    soft_at, snag_at = free.soft_at_s, free.snag_at_s
    before = _mean(trace.omega_radps.mean(axis=1), trace.time_s, soft_at, snag_at)
    held = free.held_omega_radps
    is_less = held is not None and before is not None and held < 0.5 * before
    return Claim(
        "Fig. 17(b)",
        "sensor-based wheel speed",
        "significantly reduced in the soft sand",
        f"{number(before, '{:.2f}')} rad/s in soft sand, {number(held, '{:.2f}')} rad/s while held (means)",
        _if(is_less, Verdict.CHANGED),
        "where the sand carries it is not reduced; where the rover is held, it is, and it waits",
    )


def _first_pull_claim(free: DriveResult, less: DriveResult) -> Claim:
    means = [
        _mean(trace_of_drive(one).traction_n, trace_of_drive(one).time_s, one.soft_at_s, one.snag_at_s)
        for one in (less, free)
    ]
    return Claim(
        "Fig. 18",
        "traction 50 to 68 s, sensor-less and sensor-based",
        "sensor-less pulls more",
        f"{number(means[0], '{:.0f}')} and {number(means[1], '{:.0f}')} N (means from soft sand to snag, totals)",
        _if(_is_more(*means), Verdict.CHANGED),
        "both drive freely until the snag: the same resistance asks for the same traction",
    )


def _overload_claim(free: DriveResult, less: DriveResult) -> Claim:
    peaks = []
    for trace in (trace_of_drive(less), trace_of_drive(free)):
        held = trace.traction_n[trace.external_load_n > 0.0]
        peaks.append(float(held.max()) if held.size else None)
    return Claim(
        "Fig. 18",
        "greatest traction while held, sensor-less and sensor-based",
        "sensor-less pulls more at first",
        f"{number(peaks[0], '{:.0f}')} and {number(peaks[1], '{:.0f}')} N (totals)",
        _if(_is_more(*peaks), Verdict.CHANGED),
        "it spins and digs where the other waits; the time is the snag's",
    )


def _is_more(one: float | None, other: float | None) -> bool:
    """By more than one per cent."""
    return one is not None and other is not None and one > 1.01 * other


def _fall_claim(less: DriveResult, trace: Trace) -> Claim:
    peak = int(np.argmax(trace.traction_n))
    last = float(trace.traction_n[trace.time_s > trace.time_s[-1] - 10.0].mean())
    falls = less.outcome in LOST and last < 0.7 * float(trace.traction_n[peak])
    return Claim(
        "Fig. 18",
        "sensor-less traction falls",
        "from 70 s",
        f"from {trace.traction_n[peak]:.0f} N at {trace.time_s[peak]:.0f} s to {last:.0f} N (gross, total)",
        _if(falls, Verdict.CHANGED),
        "slope, snag, trapping sand",
    )


def _zero_claim(trace: Trace) -> Claim:
    chosen = trace.time_s > trace.time_s[-1] - 10.0
    gross, net = float(trace.traction_n[chosen].mean()), float(trace.pull_n[chosen].mean())
    return Claim(
        "Fig. 18, Sec. 6",
        "sensor-less traction in the end",
        "zero",
        f"gross {gross:.0f} N, less the resistance of the soil {net:.0f} N",
        _if(abs(gross) < 0.05 * STATED_TRACTION_N, Verdict.CHANGED, Verdict.NOT_PHYSICAL),
        "a wheel that turns in sand shears it always; what vanishes is what is left after the soil's resistance",
    )


def _least_traction_claim(results: Results, free: DriveResult) -> Claim:
    least = free.least_driven_n
    family = [drive.least_driven_n for sand in SANDS for drive in results.family[sand, SOIL_FLOW]]
    known = [value for value in family if value is not None]
    below = sum(value < STATED_TRACTION_N for value in known)
    return Claim(
        "Fig. 18, Sec. 6",
        "sensor-based traction",
        "never below 280 N",
        f"{number(least, '{:.0f}')} N or more in soft sand while driven, {number(free.least_traction_n, '{:.0f}')} N "
        f"with the waits; below 280 N while driven in {below} of {len(known)} members (least {min(known):.0f} N)",
        _if(least is not None and least >= STATED_TRACTION_N, Verdict.CHANGED),
        "gross, of the whole rover: one wheel's is at most some 273 N on this sand",
    )


def _printed_claims(results: Results) -> list[Claim]:
    found = []
    for sand in SANDS:
        less = results.variants[AS_PRINTED, sand, SENSOR_LESS]
        found.append(
            Claim(
                "Sec. 5.2",
                f"as printed: level, no snag, {sand} sand",
                "sensor-less rover sticks",
                told(less),
                _if(less.outcome in LOST, Verdict.REPRODUCED, Verdict.NOT_PHYSICAL),
                "thrust less resistance stays positive on level sand that carries the rover",
            )
        )
    return found


def _family_claims(results: Results, form: Form) -> list[Claim]:
    found = []
    for sand in SANDS:
        less, free = results.family[sand, SENSOR_LESS], results.family[sand, SOIL_FLOW]
        lost = count(less, LOST)
        buried = sum(drive.largest_zone_deg > BURIED_ZONE_DEG and drive.outcome in LOST for drive in less)
        clear = count(free, PASSED)
        half = 0.5 * form.members
        found += [
            Claim(
                "Fig. 16, 17",
                f"sensor-less rover, {form.members} members, {sand} sand",
                "sticks, zone over 80 deg",
                f"sticks in {lost}, with a zone over 80 deg in {buried}",
                _if(buried > half, Verdict.CHANGED),
                "counted as reproduced when more than half do",
            ),
            Claim(
                "Fig. 16, 17",
                f"sensor-based rover, {form.members} members, {sand} sand",
                "passes",
                f"comes clear in {clear}",
                _if(clear > half, Verdict.CHANGED),
                f"slip 0.3: {count(results.family[sand, 'slip 0.3'], PASSED)}",
            ),
        ]
    return found


def trace_of_drive(result: DriveResult) -> Trace:
    """The trace of a drive of the reference case; ValueError where there is none."""
    if result.trace is None:
        raise ValueError("this drive was not traced; trace the drives of the reference case")
    return result.trace


def told(result: DriveResult) -> str:
    """How a drive ended, to go on after the name of the rover."""
    zone = f"widest zone {result.largest_zone_deg:.0f} deg"
    if result.outcome in PASSED:
        return f"passes, {result.largest_sinkage_mm:.0f} mm deep at most, {zone}"
    if result.outcome == Outcome.UNDECIDED.value:
        return f"has not come clear when the drive ends at {result.lasted_s:.0f} s, {zone}"
    return (
        f"stands from {seconds(result.stopped_at_s)} on ({result.outcome}, {result.largest_sinkage_mm:.0f} mm, {zone})"
    )


def _late_mps(trace: Trace) -> float:
    late = trace.time_s > 0.94 * trace.time_s[-1]
    return float(np.abs(trace.speed_mps[late]).max())


def _late_speed(trace: Trace) -> str:
    return f"at most {1e3 * _late_mps(trace):.1f} mm/s from {0.94 * trace.time_s[-1]:.0f} s on"


def _mean(values: FloatArray, time_s: FloatArray, begins: float | None, ends: float | None) -> float | None:
    if begins is None or ends is None:
        return None
    chosen = values[(time_s >= begins) & (time_s < ends)]
    return float(chosen.mean()) if chosen.size else None


def _is_stated_rover(rover: RoverDescription) -> bool:
    wheels = {(wheel.radius_m, wheel.width_m) for wheel in rover.wheels}
    return (rover.mass_kg, rover.gravity_mps2, wheels) == (*ROVER_WEIGHT[:2], {ROVER_WEIGHT[2:]})


def count(drives: Iterable[DriveResult], outcomes: Iterable[str]) -> int:
    """How many drives ended so."""
    wanted = set(outcomes)
    return sum(drive.outcome in wanted for drive in drives)


def spread(values: Iterable[float | None], form: str) -> str:
    """Median and 10 to 90 % quantiles of what is known."""
    known = np.array([value for value in values if value is not None])
    if not known.size:
        return "-"
    low, middle, high = np.quantile(known, [0.1, 0.5, 0.9]).tolist()
    return f"{form.format(middle)} ({form.format(low)} .. {form.format(high)})"


def number(value: float | None, form: str) -> str:
    """A number in a form, or a dash."""
    return "-" if value is None else form.format(value)


def seconds(value: float | None) -> str:
    """A time in whole seconds, or never."""
    return "never" if value is None else f"{value:.0f} s"


def _if(holds: bool, verdict: Verdict, otherwise: Verdict = Verdict.NOT_REPRODUCED) -> Verdict:
    return verdict if holds else otherwise
