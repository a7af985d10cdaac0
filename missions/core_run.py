"""A whole run without ROS: the same cores in the same order as the lockstep graph, joined by plain records.

Fast enough for studies of many runs, and proved equal to the run through the nodes.
"""

from collections.abc import Callable

import numpy as np

from missions.plan import CYCLE_NS, ESTIMATOR_NS, REQUEST_NS, RunPlan
from missions.run_log import RunLog, RunLogBuilder
from sim_bridge.world import World, WorldReport, board_links
from soil_flow_estimator.soil_estimator import SoilEstimator
from strap_rover import topics
from strap_rover.telemetry import SpeedRequest
from strap_rover.topics import rover_vector, wheel_matrix
from strap_sensor_driver.parameters import bind_straps, load_calibration
from strap_sensor_driver.strap_reader import StrapReader
from traction_controller.traction import TractionController, TractionOutput

_NO_VALUES = np.empty(0)


class CoreGraph:
    """World, strap reader, estimator and controller of one run; `step` is one control period."""

    def __init__(self, plan: RunPlan) -> None:
        self.plan = plan
        links = board_links(plan.rover, plan.world)
        self.world = World(
            plan.rover, plan.scenario, {board: ends[1] for board, ends in links.items()}, plan.seed, plan.world
        )
        calibration = load_calibration(plan.rover, plan.driver)
        self._reader = StrapReader(bind_straps(plan.rover, plan.driver, calibration), plan.driver)
        self._links = [links[board][0] for board in self._reader.board_ids]
        self._estimator = SoilEstimator(plan.rover, plan.estimator)
        self._controller = TractionController(plan.rover, plan.controller)
        self._log = RunLogBuilder(plan.rover.wheel_names)
        self.now_ns = 0

    def step(self) -> TractionOutput:
        """One control period: request, world, driver, estimator, controller, commands."""
        self.now_ns = now_ns = self.now_ns + CYCLE_NS
        if (now_ns - CYCLE_NS) % REQUEST_NS == 0:
            self._controller.feed_speed_request(SpeedRequest(now_ns, self.plan.scenario.speed_mps))
        self._deliver(self.world.advance(now_ns))
        self._read_straps(now_ns)
        if now_ns % ESTIMATOR_NS == 0:
            soil = self._estimator.tick(now_ns)
            if soil is not None:
                self._controller.feed_soil_state(soil)
                row = topics.SOIL_STATE
                self._log.add(row, soil.stamp_ns, wheel_matrix(row, soil), rover_vector(row, soil))
        output = self._controller.tick(now_ns)
        self.world.feed_wheel_commands(output.commands)
        self._log.add(topics.TRACTION_COMMANDS, now_ns, output.commands.speed[:, None].copy(), _NO_VALUES)
        if now_ns % ESTIMATOR_NS == 0 or output.is_turn:
            row = topics.TRACTION_STATE
            self._log.add(row, now_ns, wheel_matrix(row, output.state), rover_vector(row, output.state))
        return output

    def log(self) -> RunLog:
        """What happened so far."""
        return self._log.build()

    def _deliver(self, report: WorldReport) -> None:
        for core in (self._estimator, self._controller):
            core.feed_wheel_states(report.wheel_states)
            core.feed_body_motion(report.body_motion)
        self._reader.feed_wheel_states(report.wheel_states)
        self._estimator.feed_attitude(report.attitude)
        self._estimator.feed_suspension(report.suspension)
        truth = report.ground_truth
        if truth is not None:
            self._log.add(topics.GROUND_TRUTH, truth.stamp_ns, truth.per_wheel, truth.whole_rover)

    def _read_straps(self, now_ns: int) -> None:
        for board, link in enumerate(self._links):
            for data, host_ns in link.read(now_ns):
                self._reader.feed_bytes(board, data, host_ns)
        reading = self._reader.tick(now_ns)
        for request in reading.requests:
            self._links[request.board_index].write(request.data, now_ns)
        if reading.voltages is not None:
            row = topics.STRAP_VOLTAGES
            self._log.add(row, reading.voltages.stamp_ns, wheel_matrix(row, reading.voltages), _NO_VALUES)
        if reading.angles is not None:
            self._estimator.feed_contact_angles(reading.angles)
            self._controller.feed_contact_angles(reading.angles)
            row = topics.CONTACT_ANGLES
            self._log.add(row, reading.angles.stamp_ns, wheel_matrix(row, reading.angles), _NO_VALUES)


def run_cores(
    plan: RunPlan,
    progress: Callable[[int], None] | None = None,
    until: Callable[[World], bool] | None = None,
) -> RunLog:
    """Run the whole plan, or until `until(world)`, asked each simulated second; `progress` is told the cycles done."""
    graph = CoreGraph(plan)
    for cycle in range(plan.cycles):
        graph.step()
        if cycle % 100 == 99:
            if progress is not None:
                progress(cycle + 1)
            if until is not None and until(graph.world):
                break
    return graph.log()
