"""What two assumptions of the plant change on `mars_snag`: whether dug sand flows back, and the centre of gravity.

.venv/bin/python docs/decisions/plant_soil.py
"""

from dataclasses import replace

from missions.core_run import run_cores
from missions.plan import plan_run
from missions.summary import summarize
from sim_bridge.plant import MEASURED_REFILL
from sim_bridge.scenarios import REFERENCE_SNAG, SnagCase, on_refilling_sand, snag_scenario

POLICIES = ("soil_flow", "slip_limit", "constant")
BETWEEN = (0.5, 1.0)
"""kappa of sands that flow back less than the measured ones."""


def report(name: str, case: SnagCase, cg_height_m: float, policy: str) -> None:
    plan = plan_run(snag_scenario(case), policy)
    plan = replace(plan, rover=replace(plan.rover, cg_height_m=cg_height_m))
    summary = summarize(plan, run_cores(plan))
    print(
        f"{name:34s} {policy:11s} {summary.outcome:10s} deepest {summary.largest_sinkage_mm:4.0f} mm, zone "
        f"{summary.largest_zone_deg:4.0f} deg, at the end {summary.final_speed_mps:.2f} m/s",
        flush=True,
    )


def flowing_back(ratio: float) -> SnagCase:
    """The reference case with kappa = ratio, dug as deep at little slip."""
    depth = REFERENCE_SNAG.excavation_depth_m * (1.0 + ratio)
    return replace(REFERENCE_SNAG, refill_ratio=ratio, excavation_depth_m=depth)


def main() -> None:
    for cg_height_m in (0.0, 0.7):
        for policy in POLICIES:
            report(f"trapping, centre of gravity {cg_height_m} m", REFERENCE_SNAG, cg_height_m, policy)
    for ratio in BETWEEN:
        for policy in POLICIES:
            report(f"kappa {ratio}, 0.7 m", flowing_back(ratio), 0.7, policy)
    for cg_height_m in (0.0, 0.7):
        for policy in POLICIES:
            report(
                f"refilling, kappa {MEASURED_REFILL:g}, {cg_height_m} m",
                on_refilling_sand(REFERENCE_SNAG),
                cg_height_m,
                policy,
            )


if __name__ == "__main__":
    main()
