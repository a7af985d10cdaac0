"""A board falls silent while the rover drives: through the strap driver's core to the commands."""

from dataclasses import replace

import pytest

from missions.core_run import CoreGraph
from missions.plan import CYCLE_NS, plan_run
from traction_controller.supervisor import Fault, TractionMode

MS = 1_000_000


class CutLink:
    """A board's link that can be cut; remembers when its last bytes came."""

    def __init__(self, link):
        self._link = link
        self.is_cut = False
        self.last_ns = 0

    def read(self, now_ns):
        arrived = self._link.read(now_ns)
        if self.is_cut:
            return []
        if arrived:
            self.last_ns = arrived[-1][1]
        return arrived

    def write(self, data, now_ns):
        self._link.write(data, now_ns)


@pytest.mark.parametrize("board", [0, 1])
@pytest.mark.parametrize("cycle", [200, 201])
def test_150_ms_after_a_board_s_last_frame_every_wheel_is_commanded_to_zero_until_it_is_back(board, cycle):
    plan = plan_run("composite", "soil_flow", seed=1, duration_s=10.0)
    graph = CoreGraph(replace(plan, driver=replace(plan.driver, silent_s=0.1)))
    graph._links = [CutLink(link) for link in graph._links]
    for _ in range(cycle):
        output = graph.step()
    assert (output.commands.speed > 0.5).all()
    cut = graph._links[board]
    cut.is_cut = True
    while output.commands.speed.any():
        output = graph.step()
        assert graph.now_ns - cut.last_ns <= 150 * MS
    assert output.state.fault is Fault.SENSOR_LATE
    assert graph.now_ns - cut.last_ns > 100 * MS  # the driver's own patience
    for _ in range(50):
        assert not graph.step().commands.speed.any()
    cut.is_cut = False
    for _ in range(200_000_000 // CYCLE_NS):
        output = graph.step()
    assert output.state.fault is Fault.NONE
    assert output.state.state in {TractionMode.DRIVE, TractionMode.LIMIT}
    assert output.commands.speed.all()
