"""What two assumptions of the plant change on `mars_snag`: whether dug sand refills, and the centre of gravity.

.venv/bin/python docs/decisions/plant_soil.py
"""

from dataclasses import replace

from missions.core_run import run_cores
from missions.plan import plan_run
from missions.summary import summarize
from sim_bridge.scenarios import SnagCase, snag_scenario

POLICIES = ("soil_flow", "slip_limit", "constant")


def report(name: str, case: SnagCase, cg_height_m: float, policy: str) -> None:
    plan = plan_run(snag_scenario(case), policy)
    plan = replace(plan, rover=replace(plan.rover, cg_height_m=cg_height_m))
    summary = summarize(plan, run_cores(plan))
    print(
        f"{name:34s} {policy:11s} {summary.outcome:10s} deepest {summary.largest_sinkage_mm:4.0f} mm, at the end "
        f"{summary.final_sinkage_mm:4.0f} mm at {summary.final_speed_mps:.2f} m/s",
        flush=True,
    )


def main() -> None:
    for cg_height_m in (0.0, 0.7):
        for policy in POLICIES:
            report(f"trapping, centre of gravity {cg_height_m} m", SnagCase(), cg_height_m, policy)
    for rate in (0.1, 0.2):
        for policy in POLICIES:
            report(f"refilling at {rate} 1/s, 0.7 m", SnagCase(refill_rate=rate), 0.7, policy)


if __name__ == "__main__":
    main()
