"""Soil filter and halting forecast by themselves, beside the control period."""

import time
from collections.abc import Callable
from statistics import median

import numpy as np

from benchmarks.rounds import ROUNDS
from benchmarks.row import Goal, Row, figures, percentile
from missions.plan import CYCLE_NS
from soil_flow_estimator.halting_forecast import ForecastLimits, HaltingForecast
from soil_flow_estimator.soil_filter import (
    HAS_ANGLES,
    LOAD,
    RIM_SPEED,
    SLIP_SEEN,
    SLIP_STD,
    THETA_1,
    THETA_2,
    TORQUE,
    VAR_1,
    VAR_2,
    FilterNoise,
    SoilFilter,
)
from strap_rover.arrays import FloatArray
from strap_rover.rover import RoverDescription, load_rover
from strap_rover.terramechanics.contact import Wheel
from strap_rover.terramechanics.slip_sinkage import DiggableSoil, steady_wheel
from strap_rover.terramechanics.soil import soil_from_de_st

UPDATES, WARMING = 2000, 200
STEP_S, SPEED_MPS = 0.1, 0.4
SLIPS = np.linspace(0.12, 0.28, 6)
"""One per wheel."""
SOIL = (0.3, 0.4)
ANGLE_STD_RAD, TORQUE_STD_NM = 0.0134, 1.0


def soil_filter() -> Row:
    """One update of the filter for six wheels that roll in soft sand at slips of 0.12 to 0.28, torque used.

    Readings with noise, so that it linearises as often as it does on the way; ten updates per second are needed. The
    reference is the control period, on processor time of one thread.
    """
    return _row("soil_filter", "soil filter, one update of six wheels", lambda: _timed(_filter_updates()))


def halting_forecast() -> Row:
    """One update of the halting forecast, in the soil that the filter has found on the drive of `soil_filter`."""
    return _row("halting_forecast", "halting forecast, one update", lambda: _timed(_forecast_updates()))


def _row(name: str, what: str, round_ns: Callable[[], list[int]]) -> Row:
    rounds = [round_ns() for _ in range(ROUNDS)]
    middles = [median(times) for times in rounds]
    tails = [percentile(times, 0.99) for times in rounds]
    return Row(
        name,
        f"{what}, median share of the period",
        f"p50 {figures(median(middles) / 1e3)} us, p99 {figures(median(tails) / 1e3)} us",
        f"{CYCLE_NS / 1e6:g} ms period",
        tuple(middle / CYCLE_NS for middle in middles),
        Goal("<=", 0.10, "%"),
        "%",
    )


def _timed(update: Callable[[int], object]) -> list[int]:
    times = []
    for number in range(WARMING + UPDATES):
        start = time.thread_time_ns()
        update(number)
        taken = time.thread_time_ns() - start
        if number >= WARMING:
            times.append(taken)
    return times


def _filter_updates() -> Callable[[int], object]:
    rover = load_rover("curiosity")
    readings, noise, filtered = _readings(rover), FilterNoise(), SoilFilter(rover)
    return lambda number: filtered.update(
        readings[number], SPEED_MPS, SPEED_MPS * STEP_S, STEP_S, noise, uses_torque=True
    )


def _forecast_updates() -> Callable[[int], object]:
    rover = load_rover("curiosity")
    readings, noise, filtered = _readings(rover), FilterNoise(), SoilFilter(rover)
    for reading in readings[:WARMING]:
        filtered.update(reading, SPEED_MPS, SPEED_MPS * STEP_S, STEP_S, noise, uses_torque=True)
    forecast, limits = HaltingForecast(rover, noise.excavation_depth_m), ForecastLimits()
    rim = float(np.mean(SPEED_MPS / (1.0 - SLIPS)))
    return lambda _: forecast.update(
        filtered.state,
        rim_speed=rim,
        speed=SPEED_MPS,
        pitch=0.05,
        slope_ahead=0.06,
        slope_behind=0.04,
        step_s=STEP_S,
        forwards=True,
        limits=limits,
    )


def _readings(rover: RoverDescription) -> FloatArray:
    """What the wheels say, shape (updates, W, 10); RuntimeError when the rover has not six wheels."""
    if len(rover.wheels) != SLIPS.size:
        raise RuntimeError(f"{rover.name} has {len(rover.wheels)} wheels, {SLIPS.size} are timed")
    rng = np.random.default_rng(1)
    first = rover.wheels[0]
    ground = DiggableSoil(soil_from_de_st(*SOIL), 2.0 * FilterNoise().excavation_depth_m, 1.0)
    loads = np.array([rover.vertical_load_n * wheel.load_share for wheel in rover.wheels])
    seen = steady_wheel(Wheel(first.radius_m, first.width_m), ground, loads, SLIPS)
    readings = np.empty((WARMING + UPDATES, SLIPS.size, 10))
    noise = rng.standard_normal((4, WARMING + UPDATES, SLIPS.size))
    readings[..., THETA_1] = seen.theta_1 + ANGLE_STD_RAD * noise[0]
    readings[..., THETA_2] = seen.theta_2 + ANGLE_STD_RAD * noise[1]
    readings[..., VAR_1] = readings[..., VAR_2] = ANGLE_STD_RAD**2
    readings[..., SLIP_SEEN] = SLIPS + 0.03 * noise[2]
    readings[..., SLIP_STD] = 0.03
    readings[..., TORQUE] = seen.torque + TORQUE_STD_NM * noise[3]
    readings[..., LOAD] = loads
    readings[..., RIM_SPEED] = SPEED_MPS / (1.0 - SLIPS)
    readings[..., HAS_ANGLES] = 1.0
    return readings
