"""The world's straps: imperfect, faulty, two on a wheel, and told to boards that scan by themselves."""

import itertools
import math
from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pytest

from sim_bridge import plant as p
from sim_bridge.parameters import SimBridgeParameters
from sim_bridge.plant import PlantSettings
from sim_bridge.scenarios import Scenario, Site
from sim_bridge.strap_faults import StrapFault
from sim_bridge.terrain import FIRM_SAND, Stretch, build_terrain
from sim_bridge.world import SensorSettings, World, board_links
from strap_rover.rover import load_rover
from strap_rover.settings import SettingsError
from strap_rover.telemetry import WheelCommands
from strap_sensor_driver.device_clock import strap_delay_us
from strap_sensor_driver.frames import AcceptedFrame, DataFrame, FrameDecoder, HelloFrame

MS = 1_000_000
ROVER = load_rover("curiosity")
HIGHEST = 1023.0 / 1024.0
"""The highest code is one step short of the reference."""
TWO_STRAPS = load_rover("curiosity_two_straps")


def on_sand(rover):
    def build(described, _rng):
        tracks = [(y, (Stretch(-math.inf, FIRM_SAND),)) for y in sorted({wheel.y_m for wheel in described.wheels})]
        return Site(build_terrain(tracks, np.zeros_like, x_end=40.0), None, MappingProxyType({}))

    return Scenario("sand", "firm sand and nothing else", rover.name, 0.5, 10.0, PlantSettings(), build)


def make_world(rover=ROVER, seed=0, sinks=None, **sensors):
    """A world, and the drivers' ends of its links."""
    chosen = SensorSettings(**{"adc_noise_lsb": 0.0} | sensors)
    ends = board_links(rover, chosen)
    links = {} if sinks else {board: end[1] for board, end in ends.items()}
    world = World(rover, on_sand(rover), links, seed, chosen, sinks=sinks)
    return world, {board: end[0] for board, end in ends.items()}


def drive(world, seconds, speed_radps=2.0):
    for _ in range(round(seconds * 1e9) // world.period_ns):
        world.feed_wheel_commands(WheelCommands(world.now_ns, np.full(len(world.rover.wheels), speed_radps)))
        world.advance(world.now_ns + world.period_ns)


def frames(drivers, board, says=None):
    decoder = FrameDecoder(board if says is None else says)
    chunks = drivers[board].read(10**15)
    return [event.frame for data, _ in chunks for event in decoder.feed(data) if isinstance(event, AcceptedFrame)]


def shares(drivers, board):
    """V/V_DD of every scan read, shape (N, 6)."""
    scans = [frame for frame in frames(drivers, board) if isinstance(frame, DataFrame)]
    return np.array([frame.sums for frame in scans]) / (4 * 1024.0)


def test_straps_are_imperfect_as_the_settings_say_each_in_its_own_way():
    world, _ = make_world(strap_resistance_error=0.05, strap_nonuniformity=0.05)
    scales = [strap.strap.scale for strap in world.straps]
    assert [abs(scale - 1.0) for scale in scales] == pytest.approx([0.05] * 6)
    assert len({strap.strap.waves for strap in world.straps}) == 6
    again, _ = make_world(strap_resistance_error=0.05, strap_nonuniformity=0.05)
    other, _ = make_world(strap_resistance_error=0.05, strap_nonuniformity=0.05, seed=1)
    assert [strap.strap for strap in again.straps] == [strap.strap for strap in world.straps]
    assert other.straps[0].strap.waves != world.straps[0].strap.waves


def test_boards_read_the_straps_as_they_are():
    flaws = {"strap_resistance_error": 0.05, "strap_nonuniformity": 0.05, "strap_contact_ohm": 5e3}
    world, drivers = make_world(**flaws)
    plain, plain_drivers = make_world()
    drive(world, 0.5)
    drive(plain, 0.5)
    seen, ideal = shares(drivers, 1), shares(plain_drivers, 1)
    assert np.abs(seen - ideal).max() > 0.01
    # the last scan, from the arcs as they are now
    strap, wheel = world.straps[0].strap, world.rover.wheels[0]
    theta = world.plant.contact[[p.THETA_2, p.THETA_1], 0]
    theta_n = wheel.strap_offset_rad - world.plant.wheels[p.ANGLE, 0] - 1.5 * math.pi
    arc = np.mod(theta - theta_n, 2.0 * math.pi).tolist()
    np.testing.assert_allclose(seen[-1, :2], np.minimum(strap.shares(*arc), HIGHEST), atol=0.5 / 1024.0 + 1e-9)


def test_a_drifting_strap_reads_less_and_less():
    world, drivers = make_world(strap_drift_per_hour=50.0)
    signs = [math.copysign(1.0, strap.strap.drift_per_s) for strap in world.straps]
    plain, plain_drivers = make_world()
    drive(world, 6.0, 0.0)
    drive(plain, 6.0, 0.0)
    change = shares(drivers, 1)[-1] - shares(plain_drivers, 1)[-1]
    for channel, sign in enumerate(signs[:3]):
        assert sign * change[2 * channel] < -0.002


def test_a_second_strap_sees_what_the_first_sees_half_a_turn_on():
    world, drivers = make_world(TWO_STRAPS)
    drive(world, 8.0)
    first, second = shares(drivers, 1), shares(drivers, 3)
    blind_1, blind_2 = (np.all(seen[:, :2] > 0.98, axis=1) for seen in (first, second))
    assert blind_1.any()
    assert blind_2.any()
    assert not (blind_1 & blind_2).any()  # one of them always sees
    strap = world.straps[0].strap
    for scan in np.flatnonzero(~blind_1 & ~blind_2)[200::97]:  # after the zone has its shape
        one, other = strap.arc(*first[scan, :2]), strap.arc(*second[scan, :2])
        apart = [(b - a) % (2.0 * math.pi) for a, b in zip(one, other, strict=True)]
        assert apart == pytest.approx([math.pi] * 2, abs=0.04)


def test_a_second_strap_changes_nothing_of_the_first():
    one, drivers = make_world(ROVER, adc_noise_lsb=0.5, strap_nonuniformity=0.1)
    two, two_drivers = make_world(TWO_STRAPS, adc_noise_lsb=0.5, strap_nonuniformity=0.1)
    drive(one, 0.3)
    drive(two, 0.3)
    for board in ROVER.boards:
        np.testing.assert_array_equal(shares(drivers, board), shares(two_drivers, board))


def settings(**changes):
    return SimBridgeParameters(**changes)


@pytest.mark.parametrize(
    ("changes", "count"),
    [({}, 12), ({"strap_fault_wheel": "ml"}, 2), ({"strap_fault_wheel": "ml", "strap_fault_strap": "second"}, 1)],
)
def test_the_straps_that_a_fault_strikes_are_chosen_by_wheel_and_place(changes, count):
    struck = settings(**changes).struck_straps(TWO_STRAPS)
    assert len(struck) == count
    if changes:
        assert {TWO_STRAPS.wheel_names[strap.wheel_index] for strap in struck} == {"ml"}


def test_an_unknown_wheel_is_refused_with_the_known():
    with pytest.raises(SettingsError, match="no wheel 'xl'; give one of fl, ml, rl, fr, mr, rr"):
        settings(strap_fault_wheel="xl").struck_straps(ROVER)


def test_a_fault_strikes_its_strap_alone_and_ends():
    world, drivers = make_world()
    struck = settings(strap_fault_wheel="ml").struck_straps(ROVER)
    drive(world, 0.2)
    shares(drivers, 1), shares(drivers, 2)
    world.begin_strap_fault(StrapFault.OPEN_A, struck)
    drive(world, 0.2)
    seen = shares(drivers, 1)
    assert np.all(seen[:, 2] == 0.0)
    assert np.all(seen[:, [0, 1, 3, 4, 5]] > 0.2)
    assert np.all(shares(drivers, 2) > 0.2)
    world.begin_strap_fault(StrapFault.NONE, struck)
    drive(world, 0.2)
    assert np.all(shares(drivers, 1) > 0.2)


def test_a_floating_first_input_follows_the_last_one_of_the_scan_before():
    world, drivers = make_world()
    world.begin_strap_fault(StrapFault.FLOATING_A, settings(strap_fault_wheel="fl").struck_straps(ROVER))
    drive(world, 20.0, 0.5)
    seen = shares(drivers, 1)[1000:]
    left = seen[1:, 0] - 0.9 * seen[:-1, 5]
    assert np.ptp(seen[:, 5]) > 0.2
    assert left.std() < 0.06
    assert abs(np.polyfit(seen[:-1, 5], seen[1:, 0], 1)[0] - 0.9) < 0.1


def test_a_wrong_board_says_another_id_and_the_right_one_comes_back():
    world, drivers = make_world()
    struck = settings(strap_fault_wheel="fr").struck_straps(ROVER)
    drive(world, 0.05)
    frames(drivers, 2)
    world.begin_strap_fault(StrapFault.WRONG_BOARD, struck)
    drive(world, 0.1)
    strange = frames(drivers, 2, says=102)
    assert isinstance(strange[0], HelloFrame)
    assert {frame.board_id for frame in strange} == {102}
    assert {frame.board_id for frame in frames(drivers, 1)} == {1}
    world.begin_strap_fault(StrapFault.NONE, struck)
    drive(world, 0.1)
    assert {frame.board_id for frame in frames(drivers, 2)} == {2}


class Sink:
    def __init__(self):
        self.told = []

    def volts(self, at_ns, volts, slopes):
        self.told.append((at_ns, np.array(volts), np.array(slopes)))


def test_boards_that_scan_by_themselves_are_told_volts_and_how_they_go_on():
    sinks = {board: Sink() for board in ROVER.boards}
    world, _ = make_world(sinks=sinks)
    virtual, drivers = make_world()
    assert (world.virtual_boards, virtual.virtual_boards) == ((), ROVER.boards)
    drive(world, 4.0)
    drive(virtual, 4.0)
    for board, sink in sinks.items():
        times = [at_ns for at_ns, _, _ in sink.told]
        assert times == list(range(5 * MS, 4_000 * MS + 1, 5 * MS))
        volts = np.array([seen for _, seen, _ in sink.told])
        slopes = np.array([slope for _, _, slope in sink.told])
        sampled_s = 1e-6 * np.repeat([strap_delay_us(4, channel) for channel in range(3)], 2)
        seen = np.minimum((volts + sampled_s * slopes) / 5.0, HIGHEST)  # as a board would, one strap after the other
        off = np.abs(seen - shares(drivers, board))
        assert np.mean(off > 0.5 / 1024.0 + 1e-4) < 0.005  # in a millisecond before or after a seam
        assert np.median(off) < 0.4 / 1024.0
        late = itertools.pairwise(sink.told[200:])
        errors = np.array([before + 0.005 * slope - after for (_, before, slope), (_, after, _) in late])
        is_jump = np.abs(np.diff(volts[200:], axis=0)) > 0.2  # a seam begins or ends
        assert is_jump.mean() < 0.01
        moves = np.abs(np.diff(volts[200:], axis=0))[~is_jump]
        assert moves.max() > 0.01
        assert np.sqrt((errors[~is_jump] ** 2).mean()) < 0.1 * np.sqrt((moves**2).mean())


def test_boards_that_scan_by_themselves_have_faulty_straps_too():
    sinks = {board: Sink() for board in ROVER.boards}
    world, _ = make_world(sinks=sinks, strap_nonuniformity=0.05)
    world.begin_strap_fault(StrapFault.SHORT_B, settings(strap_fault_wheel="mr").struck_straps(ROVER))
    drive(world, 0.1)
    _, volts, slopes = sinks[2].told[-1]
    assert (volts[3], slopes[3]) == (5.0, 0.0)
    assert abs(slopes[2]) > 0.0


def test_a_board_with_neither_link_nor_sink_is_missed():
    with pytest.raises(ValueError, match=r"no link for board\(s\) \[2\]"):
        World(ROVER, on_sand(ROVER), {}, 0, sinks={1: Sink()})


def test_flaws_are_checked_with_the_sensors():
    with pytest.raises(SettingsError, match="strap_nonuniformity"):
        replace(SensorSettings(), strap_nonuniformity=2.0)
