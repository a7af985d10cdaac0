"""One drive of case study 2 and what came of it, as plain numbers; and the same drive through the ROS graph."""

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from missions.case_studies.baselines import baseline_plan
from missions.case_studies.graph_comparison import compare_with_graph
from missions.core_run import run_cores
from missions.plan import RunPlan
from missions.run_log import RunLog
from missions.summary import MOVING_MPS, summarize
from sim_bridge.plant import SNAG_ELAPSED, SPEED, X
from sim_bridge.scenarios import MarsCase, mars_scenario
from sim_bridge.world import World
from strap_rover import topics
from strap_rover.arrays import FloatArray
from strap_sensor_driver.contact_zone import ContactStatus

BLOCK = 10
"""Ground truth of so many stamps (0.2 s) is one row of a trace."""
CLEAR_OF_SNAG_M = 2.0
CLEAR_OF_BORDER_M = 15.0
"""So far into soft sand where nothing holds it a rover has passed."""
_PROGRESS_M = 0.1
_DRIVEN_RADPS = 0.1
_AFTER_RELEASE_S = 8.0
"""A rover that stands is watched so long after the snag let go."""


@dataclass(frozen=True, slots=True)
class Drive:
    """A controller on a case; `seed` makes stones, rock and the noise of the sensors."""

    case: MarsCase
    controller: str
    """A name in BASELINES."""
    seed: int
    duration_s: float
    standing_s: float = 30.0
    """Without progress for so long, the drive has ended."""
    is_whole: bool = False
    """Whether it goes on to `duration_s` even when decided."""
    is_traced: bool = False


@dataclass(frozen=True, slots=True)
class LockstepPart:
    """The first seconds of a drive, through the ROS graph in lockstep and without ROS, to be compared."""

    drive: Drive


@dataclass(frozen=True, slots=True)
class Trace:
    """A drive over time: rows of 0.2 s, each the mean over its time; per-wheel quantities have shape (rows, W)."""

    time_s: FloatArray
    x_m: FloatArray
    y_m: FloatArray
    heading_rad: FloatArray
    speed_mps: FloatArray
    external_load_n: FloatArray
    traction_n: FloatArray
    """Gross thrust of all wheels."""
    pull_n: FloatArray
    """Thrust less resistance of the soil, of all wheels."""
    zone_deg: FloatArray
    measured_zone_deg: FloatArray
    """As the straps have it; NaN while a strap reads with a fault."""
    sinkage_mm: FloatArray
    omega_radps: FloatArray
    """Commanded."""

    @classmethod
    def from_json(cls, item: Mapping[str, Any]) -> "Trace":
        """Read back what `to_json` made."""
        return cls(**{name: np.array(values, dtype=np.float64) for name, values in item.items()})

    def to_json(self) -> dict[str, Any]:
        """Plain lists with five significant digits; NaN as null."""
        return {name: _listed(getattr(self, name)) for name in self.__slots__}


@dataclass(frozen=True, slots=True)
class DriveResult:
    """What came of a drive. None where a thing never happened."""

    outcome: str
    lasted_s: float
    distance_m: float
    mode_at_end: str
    stalls: int
    largest_sinkage_mm: float
    largest_zone_deg: float
    zone_critical_at_s: float | None
    """When a wheel was first in contact over more than 80 deg."""
    soft_at_s: float | None
    """When the front axle reached the soft sand."""
    snag_at_s: float | None
    stopped_at_s: float | None
    """When the rover came to the place where it stands at the end."""
    least_traction_n: float | None
    """Least gross thrust of all wheels together after `soft_at_s`, means over 0.2 s."""
    least_driven_n: float | None
    """The same while the wheels are commanded to turn: a rover that waits needs none."""
    soft_omega_radps: float | None
    """Mean commanded speed of all wheels after `soft_at_s`."""
    held_omega_radps: float | None
    """The same while the snag holds."""
    angle_error_rms_deg: float
    wheel_work_j: float
    useful_work_j: float
    """Work against snag, slope and rolling losses."""
    trace: Trace | None

    @classmethod
    def from_json(cls, item: Mapping[str, Any]) -> "DriveResult":
        """Read back what `to_json` made."""
        trace = item["trace"]
        return cls(**{**item, "trace": None if trace is None else Trace.from_json(trace)})

    def to_json(self) -> dict[str, Any]:
        """Plain JSON values."""
        values = {name: getattr(self, name) for name in self.__slots__}
        return {**values, "trace": None if self.trace is None else self.trace.to_json()}


def plan_of(drive: Drive) -> RunPlan:
    """The plan of a drive."""
    scenario = mars_scenario(drive.case, duration_s=drive.duration_s)
    return baseline_plan(scenario, drive.controller, drive.seed, drive.duration_s)


def run_drive(drive: Drive) -> DriveResult:
    """Drive without ROS, to the end or until it is decided."""
    plan = plan_of(drive)
    return measure(drive, plan, run_cores(plan, until=None if drive.is_whole else _Decided(drive)))


def run_item(item: Drive | LockstepPart) -> dict[str, Any]:
    """Run what a study's folder holds results of, in a worker process; plain JSON values."""
    return compare_lockstep(item) if isinstance(item, LockstepPart) else run_drive(item).to_json()


class _Decided:
    """Whether a drive has come clear, or stands for good; asked each simulated second."""

    def __init__(self, drive: Drive) -> None:
        case = drive.case
        has_snag = case.sand.snag_n > 0.0
        self._clear_x = case.soft_from_m + (case.snag_after_m + CLEAR_OF_SNAG_M if has_snag else CLEAR_OF_BORDER_M)
        self._watched_s = case.sand.snag_s + _AFTER_RELEASE_S if has_snag else 0.0
        self._held_s = case.sand.snag_s if has_snag else 0.0
        self._places: deque[float] = deque(maxlen=round(drive.standing_s))

    def __call__(self, world: World) -> bool:
        body = world.plant.body
        self._places.append(float(body[X]))
        if 0.0 <= body[SNAG_ELAPSED] < self._held_s:
            return False
        if body[X] > self._clear_x and body[SPEED] > 2.0 * MOVING_MPS:
            return True
        if 0.0 <= body[SNAG_ELAPSED] < self._watched_s:
            return False
        is_full = len(self._places) == self._places.maxlen
        return is_full and self._places[-1] - self._places[0] < _PROGRESS_M


def measure(drive: Drive, plan: RunPlan, log: RunLog) -> DriveResult:
    """A drive in numbers, from its log."""
    summary = summarize(plan, log)
    trace = trace_of(log)
    omega = trace.omega_radps.mean(axis=1)
    in_soft = trace.x_m >= drive.case.soft_from_m
    is_held = trace.external_load_n > 0.0
    critical = trace.zone_deg.max(axis=1) > 80.0
    is_driven = in_soft & (omega > _DRIVEN_RADPS)
    stands = summary.final_speed_mps < MOVING_MPS
    return DriveResult(
        outcome=summary.outcome,
        lasted_s=summary.duration_s,
        distance_m=_rounded(summary.distance_m),
        mode_at_end=summary.mode_at_end,
        stalls=summary.stalls,
        largest_sinkage_mm=_rounded(summary.largest_sinkage_mm),
        largest_zone_deg=_rounded(summary.largest_zone_deg),
        zone_critical_at_s=_first(trace.time_s, critical),
        soft_at_s=_first(trace.time_s, in_soft),
        snag_at_s=_first(trace.time_s, is_held),
        stopped_at_s=_first(trace.time_s, trace.x_m > trace.x_m[-1] - _PROGRESS_M) if stands else None,
        least_traction_n=_rounded(trace.traction_n[in_soft].min()) if in_soft.any() else None,
        least_driven_n=_rounded(trace.traction_n[is_driven].min()) if is_driven.any() else None,
        soft_omega_radps=_rounded(omega[in_soft].mean()) if in_soft.any() else None,
        held_omega_radps=_rounded(omega[is_held].mean()) if is_held.any() else None,
        angle_error_rms_deg=_rounded(summary.angle_error_rms_deg),
        wheel_work_j=_rounded(summary.wheel_work_j),
        useful_work_j=_rounded(_useful_work(plan, log)),
        trace=trace if drive.is_traced else None,
    )


def trace_of(log: RunLog) -> Trace:
    """The trace of a log; ValueError when it is shorter than one row."""
    row = topics.GROUND_TRUTH
    time_s = log.time_s(row)
    if time_s.size < BLOCK:
        raise ValueError(f"a trace needs {BLOCK} stamps of ground truth, the log holds {time_s.size}; drive longer")

    def of_wheels(quantity: str) -> FloatArray:
        return log.of_wheels(row, quantity)

    command_s, angle_s = log.time_s(topics.TRACTION_COMMANDS), log.time_s(topics.CONTACT_ANGLES)
    status = log.of_wheels(topics.CONTACT_ANGLES, "status")
    seen = log.of_wheels(topics.CONTACT_ANGLES, "theta_1") - log.of_wheels(topics.CONTACT_ANGLES, "theta_2")
    seen = np.where(status >= ContactStatus.FAULT_OPEN_A, math.nan, np.degrees(seen))
    ends = time_s[BLOCK - 1 :: BLOCK]
    return Trace(
        time_s=_blocks(time_s),
        x_m=_blocks(log.of_rover(row, "x")),
        y_m=_blocks(log.of_rover(row, "y")),
        heading_rad=_blocks(log.of_rover(row, "heading")),
        speed_mps=_blocks(log.of_rover(row, "speed")),
        external_load_n=_blocks(log.of_rover(row, "external_load")),
        traction_n=_blocks(of_wheels("traction").sum(axis=1)),
        pull_n=_blocks(of_wheels("drawbar_pull").sum(axis=1)),
        zone_deg=_blocks(np.degrees(of_wheels("theta_1") - of_wheels("theta_2"))),
        measured_zone_deg=_at(ends, angle_s, seen),
        sinkage_mm=_blocks(1e3 * of_wheels("sinkage")),
        omega_radps=_at(ends, command_s, log.commands()),
    )


def compare_lockstep(part: LockstepPart) -> dict[str, Any]:
    """Run a part both ways; how many numbers were compared, and the series in which any differ."""
    plan = plan_of(part.drive)
    compared = compare_with_graph(plan)
    if compared is None:
        raise RuntimeError("the part through the graph ended before its time, though nobody stopped it")
    return {
        "cycles": plan.cycles,
        "numbers": compared.values,
        "differing": list(compared.differing_series),
        "drive": part.drive.controller,
    }


def _useful_work(plan: RunPlan, log: RunLog) -> float:
    """Against snag, slope and rolling losses [J]."""
    row = topics.GROUND_TRUTH
    x, y = log.of_rover(row, "x"), log.of_rover(row, "y")
    step = np.hypot(np.diff(x), np.diff(y)) * np.sign(np.diff(x))
    weight = plan.rover.vertical_load_n
    against = weight * np.sin(log.of_rover(row, "slope")) + log.of_rover(row, "external_load")
    losses = plan.rover.rolling_loss_n * len(plan.rover.wheels) * np.abs(step).sum()
    return float(np.sum(0.5 * (against[1:] + against[:-1]) * step) + losses)


def _blocks(values: FloatArray) -> FloatArray:
    """Means over each BLOCK rows; what is left over at the end is left out."""
    count = values.shape[0] // BLOCK
    return np.asarray(values[: count * BLOCK].reshape(count, BLOCK, *values.shape[1:]).mean(axis=1))


def _at(when_s: FloatArray, stamps_s: FloatArray, values: FloatArray) -> FloatArray:
    """The last value at or before each time; the first where there is none."""
    index = np.searchsorted(stamps_s, when_s + 1e-9, side="right") - 1
    return np.asarray(values[np.maximum(index, 0)])


def _first(time_s: FloatArray, happens: np.ndarray[Any, np.dtype[np.bool_]]) -> float | None:
    return _rounded(time_s[int(np.argmax(happens))]) if happens.any() else None


def _listed(values: FloatArray) -> Any:
    if values.ndim > 1:
        return [_listed(row) for row in values]
    return [None if math.isnan(value) else float(f"{value:.5g}") for value in values.tolist()]


def _rounded(value: float | np.floating[Any]) -> float:
    return float(f"{float(value):.6g}")
