"""The plant beside real time; reader, estimator and controller beside the control period."""

import time
from functools import cache
from statistics import median

import numpy as np

from benchmarks.control_loop import START_X_M, CycleTimes, drive
from benchmarks.rounds import ROUNDS
from benchmarks.row import Goal, Row, figures, percentile
from missions.plan import CYCLE_NS, plan_run
from sim_bridge import plant as p
from sim_bridge.plant import Plant

PLANT_SECONDS = 20.0
DRIVE_SECONDS = 8.0


def plant() -> Row:
    """The six-wheel terramechanics plant of `mars_snag` in soft sand, 5 ms steps, one Python call per step.

    As the simulated world calls it; no sensors, no ROS, processor time of one thread. Constant wheel commands of
    0.5 m/s from 24 m on, for 20 simulated seconds: in the soft sand, up the slope, into the snag. The reference is real
    time.
    """
    factors, whole = [], []
    for number in range(ROUNDS + 1):
        single, at_once = _plant_factor(one_call_per_step=True), _plant_factor(one_call_per_step=False)
        if number:  # the first warms up
            factors.append(single)
            whole.append(at_once)
    return Row(
        "plant",
        "six-wheel plant, simulated over wall time",
        f"{figures(median(factors))} s/s",
        "real time, 1 s/s",
        tuple(factors),
        Goal(">=", 50.0),
        notes=(
            f"all steps in one call: {figures(median(whole))} s/s",
            (
                "for comparison only, quoted 2026-11: Project Chrono's SCM terrain under a six-wheel Curiosity ran at "
                "0.03 to 0.09 s/s on a machine of this kind"
            ),
        ),
    )


def _plant_factor(*, one_call_per_step: bool) -> float:
    plan = plan_run("mars_snag")
    scenario, rover = plan.scenario, plan.rover
    site = scenario.build(rover, np.random.default_rng(0))
    simulated = Plant(rover, site.terrain, scenario.plant, site.snag)
    simulated.body[p.X] = START_X_M
    simulated.commands[:] = scenario.speed_mps / rover.wheels[0].radius_m
    steps = round(PLANT_SECONDS / scenario.plant.step_s)
    start = time.thread_time()
    if one_call_per_step:
        for _ in range(steps):
            simulated.advance(1)
    else:
        simulated.advance(steps)
    taken = time.thread_time() - start
    if not simulated.body[p.X] > START_X_M + 1.0:
        raise RuntimeError("the rover stayed where it was: what was timed is not driving")
    return PLANT_SECONDS / taken


@cache
def _tick_rounds() -> tuple[CycleTimes, ...]:
    """The drives that both rows of the tick are of."""
    plan = plan_run("mars_snag")
    drive(plan, 2.0)
    return tuple(drive(plan, DRIVE_SECONDS) for _ in range(ROUNDS))


def tick() -> Row:
    """What decides: estimator and controller cores for six wheels, records fed and ticked, per control period.

    In closed loop with the plant in soft sand, 8 simulated seconds per round, no ROS, soil filter and halting forecast
    at work; processor time of one thread. The estimator ticks in every second period, filter and forecast in every
    tenth. The ratio is the median's share of the 10 ms period.
    """
    rounds = _tick_rounds()
    middles = [median(times.deciding) for times in rounds]
    both = [median(times.deciding_with_estimate) for times in rounds]
    return Row(
        "tick",
        "six-wheel tick (estimator + controller), median share of the period",
        f"p50 {figures(median(middles) / 1e3)} us",
        f"{CYCLE_NS / 1e6:g} ms period",
        tuple(middle / CYCLE_NS for middle in middles),
        Goal("<=", 0.10, "%"),
        "%",
        (f"median of the periods in which both tick {figures(median(both) / 1e3)} us",),
    )


def tick_tail() -> Row:
    """The 99th percentile of the same drives as `tick`: the periods in which filter and forecast are due are in it."""
    tails = [percentile(times.deciding, 0.99) for times in _tick_rounds()]
    worst = max(max(times.deciding) for times in _tick_rounds())
    return Row(
        "tick_tail",
        "six-wheel tick, p99 share of the period",
        f"p99 {figures(median(tails) / 1e3)} us",
        f"{CYCLE_NS / 1e6:g} ms period",
        tuple(tail / CYCLE_NS for tail in tails),
        Goal("<=", 0.20, "%"),
        "%",
        (f"longest of all {figures(worst / 1e3)} us",),
    )


def strap_reader() -> Row:
    """What reads: 4 frames of 3 straps each decoded, turned into contact zones, and one tick, per control period.

    In runs like those of `tick`. The ratio is the 99th percentile's share of the 10 ms period.
    """
    plan = plan_run("mars_snag")
    drive(plan, 2.0)
    rounds = [drive(plan, DRIVE_SECONDS).reader for _ in range(ROUNDS)]
    tails = [percentile(times, 0.99) for times in rounds]
    middle = median([median(times) for times in rounds])
    return Row(
        "strap_reader",
        "strap reader for six wheels, p99 share of the period",
        f"p50 {figures(middle / 1e3)} us, p99 {figures(median(tails) / 1e3)} us",
        f"{CYCLE_NS / 1e6:g} ms period",
        tuple(tail / CYCLE_NS for tail in tails),
        unit="%",
    )
