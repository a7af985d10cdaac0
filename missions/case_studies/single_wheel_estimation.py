"""Figs 10 and 11 of the source paper on the test stand: de and st found step by step, and who sees first that it digs.

The wheel is driven by a schedule and not by a controller; straps, encoder, torque and odometry are read with their
usual noise by the driver and the estimator that a rover runs.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from missions.case_studies.baselines import baseline_plan
from missions.case_studies.single_wheel_stand import stand_deformability, stand_rover
from missions.plan import CYCLE_NS, ESTIMATOR_NS, NS, RunPlan
from sim_bridge import plant as p
from sim_bridge.scenarios import REFERENCE_STAND, Scenario, Site, StandCase, stand_scenario
from sim_bridge.terrain import EARTH_SAND_UNIT_WEIGHT, Ground, Stretch, build_terrain
from sim_bridge.world import World, board_links
from soil_flow_estimator.soil_estimator import SoilEstimator
from soil_flow_estimator.soil_state import SoilState
from strap_rover.telemetry import WheelCommands
from strap_rover.terramechanics.soil import soil_from_de_st
from strap_sensor_driver.parameters import bind_straps, load_calibration
from strap_sensor_driver.strap_reader import StrapReader
from traction_controller.parameters import TractionParameters

SOILS = ("family", "S11")
"""The family's soil that has de and st of S11, which the estimator's law describes; and S11 of Table II itself."""
SEMI_STATIC_S, DYNAMIC_S = 0.4, 0.7
"""Fig. 10: 0.01 rad/s until the first, 0.04 rad/s from the second on."""
SCHEDULE_S = (0.0, SEMI_STATIC_S, DYNAMIC_S, 2.0, 2.1, 14.0, 14.2, 22.0)
SCHEDULE_RADPS = (0.01, 0.01, 0.04, 0.04, 0.1, 0.1, 0.5, 0.5)
"""As Fig. 10 until 2 s; then faster than it goes."""
TRACE_S = 0.1
STEP_RADPS = 4.0
STANDS_S, AFTER_S = 0.5, 1.2
"""Fig. 11: the wheel stands, then it turns from one moment to the next, and is watched for so long."""
START_S = 0.1
"""Nothing counts as an alarm so soon after the step: a start is all slip."""
SETTLED_RAD = float(np.deg2rad(1.0))
"""Within so much of its mean over the last quarter, an angle has settled."""
SLIP_ALARM = 0.3
ANGLE_ALARM_RAD = TractionParameters().angle_threshold_rad
"""Entry angle at which the baseline `angle_threshold` slows."""
HALT_RATIO = 0.1
"""Of the rim's speed: a body slower than that stands."""


@dataclass(frozen=True, slots=True)
class Estimation:
    """Fig. 10: one wheel by the schedule."""

    soil: str
    seed: int
    uses_torque: bool


@dataclass(frozen=True, slots=True)
class StepUp:
    """Fig. 11: one wheel turned up to 4 rad/s at once, on a member's sand."""

    case: StandCase
    seed: int
    noise: float


def true_soil() -> tuple[float, float]:
    """De that S11 has by its static contact zone, and the st that is assumed for it."""
    _, de = stand_deformability()
    return de, REFERENCE_STAND.st


def _on_family_soil(scenario: Scenario) -> Scenario:
    ground = Ground(
        soil_from_de_st(*true_soil()), REFERENCE_STAND.excavation_depth_m, unit_weight=EARTH_SAND_UNIT_WEIGHT
    )
    terrain = build_terrain([(0.0, (Stretch(-np.inf, ground),))], np.zeros_like, x_end=20.0)
    return replace(scenario, build=lambda _rover, _rng: Site(terrain, None, {}))


class _Stand:
    """World, strap driver and estimator, and what is asked of the motor."""

    def __init__(self, plan: RunPlan) -> None:
        links = board_links(plan.rover, plan.world)
        ends = {board: pair[1] for board, pair in links.items()}
        self.world = World(plan.rover, plan.scenario, ends, plan.seed, plan.world)
        straps = bind_straps(plan.rover, plan.driver, load_calibration(plan.rover, plan.driver))
        self._reader = StrapReader(straps, plan.driver)
        self._links = [links[board][0] for board in self._reader.board_ids]
        self._estimator = SoilEstimator(plan.rover, plan.estimator)
        self.now_ns = 0

    def step(self, omega: float) -> SoilState | None:
        """One control period with a speed asked of the motor [rad/s]; the estimate, where one is due."""
        self.now_ns = now_ns = self.now_ns + CYCLE_NS
        self.world.feed_wheel_commands(WheelCommands(now_ns, np.array([omega])))
        report = self.world.advance(now_ns)
        self._estimator.feed_wheel_states(report.wheel_states)
        self._estimator.feed_body_motion(report.body_motion)
        self._estimator.feed_attitude(report.attitude)
        self._reader.feed_wheel_states(report.wheel_states)
        for board, link in enumerate(self._links):
            for data, host_ns in link.read(now_ns):
                self._reader.feed_bytes(board, data, host_ns)
        reading = self._reader.tick(now_ns)
        for request in reading.requests:
            self._links[request.board_index].write(request.data, now_ns)
        if reading.angles is not None:
            self._estimator.feed_contact_angles(reading.angles)
        return self._estimator.tick(now_ns) if now_ns % ESTIMATOR_NS == 0 else None

    def turn_at_once(self, omega: float) -> None:
        """The wheel turns so from now on, as no motor could make it."""
        self.world.plant.wheels[p.OMEGA] = omega


def _plan(scenario: Scenario, seed: int, noise: float = 1.0) -> RunPlan:
    plan = baseline_plan(scenario, "constant 2 rad/s", seed)
    world = plan.world
    return replace(
        plan,
        world=replace(
            world,
            adc_noise_lsb=noise * world.adc_noise_lsb,
            wheel_speed_noise_radps=noise * world.wheel_speed_noise_radps,
            speed_noise_mps=noise * world.speed_noise_mps,
        ),
    )


def run_estimation(job: Estimation) -> dict[str, Any]:
    """De and st with their 1-sigma over time, and what is true."""
    scenario = stand_scenario(REFERENCE_STAND)
    plan = _plan(_on_family_soil(scenario) if job.soil == "family" else scenario, job.seed)
    plan = replace(plan, estimator=replace(plan.estimator, uses_torque=job.uses_torque))
    stand = _Stand(plan)
    de, st = true_soil()
    every = round(TRACE_S * NS / ESTIMATOR_NS)
    states: list[tuple[float, SoilState]] = []
    for cycle in range(1, round(SCHEDULE_S[-1] * NS / CYCLE_NS) + 1):
        state = stand.step(float(np.interp(cycle * CYCLE_NS / NS, SCHEDULE_S, SCHEDULE_RADPS)))
        if state is not None:
            states.append((1e-9 * stand.now_ns, state))
    kept = states[every - 1 :: every]
    curves = {name: [getattr(state, name)[0] for _, state in kept] for name in ("de", "de_std", "st", "st_std")}
    times = [at for at, _ in kept]
    return {
        "true_de": de,
        "true_st": st,
        "time_s": _rounded(times),
        "omega_radps": _rounded(np.interp(times, SCHEDULE_S, SCHEDULE_RADPS)),
        **{name: _rounded(values) for name, values in curves.items()},
    }


def run_step_up(job: StepUp) -> dict[str, Any]:
    """When vc falls below 1, when slip passes 0.3, when theta_2 has settled, when the wheel stands; and the curves.

    Times count from the step [s]; None for what never came.
    """
    stand = _Stand(_plan(stand_scenario(job.case), job.seed, job.noise))
    for _ in range(round(STANDS_S * NS / CYCLE_NS)):
        stand.step(0.0)
    stand.turn_at_once(STEP_RADPS)
    body, contact = stand.world.plant.body, stand.world.plant.contact
    rows, seen = [], []
    for cycle in range(1, round(AFTER_S * NS / CYCLE_NS) + 1):
        time_s = cycle * CYCLE_NS / NS
        state = stand.step(STEP_RADPS)
        rows.append((time_s, body[p.SPEED], contact[p.THETA_1, 0], contact[p.THETA_2, 0], contact[p.SINKAGE, 0]))
        if state is not None:
            seen.append((time_s, state.vc[0], state.slip[0]))
    time_s, speed, theta_1, theta_2, sinkage = np.array(rows).T
    seen_s, vc, slip = np.array(seen).T
    rim = STEP_RADPS * stand_rover().wheels[0].radius_m
    return {
        "vc_s": _first(seen_s, vc < 1.0),
        "slip_s": _first(seen_s, slip > SLIP_ALARM),
        "angle_s": _first(time_s, theta_1 > ANGLE_ALARM_RAD),
        "settled_s": _settled(time_s, theta_2),
        "halted_s": _first(time_s, speed < HALT_RATIO * rim),
        "time_s": _rounded(time_s[1::2]),
        "speed_mps": _rounded(speed[1::2]),
        "theta_1_rad": _rounded(theta_1[1::2]),
        "theta_2_rad": _rounded(theta_2[1::2]),
        "sinkage_m": _rounded(sinkage[1::2]),
        "vc": _rounded(vc),
        "slip": _rounded(slip),
    }


def _first(time_s: Any, is_so: Any) -> float | None:
    """When it is so for the first time, twice running, after the start."""
    twice = np.flatnonzero((is_so[1:] & is_so[:-1]) & (time_s[:-1] >= START_S))
    return float(round(time_s[1:][twice[0]], 6)) if twice.size else None


def _settled(time_s: Any, angle: Any) -> float:
    """From when on an angle stays near its mean over the last quarter."""
    last = angle[time_s > 0.75 * time_s[-1]].mean()
    far = np.flatnonzero(np.abs(angle - last) > SETTLED_RAD)
    return float(round(time_s[min(far[-1] + 1, time_s.size - 1)], 6)) if far.size else 0.0


def _rounded(values: Any) -> list[float]:
    return [float(f"{value:.6g}") for value in values]
