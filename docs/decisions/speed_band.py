"""What the ends of the speed band do: the slip cap, and when the lower end raises wheel speed.

.venv/bin/python docs/decisions/speed_band.py
"""

from dataclasses import replace
from unittest import mock

import numpy as np

from missions.core_run import run_cores
from missions.plan import RunPlan, plan_run
from missions.run_log import RunLog
from missions.summary import summarize
from sim_bridge.scenarios import SnagCase, snag_scenario
from strap_rover import topics
from strap_rover.terramechanics.spiral_flow import slip_limit
from traction_controller.traction import TractionController

ZONES_DEG = ((15.0, -3.0), (22.0, -4.0), (30.0, -5.0), (45.0, -8.0), (60.0, -10.0))
CASES = {
    "reference (7 deg, delta 20 mm)": SnagCase(),
    "delta 30 mm": SnagCase(excavation_depth_m=0.03),
    "8 deg": SnagCase(slope_deg=8.0),
}


class AlwaysRaised(TractionController):
    """The lower end in force whatever the rover's speed."""

    def _soil_flow(self, asked_mps, speed):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
        limits = super()._soil_flow(asked_mps, speed)
        wanted = np.minimum(np.maximum(asked_mps / self._radius, limits.omega_min), limits.omega_max)
        return replace(limits, wanted=wanted)


class NeverRaised(TractionController):
    """No lower end."""

    def _soil_flow(self, asked_mps, speed):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
        limits = super()._soil_flow(asked_mps, speed)
        return replace(limits, wanted=np.minimum(asked_mps / self._radius, limits.omega_max))


def speeds_in_sand(log: RunLog) -> tuple[float, float]:
    """Mean speed on the slope before the snag [m/s], and over the last 20 s."""
    time_s, speed = log.time_s(topics.GROUND_TRUTH), log.of_rover(topics.GROUND_TRUTH, "speed")
    x = log.of_rover(topics.GROUND_TRUTH, "x")
    return float(speed[(x > 26.0) & (x < 27.9)].mean()), float(speed[time_s > time_s[-1] - 20.0].mean())


def report(name: str, plan: RunPlan) -> None:
    log = run_cores(plan)
    summary = summarize(plan, log)
    before, after = speeds_in_sand(log)
    print(
        f"  {name:28s} {summary.outcome:10s} deepest {summary.largest_sinkage_mm:4.0f} mm, "
        f"{before:.3f} m/s before the snag, {after:.3f} after",
        flush=True,
    )


def main() -> None:
    print("slip at which vc falls to one, by contact zone:")
    for entry, leave in ZONES_DEG:
        print(f"  theta {entry:.0f}/{leave:.0f} deg: {float(slip_limit(np.deg2rad(entry), np.deg2rad(leave))):.3f}")
    for case_name, case in CASES.items():
        print(f"mars_snag, {case_name}:")
        for cap in (0.2, 0.3, 0.45):
            plan = plan_run(snag_scenario(case))
            report(
                f"soil_flow, slip cap {cap}",
                replace(plan, controller=replace(plan.controller, slip_cap=cap, lower_end_share=1.0)),
            )
        report("slip_limit 0.3", plan_run(snag_scenario(case), "slip_limit"))
    print("lower end of the band, reference case, 0.5 m/s asked:")
    controllers = {"only while slower than asked": TractionController, "always": AlwaysRaised, "never": NeverRaised}
    for name, controller in controllers.items():
        with mock.patch("missions.core_run.TractionController", controller):
            plan = plan_run("mars_snag")
            raising = replace(plan.controller, slip_cap=0.3, lower_end_share=1.0)
            report(name, replace(plan, controller=raising))


if __name__ == "__main__":
    main()
