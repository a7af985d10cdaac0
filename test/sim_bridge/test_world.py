"""The world as its sensors tell it: times of frames, angles, noise; and that seed and commands say all."""

import math
from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sim_bridge import plant as p
from sim_bridge.plant import PlantSettings
from sim_bridge.scenarios import Scenario, Site, scenario_named
from sim_bridge.terrain import FIRM_SAND, Stretch, build_terrain, ramp
from sim_bridge.world import SensorSettings, World, board_links, nominal_strap
from strap_rover.rover import load_rover
from strap_rover.settings import SettingsError
from strap_rover.telemetry import WheelCommands, WheelStates
from strap_rover.terramechanics import ground_grid
from strap_sensor_driver.contact_zone import ContactStatus
from strap_sensor_driver.frames import AcceptedFrame, DataFrame, FrameDecoder, HelloFrame
from strap_sensor_driver.parameters import StrapDriverParameters, bind_straps
from strap_sensor_driver.strap import strap_resistance_ohm
from strap_sensor_driver.strap_reader import StrapReader

MS = 1_000_000
ROVER = load_rover("curiosity")
QUIET = SensorSettings(
    adc_noise_lsb=0.0, encoder_step_rad=0.0, wheel_speed_noise_radps=0.0, torque_noise_nm=0.0, speed_noise_mps=0.0,
    position_noise_m=0.0, attitude_noise_rad=0.0, joint_noise_rad=0.0,
)  # fmt: skip


def on_sand(slope=np.zeros_like) -> Scenario:
    """Firm sand on a slope profile."""

    def build(rover, _rng):
        tracks = [(y, (Stretch(-math.inf, FIRM_SAND),)) for y in sorted({wheel.y_m for wheel in rover.wheels})]
        return Site(build_terrain(tracks, slope, x_end=40.0), None, MappingProxyType({}))

    return Scenario("sand", "firm sand and nothing else", "curiosity", 0.5, 10.0, PlantSettings(), build)


def make_world(scenario=None, seed=0, sensors=None, rover=ROVER):
    """A world, and the drivers' ends of its links."""
    ends = board_links(rover, sensors or SensorSettings())
    world = World(
        rover, scenario or on_sand(), {board: end[1] for board, end in ends.items()}, seed=seed, sensors=sensors
    )
    return world, {board: end[0] for board, end in ends.items()}


def drive(world, seconds, speed_radps=0.0, rates=None):
    """Reports of `seconds` under one command, said anew each period; `rates` gives each wheel its own speed."""
    speed = np.full(len(world.rover.wheels), speed_radps) if rates is None else np.asarray(rates)
    reports = []
    for _ in range(round(seconds * 1e9) // world.period_ns):
        world.feed_wheel_commands(WheelCommands(world.now_ns, speed))
        reports.append(world.advance(world.now_ns + world.period_ns))
    return reports


def decoded(chunks, board):
    decoder = FrameDecoder(board)
    return [event.frame for data, _ in chunks for event in decoder.feed(data) if isinstance(event, AcceptedFrame)]


def test_a_frame_arrives_5_8_ms_after_its_scan_began():
    world, drivers = make_world()
    drive(world, 0.05)
    (first, *rest) = drivers[1].read(10**12)
    arrivals = [arrival for _, arrival in (first, *rest)]
    scans = [frame.t_us for frame in decoded([first, *rest], 1) if isinstance(frame, DataFrame)]
    assert len(scans) == len(arrivals) == 10
    delays_ms = [arrival / MS - 1e-3 * t_us for arrival, t_us in zip(arrivals, scans, strict=True)]
    assert delays_ms == pytest.approx([5.82] * 10, abs=0.02)
    assert np.diff(scans).tolist() == [5000] * 9


def test_no_frame_can_be_read_before_it_arrives():
    world, drivers = make_world()
    world.advance(10 * MS)
    assert drivers[1].read(world.now_ns - MS) == []  # the first scan's middle was at 5 ms: it arrives at 9.1 ms
    assert len(drivers[1].read(world.now_ns)) == 1
    assert drivers[1].read(14 * MS) == []
    assert len(drivers[1].read(15 * MS)) == 1


def test_boards_say_hello_first_and_when_asked():
    world, drivers = make_world()
    drive(world, 0.1)
    frames = decoded(drivers[2].read(10**12), 2)
    assert isinstance(frames[0], HelloFrame)
    assert [type(frame) for frame in frames[1:]] == [DataFrame] * 20
    assert (frames[0].board_id, frames[0].osr, frames[0].frame_us) == (2, 4, 5000)
    drivers[2].write(b"?", world.now_ns)
    drive(world, 0.05)
    kinds = [type(frame) for frame in decoded(drivers[2].read(10**12), 2)]
    assert kinds.count(HelloFrame) == 1


def seen_by_reader(world, drivers, seconds, rates, encoder_delay_ns=0):
    """Errors [rad] of VALID angles against the truth at their stamp, shape (2, W) as rms, and the share VALID.

    `encoder_delay_ns` is put on the encoder's stamps: what happens when they are stamped when they are read.
    """
    sensors = world.sensors
    resistance = strap_resistance_ohm(0.25)
    settings = StrapDriverParameters(
        pull_down_a_ohm=sensors.pull_down_ratio * resistance, pull_down_b_ohm=sensors.pull_down_ratio * resistance
    )
    reader = StrapReader(bind_straps(world.rover, settings), settings)
    truth, readings = [], []
    for _ in range(round(seconds * 100)):
        world.feed_wheel_commands(WheelCommands(world.now_ns, np.asarray(rates)))
        report = world.advance(world.now_ns + 10 * MS)
        states = report.wheel_states
        reader.feed_wheel_states(
            WheelStates(states.stamp_ns + encoder_delay_ns, states.angle, states.speed, states.torque)
        )
        truth.append((world.now_ns, world.plant.contact[:2].copy()))
        for index, board in enumerate(reader.board_ids):
            for data, host_ns in drivers[board].read(world.now_ns):
                reader.feed_bytes(index, data, host_ns)
        angles = reader.tick(world.now_ns).angles
        if angles is not None:
            readings.append(angles)
    times = np.array([time_ns for time_ns, _ in truth])
    late = [angles for angles in readings if angles.stamp_ns > 1_000 * MS]  # the zone has its shape by then
    stamps = np.array([angles.stamp_ns for angles in late])
    good = np.isin([angles.status for angles in late], (ContactStatus.VALID, ContactStatus.UNCONFIRMED))
    rms = []
    for row, name in enumerate(("theta_1", "theta_2")):
        values = np.array([contact[row] for _, contact in truth])
        expected = np.stack([np.interp(stamps, times, values[:, wheel]) for wheel in range(values.shape[1])], axis=1)
        error = np.array([getattr(angles, name) for angles in late]) - expected
        rms.append([math.sqrt((error[good[:, w], w] ** 2).mean()) for w in range(values.shape[1])])
    return np.array(rms), good.mean()


def test_a_reader_sees_the_true_angles_through_the_frames_on_both_sides_in_motion():
    """Left straps run one way round, right ones the other, and no two seams are at one place."""
    assert {wheel.strap_direction for wheel in ROVER.wheels} == {1, -1}
    world, drivers = make_world()
    rms, share = seen_by_reader(world, drivers, 6.0, [2.0] * 6)
    assert np.degrees(rms).max() < 0.6
    assert np.degrees(rms).max() < 4 * np.degrees(rms).min()  # no wheel is much worse than another
    assert 0.8 < share < 1.0  # the seams come by


def test_the_encoder_must_be_taken_at_the_scan_not_when_it_is_read():
    """10 ms at 2 rad/s are 1.1 deg: the reader interpolates, and this shows that it matters."""
    world, drivers = make_world()
    rms, _ = seen_by_reader(world, drivers, 4.0, [2.0] * 6, encoder_delay_ns=10 * MS)
    assert np.degrees(rms).min() > 0.8


def test_wheels_that_stand_since_the_start_are_seen_too():
    """With the contact midway round the strap both ends read alike, which only in motion is the sign of a fault."""
    world, drivers = make_world(seed=1)
    opposite = [w.strap_direction * (w.strap_offset_rad - 0.5 * math.pi) for w in ROVER.wheels]
    world.plant.wheels[p.ANGLE] = opposite  # every seam is on top
    rms, share = seen_by_reader(world, drivers, 2.0, [0.0] * 6)
    assert np.degrees(rms).max() < 0.6
    assert share == 1.0


def test_encoders_are_rounded_to_their_step_and_not_scaled():
    world, _ = make_world(sensors=replace(QUIET, encoder_step_rad=0.25))
    for report in drive(world, 2.0, 2.0):
        steps = report.wheel_states.angle / 0.25
        np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    assert np.abs(report.wheel_states.angle - world.plant.wheels[p.ANGLE]).max() <= 0.125 + 1e-9


def test_a_report_does_not_change_when_the_world_moves_on():
    world, _ = make_world(sensors=QUIET)
    report = drive(world, 0.5, 2.0)[-1]
    before = report.wheel_states.angle.copy()
    drive(world, 0.5, 2.0)
    np.testing.assert_array_equal(report.wheel_states.angle, before)


def test_without_noise_telemetry_is_the_truth():
    world, _ = make_world(sensors=QUIET)
    report = drive(world, 2.0, 2.0)[-1]
    body, wheels = world.plant.body, world.plant.wheels
    assert (report.body_motion.x, report.body_motion.speed) == (body[p.X], body[p.SPEED])
    np.testing.assert_array_equal(report.wheel_states.speed, wheels[p.OMEGA])
    np.testing.assert_array_equal(report.wheel_states.torque, world.plant.contact[p.TORQUE])
    assert 0.4 < body[p.SPEED] < 0.5  # it moves, and it slips
    whole = report.ground_truth.whole_rover
    assert whole[:4].tolist() == [body[p.X], body[p.SPEED], body[p.PITCH], 0.0]
    assert whole[4:].tolist() == [body[p.Y], body[p.HEADING], body[p.ROLL]]


def test_truth_tells_how_wheels_of_a_turning_rover_are_pushed_sideways():
    world, _ = make_world(sensors=QUIET)
    truth = drive(world, 2.0, rates=np.repeat([0.3, 1.0], 3))[-1].ground_truth.per_wheel
    side_force, slip_angle = truth[:, 9], truth[:, 10]
    assert np.abs(side_force).max() > 10.0  # newtons
    assert 0.01 < np.abs(slip_angle).max() < 1.0  # radians
    np.testing.assert_array_equal(side_force, world.plant.contact[p.SIDE_FORCE])


def test_all_records_of_a_report_carry_the_same_time():
    world, _ = make_world()
    for report in drive(world, 0.1):
        stamps = {report.wheel_states.stamp_ns, report.body_motion.stamp_ns, report.attitude.stamp_ns}
        assert stamps | {report.suspension.stamp_ns} == {report.wheel_states.stamp_ns}
    assert report.wheel_states.stamp_ns == world.now_ns == 100 * MS


def test_truth_comes_at_its_own_rate():
    world, _ = make_world()
    told = [report.ground_truth is not None for report in drive(world, 0.2)]
    assert told == [False, True] * 10


@pytest.mark.parametrize("degrees", [0.0, 8.0])
def test_the_imu_tells_slope_and_gravity(degrees):
    world, _ = make_world(on_sand(ramp(-10.0, 0.1, math.radians(degrees))))
    reports = drive(world, 4.0)
    pitch = np.array([report.attitude.pitch for report in reports])
    assert pitch.mean() == pytest.approx(math.radians(degrees), abs=5 * 0.003 / math.sqrt(pitch.size))
    assert pitch.std() == pytest.approx(0.003, rel=0.15)
    roll = np.array([report.attitude.roll for report in reports])
    assert roll.mean() == pytest.approx(0.0, abs=5 * 0.003 / math.sqrt(roll.size))
    assert roll.std() == pytest.approx(0.003, rel=0.15)
    assert all(sum(q * q for q in report.attitude.orientation) == pytest.approx(1.0) for report in reports)
    standing = reports[-1].attitude.forward_acceleration
    assert standing == pytest.approx(3.711 * math.sin(world.plant.body[p.PITCH]), abs=1e-4)


@pytest.mark.parametrize("heading_deg", [0.0, 50.0, -130.0])
def test_odometry_and_imu_stand_in_the_world_as_rep_103_has_it(heading_deg):
    world, _ = make_world(on_sand(ramp(-20.0, 0.1, math.radians(8.0))), sensors=QUIET)
    world.plant.body[[p.X, p.HEADING]] = 5.0, math.radians(heading_deg)
    report = world.advance(world.period_ns)
    turn = Rotation.from_quat(report.attitude.orientation)
    normal = np.array([-math.tan(math.radians(8.0)), 0.0, 1.0]) * math.cos(math.radians(8.0))
    assert turn.apply([0.0, 0.0, 1.0]) == pytest.approx(normal, abs=2e-3)  # deeper wheels tilt it by that much
    x, y, _ = turn.apply([1.0, 0.0, 0.0])
    assert math.degrees(math.atan2(y, x)) == pytest.approx(heading_deg, abs=0.01)
    assert math.degrees(report.body_motion.heading) == pytest.approx(heading_deg, abs=0.01)
    height = world.site.terrain.at(report.body_motion.x, report.body_motion.y)[ground_grid.HEIGHT]
    assert report.body_motion.z == pytest.approx(height, abs=1e-6)
    gravity = turn.inv().apply([0.0, 0.0, 3.711])
    assert report.attitude.forward_acceleration - world.plant.body[p.ACCELERATION] == pytest.approx(gravity[0])


def test_backwards_the_true_entry_is_behind():
    world, _ = make_world(sensors=QUIET)
    ahead, back = (drive(world, 4.0, speed)[-1].ground_truth.per_wheel for speed in (1.0, -1.0))
    for truth, sign in ((ahead, 1.0), (back, -1.0)):
        entry, leave = sign * truth[:, 3], sign * truth[:, 4]
        assert (entry > 0.0).all()
        assert (leave < 0.0).all()
        assert (entry > 1.5 * -leave).all()  # the wheel pushes itself into soil on the side it rolls to


def test_the_imu_feels_the_start():
    world, _ = make_world(sensors=QUIET)
    reports = drive(world, 1.5, 2.0)
    felt = np.cumsum([report.attitude.forward_acceleration * 0.01 for report in reports])
    speeds = np.array([report.body_motion.speed for report in reports])
    assert np.abs(felt - speeds).max() < 0.03  # level ground: the integral is the speed


@pytest.mark.parametrize("degrees", [0.0, 8.0])
def test_suspension_is_straight_on_even_ground(degrees):
    """Also uphill: the angles are relative to the body. Wheels sink a little differently when it leans back."""
    world, _ = make_world(on_sand(ramp(-10.0, 0.1, math.radians(degrees))), sensors=QUIET)
    angles = np.array([report.suspension.angle for report in drive(world, 1.0)])
    assert angles.shape == (100, 4)
    assert np.abs(angles).max() < (1e-9 if degrees == 0.0 else 0.005)


def test_suspension_bends_where_the_slope_begins():
    """Front wheels 0.3 m into a 10 deg slope, the rest on level ground: the rockers tilt, and the body with them."""
    world, _ = make_world(on_sand(ramp(1.0, 0.05, math.radians(10.0))), sensors=QUIET)
    world.plant.body[p.X] = 1.3
    angle = drive(world, 0.05)[-1].suspension.angle
    height = 0.3 * math.tan(math.radians(10.0))
    rocker = math.atan2(height, 1.45)  # pivot midway between middle and rear axle, at -1.45 m
    np.testing.assert_allclose(angle[[0, 2]], 0.0, atol=0.003)
    np.testing.assert_allclose(angle[[1, 3]], -rocker, atol=0.004)  # wheels sink differently


def test_a_stone_under_one_side_turns_the_rockers_against_each_other():
    world, _ = make_world(sensors=QUIET)
    samples = world.plant._samples
    raised = np.repeat(samples, 2, axis=0)  # rows at y = 0 and 1: the left wheels stand on the second
    raised[1, 75:85, ground_grid.HEIGHT] += 0.1  # x = -0.25 to 0.25 m, the front wheel alone
    world.plant._samples = raised
    angle = drive(world, 0.05)[-1].suspension.angle
    assert angle[0] == pytest.approx(-angle[2], abs=1e-9)
    assert angle[0] == pytest.approx(0.5 * math.atan2(0.1, 1.45), abs=0.002)


def test_noise_of_odometry_and_joints_has_the_size_it_is_given():
    world, _ = make_world(seed=5)
    reports = drive(world, 20.0)
    count = len(reports)
    truth = world.plant.body
    errors = {
        0.005: np.array([report.body_motion.speed for report in reports]) - truth[p.SPEED],
        0.001: np.array([report.body_motion.x for report in reports]) - truth[p.X],
        0.002: np.array([report.suspension.angle for report in reports]),
        1.0: np.array([report.wheel_states.torque for report in reports]) - world.plant.contact[p.TORQUE],
    }
    for sigma, error in errors.items():
        assert abs(error.mean()) < 5 * sigma / math.sqrt(error.size)
        assert error.std() == pytest.approx(sigma, rel=5 / math.sqrt(2 * error.size))
    speed, x = errors[0.005], errors[0.001]
    y = np.array([report.body_motion.y for report in reports]) - truth[p.Y]
    assert y.std() == pytest.approx(0.001, rel=5 / math.sqrt(2 * count))
    assert abs(np.corrcoef(x, y)[0, 1]) < 5 / math.sqrt(count)
    assert abs(np.corrcoef(speed, x)[0, 1]) < 5 / math.sqrt(count)  # independent of each other
    assert abs(np.corrcoef(speed[1:], speed[:-1])[0, 1]) < 5 / math.sqrt(count)  # and of the sample before
    assert all(report.body_motion.speed_std == 0.005 for report in reports)


def everything(seed, speed=1.0):
    world, drivers = make_world(scenario_named("composite"), seed)
    reports = drive(world, 0.5, speed)
    telemetry = b"".join(
        r.wheel_states.angle.tobytes() + r.wheel_states.torque.tobytes() + r.suspension.angle.tobytes()
        + repr((r.body_motion, r.attitude)).encode()
        for r in reports
    )  # fmt: skip
    return telemetry, [drivers[board].read(10**12) for board in (1, 2)]


def test_seed_and_commands_determine_everything_it_says():
    one, again, other, faster = everything(3), everything(3), everything(4), everything(3, 1.5)
    assert one == again
    for different in (other, faster):
        assert one[0] != different[0]
        assert one[1] != different[1]


def test_the_boards_noise_is_their_own():
    """Both boards look at the same arcs on level ground, yet at different noise."""
    _, frames = everything(3)
    sums = [
        [frame.sums for frame in decoded(chunks, board) if isinstance(frame, DataFrame)]
        for board, chunks in zip((1, 2), frames, strict=True)
    ]
    assert len(sums[0]) == len(sums[1]) == 100
    assert sums[0] != sums[1]


@pytest.mark.parametrize("now_ns", [0, -10 * MS, 5 * MS, 10 * MS + 1])
def test_the_world_moves_by_whole_periods_forward_only(now_ns):
    world, _ = make_world()
    with pytest.raises(ValueError, match="moves by whole periods of 10000000 ns"):
        world.advance(now_ns)
    assert world.now_ns == 0


def test_several_periods_at_once_are_the_same_world():
    one, drivers = make_world(sensors=QUIET)
    other, other_drivers = make_world(sensors=QUIET)
    drive(one, 0.2, 2.0)
    other.feed_wheel_commands(WheelCommands(0, np.full(6, 2.0)))
    other.advance(200 * MS)
    np.testing.assert_array_equal(one.plant.wheels, other.plant.wheels)
    assert drivers[1].read(10**12) == other_drivers[1].read(10**12)


def test_commands_are_copied():
    world, _ = make_world()
    speed = np.full(6, 1.0)
    world.feed_wheel_commands(WheelCommands(0, speed))
    speed[:] = 9.0
    assert world.plant.commands.tolist() == [1.0] * 6


def test_a_board_without_a_link_is_named():
    links = {board: ends[1] for board, ends in board_links(ROVER, SensorSettings()).items()}
    del links[2]
    with pytest.raises(ValueError, match=r"no link for board\(s\) \[2\] of rover 'curiosity'"):
        World(ROVER, on_sand(), links, 0)


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"telemetry_rate_hz": 160.0}, "telemetry_rate_hz: 160 Hz does not fit"),
        ({"scan_rate_hz": 160.0}, "scan_rate_hz: 160 Hz does not fit"),
        ({"truth_rate_hz": 30.0}, "truth_rate_hz: 30 Hz does not fit"),
        ({"osr": 8}, "osr"),
    ],
)
def test_rates_that_do_not_fit_are_refused(changes, named):
    with pytest.raises(ValueError, match=named):
        make_world(sensors=SensorSettings(**changes))


def test_every_rate_that_does_not_fit_is_named_at_once():
    with pytest.raises(SettingsError) as caught:
        make_world(sensors=SensorSettings(scan_rate_hz=160.0, truth_rate_hz=30.0))
    assert [problem.split(":")[0] for problem in caught.value.problems][:1] == ["scan_rate_hz"]
    assert "truth_rate_hz: 30 Hz" in str(caught.value)


@pytest.mark.parametrize("changes", [{"osr": 8}, {"baud": 9600}, {"adc_noise_lsb": -1.0}, {"supply_v": math.nan}])
def test_settings_that_no_board_can_have_are_refused(changes):
    with pytest.raises(SettingsError, match=next(iter(changes))):
        SensorSettings(**changes)


@pytest.mark.parametrize("joints", [("rocker",), ("a", "b", "c", "d", "e")])
def test_a_suspension_that_is_not_simulated_is_refused(joints):
    rover = replace(ROVER, suspension_joints=joints)
    with pytest.raises(ValueError, match=r"'curiosity': suspension_joints .* leave the list empty"):
        make_world(rover=rover)


def test_other_rates_that_do_fit_work():
    sensors = SensorSettings(telemetry_rate_hz=50.0, truth_rate_hz=25.0, scan_rate_hz=100.0)
    world, drivers = make_world(sensors=sensors)
    reports = drive(world, 0.2)
    assert (world.period_ns, len(reports)) == (20 * MS, 10)
    assert sum(report.ground_truth is not None for report in reports) == 5
    assert sum(isinstance(frame, DataFrame) for frame in decoded(drivers[1].read(10**12), 1)) == 20


def test_a_single_wheel_uses_one_channel_and_has_no_joints():
    scenario = scenario_named("single_wheel")
    world, drivers = make_world(scenario, rover=load_rover(scenario.rover))
    report = drive(world, 0.1, 0.5)[-1]
    assert report.suspension.angle.shape == (0,)
    assert report.wheel_states.angle.shape == (1,)
    assert report.ground_truth.whole_rover[3] == 40.0  # the drawbar load
    frames = [frame for frame in decoded(drivers[1].read(10**12), 1) if isinstance(frame, DataFrame)]
    assert len(frames) == 20


def test_the_nominal_strap_is_100_kohm_per_20_cm():
    strap = nominal_strap(0.25, 0.5, 5.0)
    assert strap.total_resistance_ohm == pytest.approx(100e3 * (2 * math.pi * 0.25) / 0.20)
    assert strap.pull_down_a_ohm == strap.pull_down_b_ohm == pytest.approx(0.5 * strap.total_resistance_ohm)


def test_motors_that_nobody_commands_any_more_stop():
    world, _ = make_world(sensors=SensorSettings(command_timeout_s=0.2))
    drive(world, 0.5, 1.0)
    for _ in range(19):  # the last command is a period old already
        world.advance(world.now_ns + world.period_ns)
    assert world.plant.commands.tolist() == [1.0] * 6
    world.advance(world.now_ns + 2 * world.period_ns)
    assert world.plant.commands.tolist() == [0.0] * 6


def test_without_a_time_out_the_last_command_stands():
    world, _ = make_world(sensors=SensorSettings(command_timeout_s=0.0))
    drive(world, 0.1, 1.0)
    world.advance(world.now_ns + 200 * world.period_ns)
    assert world.plant.commands.tolist() == [1.0] * 6


def test_scan_by_scan_it_says_the_same_as_period_by_period():
    world, drivers = make_world()
    twin, twin_drivers = make_world()
    whole = [world.advance(world.now_ns + world.period_ns) for _ in range(10)]
    looked = [report for _ in range(20) if (report := twin.advance_scan()) is not None]
    assert [report.wheel_states.stamp_ns for report in looked] == [report.wheel_states.stamp_ns for report in whole]
    for one, other in zip(whole, looked, strict=True):
        np.testing.assert_array_equal(one.wheel_states.angle, other.wheel_states.angle)
        assert one.body_motion == other.body_motion
    assert drivers[1].read(world.now_ns) == twin_drivers[1].read(world.now_ns)


def test_stamps_count_from_the_epoch_and_board_time_does_not():
    world, drivers = make_world()
    world.epoch_ns = 10**18
    report = world.advance(10 * MS)
    stamps = {report.wheel_states.stamp_ns, report.body_motion.stamp_ns, report.attitude.stamp_ns}
    assert stamps | {report.suspension.stamp_ns, world.ground_truth().stamp_ns} == {10**18 + 10 * MS}
    assert decoded(drivers[1].read(20 * MS), 1)[-1].t_us < 10_000


def test_a_board_that_is_reset_boots_and_begins_anew_while_the_other_goes_on():
    world, drivers = make_world(sensors=SensorSettings(board_boot_s=0.05))
    world.advance(100 * MS)
    for link in drivers.values():
        link.read(200 * MS)
    world.reset_board(1)
    world.advance(140 * MS)
    assert drivers[1].read(200 * MS) == []
    assert len(decoded(drivers[2].read(200 * MS), 2)) == 8
    world.advance(200 * MS)
    hello, first, *_ = decoded(drivers[1].read(300 * MS), 1)
    assert isinstance(hello, HelloFrame)
    assert (first.seq, first.t_us) == (0, 50_000 - 1695)


def test_clocks_of_boards_drift_apart():
    world, drivers = make_world(sensors=SensorSettings(board_clock_ppm=3000.0))
    world.advance(1_000 * MS)
    last = [decoded(drivers[board].read(2_000 * MS), board)[-1].t_us for board in (1, 2)]
    assert [t_us + 1695 for t_us in last] == [1_003_000, 997_000]


class ReopenedLink:
    """A link that is opened anew now and then, as a real port is."""

    def __init__(self, link):
        self._link = link
        self.session = 1
        self.read, self.write, self.name, self.close = link.read, link.write, link.name, link.close


def test_opening_its_port_restarts_a_board():
    ends = board_links(ROVER, SensorSettings())
    links = {board: ReopenedLink(end[1]) for board, end in ends.items()}
    world = World(ROVER, on_sand(), links, seed=0)
    world.advance(50 * MS)
    ends[1][0].read(100 * MS)
    links[1].session = 2
    world.advance(100 * MS)
    assert decoded(ends[1][0].read(200 * MS), 1)[1].seq == 0
