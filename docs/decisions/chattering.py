"""Does the controller chatter? What v_creep, sensor noise, the limit of acceleration and the forecast do to it.

Counted while the rover drives steadily in soft sand on a slope: switches between DRIVE and LIMIT, reversals of the
commanded acceleration, and its rms. `.venv/bin/python docs/decisions/chattering.py [seeds]`
"""

import math
import sys
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np

from missions.core_run import run_cores
from missions.plan import plan_run
from missions.run_log import RunLog
from sim_bridge.scenarios import REFERENCE_SNAG, Site, SnagCase, on_refilling_sand, snag_scenario
from sim_bridge.terrain import FIRM_SAND, Ground, Stretch, build_terrain, ramp
from strap_rover import topics
from strap_rover.terramechanics.soil import soil_from_de_st
from traction_controller.supervisor import TractionMode

SOFT_FROM_M, FROM_S, UNTIL_S = 3.0, 13.0, 33.0
GROUNDS: Mapping[str, SnagCase] = MappingProxyType(
    {
        "at ease: 7 deg, trapping": REFERENCE_SNAG,
        "at its limit: 14 deg, st 0.25, refilling": on_refilling_sand(replace(REFERENCE_SNAG, slope_deg=14.0, st=0.25)),
    }
)
"""Well below the slip cap, and so steep that the rover hangs on it."""
CASES: Mapping[str, tuple[Mapping[str, Any], Mapping[str, Any]]] = MappingProxyType(
    {
        "as shipped": ({}, {}),
        "v_creep 0": ({"v_creep_mps": 0.0}, {}),
        "v_creep 0.05": ({"v_creep_mps": 0.05}, {}),
        "odometry without noise": ({}, {"speed_noise_mps": 0.0}),
        "odometry 15 mm/s": ({}, {"speed_noise_mps": 0.015}),
        "odometry 30 mm/s": ({}, {"speed_noise_mps": 0.03}),
        "straps 8 x as noisy": ({}, {"adc_noise_lsb": 4.0}),
        "1 rad/s^2": ({"acceleration_limit_radps2": 1.0}, {}),
        "4 rad/s^2": ({"acceleration_limit_radps2": 4.0}, {}),
        "acceleration unlimited": ({"acceleration_limit_radps2": 0.0}, {}),
        "forecast not acted on": ({"acts_on_forecast": False}, {}),
        "lower end in full": ({"lower_end_share": 1.0}, {}),
    }
)
"""What differs from the shipped settings of controller and world."""


def site(case: SnagCase) -> Site:
    soft = Ground(soil_from_de_st(case.de, case.st), case.excavation_depth_m, refill_ratio=case.refill_ratio)
    stretches = (Stretch(-math.inf, replace(FIRM_SAND, refill_ratio=case.refill_ratio)), Stretch(SOFT_FROM_M, soft))
    terrain = build_terrain([(0.0, stretches)], ramp(SOFT_FROM_M, 2.0, math.radians(case.slope_deg)))
    return Site(terrain, None, MappingProxyType({}))


def drive(case: SnagCase, controller: Mapping[str, Any], world: Mapping[str, Any], seed: int) -> RunLog:
    scenario = replace(snag_scenario(case), build=lambda _rover, _rng: site(case))
    plan = plan_run(scenario, seed=seed, duration_s=UNTIL_S)
    return run_cores(
        replace(plan, controller=replace(plan.controller, **controller), world=replace(plan.world, **world))
    )


def chatter(log: RunLog) -> np.ndarray:
    """Switches and reversals per minute, rms of the commanded acceleration [rad/s^2], share limited, speed [m/s]."""
    time_s = log.time_s(topics.TRACTION_COMMANDS)
    steady = (time_s > FROM_S) & (time_s < UNTIL_S)
    step = np.diff(log.commands()[steady], axis=0)
    minutes = (UNTIL_S - FROM_S) / 60.0
    reversals = 0.0
    for wheel in step.T:
        turns = np.sign(wheel[np.abs(wheel) > 1e-9])
        reversals += np.count_nonzero(np.diff(turns)) / step.shape[1]
    state_s = log.time_s(topics.TRACTION_STATE)
    modes = log.of_rover(topics.TRACTION_STATE, "state").astype(int)[(state_s > FROM_S) & (state_s < UNTIL_S)]
    own = np.isin(modes, [TractionMode.DRIVE, TractionMode.LIMIT])
    switches = np.count_nonzero(np.diff(modes) * (own[1:] & own[:-1]))
    truth_s, speed = log.time_s(topics.GROUND_TRUTH), log.of_rover(topics.GROUND_TRUTH, "speed")
    return np.array(
        [
            switches / minutes,
            reversals / minutes,
            float(np.sqrt(np.mean((step / 0.01) ** 2))),
            float(np.mean(modes == TractionMode.LIMIT)),
            float(speed[truth_s > FROM_S].mean()),
        ]
    )


def main() -> None:
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 3
    for ground, case in GROUNDS.items():
        print(f"\n{ground}\n")
        print("| case | switches per min | reversals per min | rms rad/s^2 | limited | m/s |")
        print("| --- | --- | --- | --- | --- | --- |")
        for name, (controller, world) in CASES.items():
            found = np.mean([chatter(drive(case, controller, world, seed)) for seed in range(seeds)], axis=0)
            print(
                f"| {name} | {found[0]:.0f} | {found[1]:.0f} | {found[2]:.2f} | {found[3]:.2f} | {found[4]:.2f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
