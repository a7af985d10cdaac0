"""World, strap reader, estimator and controller joined by plain records, with a stopwatch on each core."""

from dataclasses import dataclass, field
from time import thread_time_ns

from missions.plan import CYCLE_NS, ESTIMATOR_NS, REQUEST_NS, RunPlan
from sim_bridge import plant as p
from sim_bridge.world import World, WorldReport, board_links
from soil_flow_estimator.soil_estimator import SoilEstimator
from strap_rover.telemetry import SpeedRequest, WheelCommands
from strap_sensor_driver.contact_zone import ContactAngles
from strap_sensor_driver.parameters import bind_straps, load_calibration
from strap_sensor_driver.strap_reader import StrapReader, StrapReading
from traction_controller.traction import TractionController

START_X_M = 24.0
"""In the soft sand of `mars_snag`, which begins at 23 m, and 4 m before its snag."""
TIMED_FROM_NS = 1_000_000_000
"""The first second is not counted: the filters fill."""


@dataclass(slots=True)
class CycleTimes:
    """Nanoseconds of this thread per control period: what else runs here does not count."""

    reader: list[int] = field(default_factory=list)
    deciding: list[int] = field(default_factory=list)
    """Estimator and controller, feeds included."""
    deciding_with_estimate: list[int] = field(default_factory=list)
    """Of these, the periods in which the estimator ticks too (every second one)."""


class ControlLoop:
    """The cores of one run, the rover standing in the soft sand of `mars_snag` to begin with."""

    def __init__(self, plan: RunPlan) -> None:
        self.times = CycleTimes()
        self._plan = plan
        links = board_links(plan.rover, plan.world)
        boards = {board: ends[1] for board, ends in links.items()}
        self._world = World(plan.rover, plan.scenario, boards, plan.seed, plan.world)
        self._world.plant.body[p.X] = START_X_M
        calibration = load_calibration(plan.rover, plan.driver)
        self._reader = StrapReader(bind_straps(plan.rover, plan.driver, calibration), plan.driver)
        self._lines = [links[board][0] for board in self._reader.board_ids]
        self._estimator = SoilEstimator(plan.rover, plan.estimator)
        self._controller = TractionController(plan.rover, plan.controller)

    def travelled_m(self) -> float:
        """How far the rover has come."""
        return float(self._world.plant.body[p.X]) - START_X_M

    def step(self) -> None:
        """One control period."""
        now_ns = self._world.now_ns + CYCLE_NS
        report = self._world.advance(now_ns)
        arrived = [line.read(now_ns) for line in self._lines]
        start = thread_time_ns()
        reading = self._read(now_ns, report, arrived)
        read = thread_time_ns()
        commands = self._decide(now_ns, report, reading.angles)
        decided = thread_time_ns()
        self._world.feed_wheel_commands(commands)
        for request in reading.requests:
            self._lines[request.board_index].write(request.data, now_ns)
        if now_ns > TIMED_FROM_NS:
            self.times.reader.append(read - start)
            self.times.deciding.append(decided - read)
            if now_ns % ESTIMATOR_NS == 0:
                self.times.deciding_with_estimate.append(decided - read)

    def _read(self, now_ns: int, report: WorldReport, arrived: list[list[tuple[bytes, int]]]) -> StrapReading:
        self._reader.feed_wheel_states(report.wheel_states)
        for board, portions in enumerate(arrived):
            for data, host_ns in portions:
                self._reader.feed_bytes(board, data, host_ns)
        return self._reader.tick(now_ns)

    def _decide(self, now_ns: int, report: WorldReport, angles: ContactAngles | None) -> WheelCommands:
        estimator, controller = self._estimator, self._controller
        estimator.feed_wheel_states(report.wheel_states)
        estimator.feed_body_motion(report.body_motion)
        estimator.feed_attitude(report.attitude)
        estimator.feed_suspension(report.suspension)
        controller.feed_wheel_states(report.wheel_states)
        controller.feed_body_motion(report.body_motion)
        if (now_ns - CYCLE_NS) % REQUEST_NS == 0:
            controller.feed_speed_request(SpeedRequest(now_ns, self._plan.scenario.speed_mps))
        if angles is not None:
            estimator.feed_contact_angles(angles)
            controller.feed_contact_angles(angles)
        if now_ns % ESTIMATOR_NS == 0:
            soil = estimator.tick(now_ns)
            if soil is not None:
                controller.feed_soil_state(soil)
        return controller.tick(now_ns).commands


def drive(plan: RunPlan, seconds: float) -> CycleTimes:
    """Drive for so many simulated seconds; RuntimeError when that leads nowhere."""
    loop = ControlLoop(plan)
    for _ in range(round(seconds * 1e9 / CYCLE_NS)):
        loop.step()
    if not loop.travelled_m() > 0.1 * seconds * plan.scenario.speed_mps:
        raise RuntimeError(f"the rover came {loop.travelled_m():.2f} m in {seconds:g} s: what was timed is not driving")
    return loop.times
