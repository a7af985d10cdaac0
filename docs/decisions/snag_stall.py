"""How soon a stall is called and how long it is waited for: what that does to a rover that a snag holds.

The `mars_snag` family with 20 m less of firm sand in front and members of its own, so that nothing is tuned on the
members of the study. `.venv/bin/python docs/decisions/snag_stall.py [members] [variant ...]`
"""

import json
import math
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np
from scipy import stats

from missions.core_run import run_cores
from missions.plan import plan_run
from missions.summary import summarize
from sim_bridge.plant import SNAG_ELAPSED, SPEED, Snag, X
from sim_bridge.scenarios import Site, SnagCase, on_refilling_sand, random_snag_case, snag_scenario
from sim_bridge.terrain import FIRM_SAND, Ground, Stretch, build_terrain, ramp
from sim_bridge.world import World
from strap_rover.terramechanics.soil import soil_from_de_st

SEED = 4711
SOFT_FROM_M, SNAG_X_M, GIVE_UP_S = 3.0, 8.0, 45.0
SOILS = {"trapping": lambda case: case, "refilling": on_refilling_sand}
BASELINE = "slip_limit 0.3"
NOT_ACTING: dict[str, Any] = {"acts_on_forecast": False}
BEFORE = NOT_ACTING | {"probe_rim_travel_m": 10.0, "slip_cap": 0.3, "lower_end_share": 1.0}
VARIANTS: dict[str, dict[str, Any]] = {
    BASELINE: {"policy": "slip_limit"},
    "before: cap 0.3, 0.1 m, lower end raises": BEFORE,
    "lower end raises": NOT_ACTING | {"lower_end_share": 1.0},
    "cap 0.3": NOT_ACTING | {"slip_cap": 0.3},
    "0.1 m under way": NOT_ACTING | {"probe_rim_travel_m": 10.0},
    "0.05 m under way": NOT_ACTING | {"probe_rim_travel_m": 0.05},
    "forecast not acted on": NOT_ACTING,
    "default": {},
}
"""How each variant differs from the shipped settings."""


def site(case: SnagCase) -> Site:
    soft = Ground(soil_from_de_st(case.de, case.st), case.excavation_depth_m, refill_ratio=case.refill_ratio)
    firm = replace(FIRM_SAND, refill_ratio=case.refill_ratio)
    stretches = (Stretch(-math.inf, firm), Stretch(SOFT_FROM_M, soft))
    terrain = build_terrain([(0.0, stretches)], ramp(SOFT_FROM_M, 2.0, math.radians(case.slope_deg)))
    return Site(terrain, Snag(SNAG_X_M, case.snag_n, case.snag_s), MappingProxyType({}))


def is_decided(world: World, case: SnagCase) -> bool:
    body = world.plant.body
    since_release = body[SNAG_ELAPSED] - case.snag_s
    is_clear = body[X] > SNAG_X_M + 3.0 and body[SPEED] > 0.1
    return bool(since_release >= 0.0 and (is_clear or since_release > GIVE_UP_S))


def run(job: tuple[str, str, int, SnagCase]) -> dict[str, Any]:
    variant, soil, member, case = job
    scenario = replace(snag_scenario(case), build=lambda _rover, _rng: site(case), duration_s=100.0)
    plan = plan_run(scenario, seed=member)
    plan = replace(plan, controller=replace(plan.controller, **VARIANTS[variant]))
    log = run_cores(plan, until=lambda world: is_decided(world, case))
    found = summarize(plan, log)
    return {
        "variant": variant,
        "soil": soil,
        "member": member,
        "off": found.outcome == "drove off",
        "outcome": found.outcome,
        "depth_mm": found.largest_sinkage_mm,
        "stalls": found.stalls,
        "end": found.mode_at_end,
        "time_s": found.duration_s,
    }


def jobs(members: int, variants: list[str]) -> list[tuple[str, str, int, SnagCase]]:
    cases = [random_snag_case(np.random.default_rng(s)) for s in np.random.SeedSequence(SEED).spawn(members)]
    return [
        (variant, soil, member, on_soil(case))
        for member, case in enumerate(cases)
        for soil, on_soil in SOILS.items()
        for variant in variants
    ]


def table(results: list[dict[str, Any]], variants: list[str]) -> None:
    by_key = {(one["variant"], one["soil"], one["member"]): one for one in results}
    members = sorted({one["member"] for one in results})
    print(
        "| sand | variant | drove off | gained | lost | deepest, median / p90 mm | paired difference mm | p | stalls |"
    )
    print("| --- | --- | --- | --- | --- | --- | --- | --- | --- |")
    for soil in SOILS:
        base = [by_key[BASELINE, soil, member] for member in members]
        for variant in variants:
            own = [by_key[variant, soil, member] for member in members]
            depth = np.array([one["depth_mm"] for one in own])
            less = depth - np.array([one["depth_mm"] for one in base])
            p = stats.wilcoxon(less, alternative="less").pvalue if less.any() else 1.0
            gained = sum(a["off"] and not b["off"] for a, b in zip(own, base, strict=True))
            lost = sum(b["off"] and not a["off"] for a, b in zip(own, base, strict=True))
            print(
                f"| {soil} | {variant} | {sum(one['off'] for one in own)} of {len(own)} | {gained} | {lost} | "
                f"{np.median(depth):.1f} / {np.quantile(depth, 0.9):.1f} | {np.median(less):.1f} | {p:.2g} | "
                f"{sum(one['stalls'] for one in own)} |"
            )


def main() -> None:
    members = int(sys.argv[1]) if len(sys.argv) > 1 else 40
    variants = list(dict.fromkeys([BASELINE, *sys.argv[2:]])) if len(sys.argv) > 2 else list(VARIANTS)
    results = []
    with ProcessPoolExecutor() as pool:
        for one in pool.map(run, jobs(members, variants)):
            results.append(one)
            print(json.dumps(one), file=sys.stderr, flush=True)
    table(results, variants)


if __name__ == "__main__":
    main()
