"""What came of a run, in numbers and in words, from its log."""

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from enum import Enum
from pathlib import Path

import numpy as np

from missions.plan import RunPlan
from missions.run_log import RunLog
from missions.soil_truth import soil_truth
from sim_bridge.terrain import Terrain
from sim_bridge.world import site_of
from soil_flow_estimator.soil_state import ForecastVerdict
from strap_rover import topics
from strap_rover.arrays import FloatArray
from strap_sensor_driver.contact_zone import ContactStatus
from traction_controller.supervisor import Fault, TractionMode

BURIED_ZONE_DEG = 80.0
"""Contact zone beyond which a wheel that no longer moves counts as buried."""
MOVING_MPS = 0.02
"""Mean speed over the last two seconds below which the rover counts as standing."""
START_S = 5.0
"""A run shorter than this cannot be stuck: it has hardly started."""
CLEAR_M = 1.0
"""How far beyond the snag's x the rover must come to count as having driven off."""


class Outcome(Enum):
    """How a run ended."""

    DROVE_OFF = "drove off"
    """Held back by the snag, and on its way again."""
    PASSED = "passed"
    """Still driving, and nothing held it."""
    BURIED = "buried"
    """Stands, and a wheel was in contact over more than 80 deg, whatever the supervisor says."""
    STUCK = "stuck"
    """Stands with its wheels driven."""
    HALTED = "halted"
    """The supervisor gave up, or waits for a fault to go: the rover stands on purpose."""
    UNDECIDED = "undecided"
    """The run ended too soon to tell: starting, waiting after a stall, trying again, or not yet clear of the snag."""


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happened."""

    time_s: float
    what: str


@dataclass(frozen=True, slots=True)
class RunSummary:
    """A run in numbers; unit suffixes in the names. Two runs with equal plans have equal summaries."""

    scenario: str
    controller: str
    seed: int
    duration_s: float
    facts: Mapping[str, float]
    """What the scenario drew."""
    outcome: str
    distance_m: float
    final_speed_mps: float
    """Mean over the last two seconds."""
    largest_sinkage_mm: float
    final_sinkage_mm: float
    largest_zone_deg: float
    largest_slip: float
    """After the first two seconds: a standing start is full slip."""
    stalls: int
    retries: int
    """Most attempts used between two free drives."""
    mode_at_end: str
    faults: tuple[str, ...]
    wheel_work_j: float
    """Work of the motors on the wheels."""
    load_work_j: float
    """Work of the rover against snag and drawbar load."""
    climb_work_j: float
    """Work against its own weight, uphill positive."""
    lost_work_j: float
    """What the motors gave and neither load, height nor speed has: what soil and rolling took. Negative on no run."""
    angle_error_rms_deg: float
    """theta_1 and theta_2 as measured against the true ones, valid readings, after the first second."""
    predicted_share: float
    """Readings bridged over the seam of the strap."""
    faulty_share: float
    static_de: tuple[float, ...]
    """Deformability per wheel as first estimated; NaN-free: -1 where it never was."""
    final_soil: Mapping[str, tuple[float, ...]]
    """de, st, de_std and st_std as estimated in the end, and true_de and true_st of the ground there, per wheel.

    -1 where there is none: ground whose shear is not the family's has no st. Empty when nothing was ever estimated.
    """
    forecast_stop_s: float
    """When the halting forecast first said STOP; -1 when it never did."""
    largest_scout_z: float
    """Of the halting score; 0 when there never was a forecast."""
    forecast_at_end: str
    """ForecastVerdict."""
    events: tuple[Event, ...]

    def to_json(self) -> str:
        """As JSON text, sorted and indented."""
        return json.dumps(asdict(self), indent=2, sort_keys=True, allow_nan=False) + "\n"


def summarize(plan: RunPlan, log: RunLog) -> RunSummary:
    """The summary of a run; ValueError when the log holds no ground truth to judge by."""
    time_s = log.time_s(topics.GROUND_TRUTH)
    if time_s.size == 0:
        raise ValueError("the run is too short to be summed up: no ground truth was recorded; run at least 0.1 s")
    x = log.of_rover(topics.GROUND_TRUTH, "x")
    speed = log.of_rover(topics.GROUND_TRUTH, "speed")
    load = log.of_rover(topics.GROUND_TRUTH, "external_load")
    sinkage = log.of_wheels(topics.GROUND_TRUTH, "sinkage").max(axis=1)
    zone = _true_zone_deg(log).max(axis=1)
    slip = log.of_wheels(topics.GROUND_TRUTH, "slip")
    settled = time_s >= min(2.0, time_s[-1])
    final_speed = float(speed[time_s >= time_s[-1] - 2.0].mean())
    modes = log.of_rover(topics.TRACTION_STATE, "state").astype(int)
    mode_at_end = TractionMode(int(modes[-1])) if modes.size else TractionMode.STANDBY
    retries = log.of_rover(topics.TRACTION_STATE, "retries")
    faults = np.unique(log.of_rover(topics.TRACTION_STATE, "fault").astype(int))
    status = log.of_wheels(topics.CONTACT_ANGLES, "status").astype(int)
    snag_x = float(x[np.argmax(load > load[0])]) if (load > load[0]).any() else None
    outcome = outcome_of(abs(final_speed), float(zone.max()), mode_at_end, float(x[-1]), snag_x, float(time_s[-1]))
    wheel_work, load_work = _wheel_work(log, time_s), _integral(load * speed, time_s)
    slope = log.of_rover(topics.GROUND_TRUTH, "slope")
    site = site_of(plan.scenario, plan.rover, plan.seed)
    verdicts = log.of_rover(topics.SOIL_STATE, "scout_verdict").astype(int)
    stopped = verdicts == ForecastVerdict.STOP
    score = log.of_rover(topics.SOIL_STATE, "scout_z")[verdicts != ForecastVerdict.NONE]
    climb_work = _integral(plan.rover.vertical_load_n * np.sin(slope) * speed, time_s)
    return RunSummary(
        scenario=plan.scenario.name,
        controller=plan.controller.policy,
        seed=plan.seed,
        duration_s=round(float(time_s[-1]), 6),
        facts=dict(site.facts),
        outcome=outcome.value,
        distance_m=_rounded(x[-1] - x[0]),
        final_speed_mps=_rounded(final_speed),
        largest_sinkage_mm=_rounded(1e3 * sinkage.max()),
        final_sinkage_mm=_rounded(1e3 * sinkage[-1]),
        largest_zone_deg=_rounded(zone.max()),
        largest_slip=_rounded(slip[settled].max()),
        stalls=int(np.count_nonzero(np.diff(modes) * (modes[1:] == TractionMode.STALL))) if modes.size else 0,
        retries=int(retries.max()) if retries.size else 0,
        mode_at_end=mode_at_end.name,
        faults=tuple(Fault(int(code)).name for code in faults if code),
        wheel_work_j=_rounded(wheel_work),
        load_work_j=_rounded(load_work),
        climb_work_j=_rounded(climb_work),
        lost_work_j=_rounded(wheel_work - load_work - climb_work - 0.5 * plan.rover.mass_kg * speed[-1] ** 2),
        angle_error_rms_deg=_rounded(_angle_error_deg(log, time_s, status)),
        predicted_share=_rounded(np.mean(status == ContactStatus.PREDICTED) if status.size else 0.0),
        faulty_share=_rounded(np.mean(status >= ContactStatus.FAULT_OPEN_A) if status.size else 0.0),
        static_de=_static_de(log),
        final_soil=_final_soil(plan, log, site.terrain),
        forecast_stop_s=_rounded(log.time_s(topics.SOIL_STATE)[int(np.argmax(stopped))]) if stopped.any() else -1.0,
        largest_scout_z=_rounded(score.max()) if score.size else 0.0,
        forecast_at_end=ForecastVerdict(int(verdicts[-1]) if verdicts.size else 0).name,
        events=run_events(log),
    )


def run_events(log: RunLog) -> tuple[Event, ...]:
    """Snag, mode changes and faults, in order of time. Switching between DRIVE and LIMIT is left out."""
    events: list[Event] = []
    time_s = log.time_s(topics.GROUND_TRUTH)
    load = log.of_rover(topics.GROUND_TRUTH, "external_load")
    for index in np.flatnonzero(np.diff(load)) + 1:
        what = f"snag of {load[index]:.0f} N catches" if load[index] > load[index - 1] else "snag lets go"
        events.append(Event(_rounded(time_s[index]), what))
    time_s = log.time_s(topics.TRACTION_STATE)
    modes = log.of_rover(topics.TRACTION_STATE, "state").astype(int)
    driving = {TractionMode.DRIVE, TractionMode.LIMIT}
    for index in np.flatnonzero(np.diff(modes)) + 1:
        before, after = TractionMode(int(modes[index - 1])), TractionMode(int(modes[index]))
        if not {before, after} <= driving:
            events.append(Event(_rounded(time_s[index]), after.name))
    faults = log.of_rover(topics.TRACTION_STATE, "fault").astype(int)
    events += [
        Event(_rounded(time_s[index]), f"fault {Fault(int(faults[index])).name}")
        for index in np.flatnonzero(np.diff(faults)) + 1
        if faults[index]
    ]
    return tuple(sorted(events, key=lambda event: event.time_s))


def write_summary(summary: RunSummary, path: Path) -> None:
    """Write `summary.json`."""
    path.write_text(summary.to_json(), encoding="utf-8")


def outcome_of(
    final_speed: float, largest_zone_deg: float, mode: TractionMode, x: float, snag_x: float | None, lasted_s: float
) -> Outcome:
    """How a run ended, from its mean speed at the end [m/s], its widest zone, its mode and place at the end [m].

    `snag_x` is where it was held back [m], None where nothing held it.
    """
    if final_speed < MOVING_MPS:
        if largest_zone_deg > BURIED_ZONE_DEG:
            return Outcome.BURIED
        if mode in {TractionMode.HALT, TractionMode.FAULT}:
            return Outcome.HALTED
        is_driven = mode in {TractionMode.DRIVE, TractionMode.LIMIT}
        return Outcome.STUCK if is_driven and lasted_s >= START_S else Outcome.UNDECIDED
    if snag_x is None:
        return Outcome.PASSED
    return Outcome.DROVE_OFF if x > snag_x + CLEAR_M else Outcome.UNDECIDED


def _true_zone_deg(log: RunLog) -> FloatArray:
    theta_1 = log.of_wheels(topics.GROUND_TRUTH, "theta_1")
    theta_2 = log.of_wheels(topics.GROUND_TRUTH, "theta_2")
    return np.asarray(np.degrees(np.abs(theta_1 - theta_2)))  # backwards, the entry is the rear end


def _wheel_work(log: RunLog, time_s: FloatArray) -> float:
    """Integral of true torque times commanded wheel speed [J]: the motors follow their commands within 0.1 s."""
    torque = log.of_wheels(topics.GROUND_TRUTH, "torque")
    stamps = log.time_s(topics.TRACTION_COMMANDS)
    commands = log.commands()
    omega = np.stack([np.interp(time_s, stamps, commands[:, wheel]) for wheel in range(commands.shape[1])], axis=1)
    return _integral((torque * omega).sum(axis=1), time_s)


def _integral(values: FloatArray, over: FloatArray) -> float:
    """Trapezoidal rule (numpy has it under different names in 1.26 and 2.x)."""
    return float(np.sum(0.5 * (values[1:] + values[:-1]) * np.diff(over)))


def _angle_error_deg(
    log: RunLog, truth_s: FloatArray, status: np.ndarray[tuple[int, ...], np.dtype[np.int64]]
) -> float:
    stamps = log.time_s(topics.CONTACT_ANGLES)
    good = (status == ContactStatus.VALID) & (stamps > 1.0)[:, None]
    if not good.any():
        return 0.0
    squares = 0.0
    for quantity in ("theta_1", "theta_2"):
        measured = log.of_wheels(topics.CONTACT_ANGLES, quantity)
        truth = log.of_wheels(topics.GROUND_TRUTH, quantity)
        for wheel in range(measured.shape[1]):
            error = measured[:, wheel] - np.interp(stamps, truth_s, truth[:, wheel])
            squares += float((error[good[:, wheel]] ** 2).sum())
    return math.degrees(math.sqrt(squares / (2.0 * good.sum())))


def _static_de(log: RunLog) -> tuple[float, ...]:
    de = log.of_wheels(topics.SOIL_STATE, "de")
    status = log.of_wheels(topics.SOIL_STATE, "status")
    known = status >= 2.0
    first = [int(np.argmax(known[:, wheel])) if known[:, wheel].any() else -1 for wheel in range(de.shape[1])]
    return tuple(_rounded(de[row, wheel]) if row >= 0 else -1.0 for wheel, row in enumerate(first))


def _final_soil(plan: RunPlan, log: RunLog, terrain: Terrain) -> dict[str, tuple[float, ...]]:
    if not log.time_s(topics.SOIL_STATE).size:
        return {}
    found = {name: log.of_wheels(topics.SOIL_STATE, name)[-1] for name in ("de", "st", "de_std", "st_std")}
    place = (log.of_rover(topics.GROUND_TRUTH, name)[-1:] for name in ("x", "y", "heading"))
    truth = soil_truth(terrain, plan.rover, *place)
    found |= {"true_de": truth.de[0], "true_st": np.nan_to_num(truth.st[0], nan=-1.0)}
    return {name: tuple(_rounded(value) for value in values) for name, values in found.items()}


def _rounded(value: float | np.floating) -> float:
    """Nine significant digits: more than any sensor, fewer than differ between two machines."""
    return float(f"{float(value):.9g}")
