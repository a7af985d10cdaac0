"""The reader against wheels whose true zones are known: both mountings, both ways, and every way it can go wrong."""

import math
from dataclasses import fields, replace

import numpy as np
import pytest

from sim_bridge.virtual_uno import VirtualUno
from strap_rover.telemetry import WheelStates
from strap_sensor_driver.contact_zone import ContactStatus, remedy
from strap_sensor_driver.device_clock import strap_delay_us
from strap_sensor_driver.encoder_track import EncoderTrack
from strap_sensor_driver.frames import (
    DataFrame,
    FrameDecoder,
    HelloFrame,
    encode_data,
    encode_hello,
    encode_payload,
)
from strap_sensor_driver.mounting import StrapMounting
from strap_sensor_driver.reader_settings import StrapReaderSettings
from strap_sensor_driver.strap import Strap
from strap_sensor_driver.strap_reader import StrapReader
from strap_sensor_driver.strap_tracker import NEEDS_ROTATION, StrapBinding

SETTINGS = StrapReaderSettings()
MEASURED = (ContactStatus.VALID, ContactStatus.UNCONFIRMED)
USABLE = {*MEASURED, ContactStatus.PREDICTED}
TICK_NS = 10_000_000
BOARD_IDS = (3, 7)


class Rig:
    """Six wheels on two boards at 200 Hz, encoders and ticks at 100 Hz; zones, speeds and damage can be changed."""

    def __init__(self, *, speed=2.0, zone=(0.6, -0.35), noise_lsb=0.0, settings=SETTINGS, strap=None, hello=True):
        self.strap = strap or settings.strap()
        self.mountings = [StrapMounting(0.9 * wheel, 1 if wheel % 2 == 0 else -1) for wheel in range(6)]
        self.reader = StrapReader(
            [
                StrapBinding(wheel, BOARD_IDS[wheel // 3], wheel % 3, self.strap, mounting)
                for wheel, mounting in enumerate(self.mountings)
            ],
            settings,
        )
        self.boards = [
            VirtualUno(board_id, [self.strap] * 3, noise_lsb=noise_lsb, rng=np.random.default_rng(board_id))
            for board_id in BOARD_IDS
        ]
        self.speed, self.zone, self.contact = speed, zone, True
        self.hello = hello
        self.now_ns = 0
        self.shift_ns = 0  # of the host clock, which somebody sets
        self.position = 0.0
        self.damage = lambda _board, sums: sums
        self.mute = set()
        self.encoder_on = True
        self.boot_us = [0, 0]
        self.requests = []
        self.frames = []
        self.parsers = [FrameDecoder(), FrameDecoder()]

    def step(self):
        """10 ms: two scans of each board, one encoder sample, one tick when all bytes have arrived."""
        start_ns = self.now_ns
        for half in (0, 1):
            scan_ns = start_ns + half * 5_000_000
            for index, board in enumerate(self.boards):
                if index in self.mute:
                    continue
                middle_s = 1e-9 * (scan_ns - start_ns) + 1e-6 * board.middle_us()
                arcs = [
                    [
                        float(beta)
                        for beta in mounting.strap_angles(
                            *self.zone, self.position + self.speed * (middle_s + 1e-6 * strap_delay_us(4, channel))
                        )
                    ]
                    for channel, mounting in enumerate(self.mountings[3 * index : 3 * index + 3])
                ]
                device_us = scan_ns // 1000 - self.boot_us[index]
                data = board.scan(device_us, [a[0] for a in arcs], [a[1] for a in arcs], [self.contact] * 3)
                data = b"".join(self._tampered(index, event) for event in self.parsers[index].feed(data))
                self.reader.feed_bytes(index, data, scan_ns + 1000 * board.latency_us() + self.shift_ns)
        self.now_ns += TICK_NS
        self.position += self.speed * 1e-9 * TICK_NS
        if self.encoder_on:
            everyone = np.full(6, self.position), np.full(6, self.speed), np.zeros(6)
            self.reader.feed_wheel_states(WheelStates(self.now_ns + self.shift_ns, *everyone))
        reading = self.reader.tick(self.now_ns + 1_000_000 + self.shift_ns)
        self.requests += reading.requests
        return reading

    def _tampered(self, index, event):
        frame = getattr(event, "frame", None)
        if isinstance(frame, HelloFrame):
            return encode_hello(frame) if self.hello else b""
        if isinstance(frame, DataFrame):
            return encode_data(replace(frame, sums=tuple(self.damage(index, list(frame.sums)))))
        return b""

    def run(self, ticks):
        return [self.step() for _ in range(ticks)]

    def until_valid(self):
        """Run until all six wheels are measured at once."""
        for _ in range(1000):
            reading = self.step()
            if reading.angles is not None and np.isin(reading.angles.status, MEASURED).all():
                return reading.angles
        raise AssertionError("no tick without a seam")


def _statuses(readings, wheel):
    return [ContactStatus(int(r.angles.status[wheel])) for r in readings if r.angles is not None]


def _valid_errors_deg(rig, readings):
    angles = [r.angles for r in readings if r.angles is not None]
    valid = np.isin([a.status for a in angles], MEASURED)
    assert valid.any(axis=0).all()
    first = np.array([a.theta_1 for a in angles])[valid] - rig.zone[0]
    second = np.array([a.theta_2 for a in angles])[valid] - rig.zone[1]
    return np.degrees(np.concatenate([first, second]))


# --- measuring ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("speed", [0.3, 2.0, 4.0, -1.0])
def test_all_six_wheels_find_their_zone(speed):
    """Without noise the error is the converter's alone: the mean of the scans is unbiased at any speed."""
    rig = Rig(speed=speed)
    readings = rig.run(400)[5:]
    if speed < 0:
        rig.zone = rig.zone[::-1]  # the leading end is the entry
    errors = _valid_errors_deg(rig, readings)
    assert np.abs(errors).max() < 1.0
    assert abs(errors.mean()) < 0.02
    for wheel in range(6):
        assert set(_statuses(readings, wheel)) <= USABLE


def test_the_encoder_is_taken_at_the_scans_time():
    """At 4 rad/s, 1 ms is 0.23 deg: the mean error tells whether the times fit."""
    errors = _valid_errors_deg(rig := Rig(speed=4.0), rig.run(400)[5:])
    assert abs(errors.mean()) < 0.02


def test_the_claimed_std_covers_the_scatter_without_being_idle():
    rig = Rig(noise_lsb=1.0, settings=replace(SETTINGS, noise_lsb=1.0, angle_floor_std_rad=0.0))
    angles = [r.angles for r in rig.run(800)[5:] if r.angles is not None]
    valid = np.array([a.status for a in angles]) == ContactStatus.VALID
    for name, truth in (("theta_1", 0.6), ("theta_2", -0.35)):
        error = np.array([getattr(a, name) for a in angles])[valid] - truth
        std = np.array([getattr(a, name + "_std") for a in angles])[valid]
        assert 0.6 < np.sqrt(np.mean((error / std) ** 2)) < 1.05


def test_an_inverted_strap_reads_the_same():
    settings = replace(SETTINGS, inverted=True)
    errors = _valid_errors_deg(rig := Rig(settings=settings), rig.run(400)[5:])
    assert np.abs(errors).max() < 1.0


def test_uncertain_resistance_widens_the_std_with_the_distance_from_the_end():
    rig = Rig(settings=replace(SETTINGS, resistance_std_ratio=0.05), speed=1.0)
    angles = [r.angles for r in rig.run(700)[5:] if r.angles is not None]
    stds = np.array([a.theta_1_std[0] for a in angles if a.status[0] == 0])
    # the entry is end B's: 5 % of the rest of the turn, when the exit is just past the seam
    assert math.degrees(stds.max()) == pytest.approx(0.05 * (360.0 - math.degrees(0.95)), abs=0.3)
    assert math.degrees(stds.min()) < 1.0


def test_the_seam_is_bridged_for_the_share_of_a_turn_that_the_zone_takes():
    rig = Rig(speed=2.0)
    rig.until_valid()
    readings = rig.run(round(8 * math.pi / 2.0 / 0.01))
    for wheel in range(6):
        held = np.array([s is ContactStatus.PREDICTED for s in _statuses(readings, wheel)])
        assert held.mean() == pytest.approx(0.95 / (2 * math.pi), abs=0.03)
        angles = [r.angles for r in readings if r.angles is not None]
        theta_1 = np.array([a.theta_1[wheel] for a in angles])
        std = np.array([a.theta_1_std[wheel] for a in angles])
        np.testing.assert_allclose(theta_1[held], 0.6, atol=math.radians(1.0))
        inside = held[1:] & held[:-1]
        assert (np.diff(std)[inside] > 0.0).all()
        assert std[held].max() == pytest.approx(0.15 * 0.95, abs=0.03)


def test_a_zone_behind_at_half_a_turn_is_averaged_the_short_way_round():
    settings = replace(SETTINGS, theta_max_rad=math.pi)
    rig = Rig(zone=(-3.0, 3.0), speed=0.5, settings=settings)  # 16 deg wide, about top dead centre
    readings = rig.run(300)[5:]
    for reading in readings:
        if reading.angles is not None and reading.angles.status[0] in MEASURED:
            assert reading.angles.theta_1[0] == pytest.approx(-3.0, abs=0.02)
            assert reading.angles.theta_2[0] == pytest.approx(3.0, abs=0.02)


def test_volts_are_those_at_the_ends_and_the_stamp_is_the_mean_middle():
    rig = Rig()
    rig.until_valid()
    rig.speed = 0.0
    angles = rig.run(2)[-1].angles
    reading = rig.step()
    for wheel, mounting in enumerate(rig.mountings):
        v_a, v_b = rig.strap.terminal_voltages(*mounting.strap_angles(*rig.zone, rig.position))
        assert reading.voltages.v_a[wheel] == pytest.approx(float(v_a), abs=0.5 * 5.0 / 1024 + 1e-12)
        assert reading.voltages.v_b[wheel] == pytest.approx(float(v_b), abs=0.5 * 5.0 / 1024 + 1e-12)
    middle_ns = rig.now_ns - TICK_NS + 2_500_000 + 1000 * rig.boards[0].middle_us()
    assert reading.angles.stamp_ns == reading.voltages.stamp_ns == pytest.approx(middle_ns, abs=1000)
    assert reading.angles.stamp_ns - angles.stamp_ns == pytest.approx(TICK_NS, abs=1000)
    assert reading.angles.status.dtype == np.int64
    assert reading.angles.theta_1.shape == (6,)


def test_a_tick_without_news_is_empty():
    rig = Rig()
    rig.run(5)
    reading = rig.reader.tick(rig.now_ns + 2_000_000)
    assert (reading.raw, reading.voltages, reading.angles, reading.requests) == ([], None, None, [])


def test_raw_frames_replay_to_the_same_bits():
    rig = Rig(noise_lsb=0.7)
    live = []
    inputs = []
    for index in range(150):
        if index == 70:
            rig.boards[0].restart()
            rig.boot_us[0] = rig.now_ns // 1000
        if index == 100:
            rig.contact = False
        reading = rig.step()
        inputs.append((rig.now_ns, rig.position, reading.raw))
        live.append(reading)
    again = Rig().reader
    for (now_ns, position, raw), reading in zip(inputs, live, strict=True):
        for host_ns, payload, board_index in raw:
            again.feed_bytes(board_index, encode_payload(payload), host_ns)
        again.feed_wheel_states(WheelStates(now_ns, np.full(6, position), np.full(6, rig.speed), np.zeros(6)))
        replayed = again.tick(now_ns + 1_000_000)
        assert replayed.raw == reading.raw
        for name in ("theta_1", "theta_2", "theta_1_std", "theta_2_std", "status", "stamp_ns"):
            assert np.array_equal(getattr(replayed.angles, name), getattr(reading.angles, name))
        assert np.array_equal(replayed.voltages.v_a, reading.voltages.v_a)


# --- travel, air, encoder -------------------------------------------------------------------------------------------


def test_reversing_swaps_entry_and_exit_after_a_little_travel_at_any_speed():
    rig = Rig(speed=1.0)
    rig.until_valid()
    rig.speed = -0.9  # 0.009 rad each step: believed after more than 0.02
    for forwards in (True, True, False):
        angles = rig.step().angles
        assert (angles.theta_1[0] == pytest.approx(0.6, abs=0.02)) == forwards
    assert angles.theta_1[0] == pytest.approx(-0.35, abs=0.02)
    assert angles.theta_2[0] == pytest.approx(0.6, abs=0.02)
    rig.speed = 0.005
    rig.run(399)
    assert rig.until_valid().theta_1[0] == pytest.approx(-0.35, abs=0.02)
    rig.run(10)
    assert rig.until_valid().theta_1[0] == pytest.approx(0.6, abs=0.02)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_standing_wheel_keeps_its_direction_whatever_its_speed_sensor_says(sign):
    rig = Rig(speed=sign)
    rig.run(20)
    before = rig.until_valid()
    assert (np.sign(before.theta_1) == sign).all()
    rig.speed, rig.encoder_on = 0.0, False
    rng = np.random.default_rng(0)
    for _ in range(200):
        position = np.full(6, rig.position) + 0.002 * rng.standard_normal(6)
        speed = -sign * rng.uniform(0.0, 1.0, 6)
        rig.reader.feed_wheel_states(WheelStates(rig.now_ns + TICK_NS, position, speed, np.zeros(6)))
        angles = rig.step().angles
        assert (np.sign(angles.theta_1) == sign).all()
        assert (np.sign(angles.theta_2) == -sign).all()


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("position", [-5.0, 0.0, 5.0])
def test_encoders_that_count_from_elsewhere_after_a_gap_turn_no_direction(sign, position):
    """What sends wheel_states was started anew: no wheel has rolled back for that."""
    rig = Rig(speed=sign)
    rig.run(200)
    assert (np.sign(rig.until_valid().theta_1) == sign).all()
    rig.encoder_on = False
    rig.run(30)
    rig.encoder_on, rig.position, rig.speed = True, position, 0.0
    readings = rig.run(100)
    for reading in readings:
        assert (np.sign(reading.angles.theta_1) == sign).all()
    assert np.count_nonzero(np.isin(readings[-1].angles.status, MEASURED)) >= 5  # one may stand on its seam
    rig.speed = -sign
    assert (np.sign(rig.run(5)[-1].angles.theta_1) == -sign).all()


@pytest.mark.parametrize("speed", [0.0, 0.5, 2.0])
def test_a_drive_that_was_reset_leaves_no_strap_stuck(speed):
    """Its encoder counts from elsewhere from one sample to the next, as if the wheel had turned many times."""
    rig = Rig(speed=speed)
    rig.run(200)
    rig.position += 14.0 * math.pi
    last = rig.run(300)[-1].angles
    measured = np.isin(last.status, MEASURED)  # one may be on its seam
    assert np.count_nonzero(measured) >= 4
    np.testing.assert_allclose(last.theta_1[measured], rig.zone[0], atol=0.02)
    assert [wheel.faults for wheel in rig.reader.health().wheels] == [0] * 6
    assert rig.reader.health().wheel_states_jumps == 1


@pytest.mark.parametrize("speed", [0.3, 2.0])
def test_an_encoder_that_wraps_once_per_turn_is_followed(speed):
    rig = Rig(speed=speed)
    feed, fed = rig.reader.feed_wheel_states, []

    def feed_wrapped(states):
        fed.append(np.mod(states.angle, 2.0 * math.pi))
        feed(replace(states, angle=fed[-1]))

    rig.reader.feed_wheel_states = feed_wrapped
    readings = rig.run(2500)
    assert np.abs(_valid_errors_deg(rig, readings)).max() < 1.0
    health = rig.reader.health()
    assert [wheel.faults for wheel in health.wheels] == [0] * 6
    wraps = np.abs(np.diff(np.array(fed)[:, 0])) > math.pi
    assert health.wheel_states_jumps == np.count_nonzero(wraps) > 0


def test_rotation_across_a_jump_acquits_no_strap():
    rig = Rig(speed=0.0)
    rig.run(10)
    rig.damage = lambda board, sums: [1600, 1600, *sums[2:]] if board == 0 else sums
    assert _statuses(rig.run(3), 0)[-1] is ContactStatus.FAULT_ORDER
    rig.damage = lambda _board, sums: sums
    rig.run(10)
    rig.position += 50.0
    assert set(_statuses(rig.run(20), 0)) == {ContactStatus.FAULT_ORDER}


def test_a_wheel_in_the_air_has_no_contact_and_no_information():
    rig = Rig(noise_lsb=0.5)
    rig.until_valid()
    rig.contact = False
    angles = rig.run(60)[-1].angles
    assert (angles.status == ContactStatus.NO_CONTACT).all()
    assert not angles.theta_1.any()
    np.testing.assert_allclose(angles.theta_1_std, math.pi)
    rig.contact = True
    assert rig.until_valid().theta_1[0] == pytest.approx(0.6, abs=0.02)
    assert all(wheel.faults == 0 for wheel in rig.reader.health().wheels)


def test_an_encoder_that_stops_is_a_fault_after_30_ms_and_the_zone_is_held():
    rig = Rig(speed=0.5)
    before = rig.until_valid()
    rig.encoder_on = False
    rig.speed = 0.5
    readings = rig.run(8)
    statuses = _statuses(readings, 0)
    assert statuses[0] is not ContactStatus.STALE_ENCODER
    assert statuses[4:] == [ContactStatus.STALE_ENCODER] * 4
    assert readings[-1].angles.theta_1[0] == pytest.approx(before.theta_1[0], abs=0.02)
    rig.encoder_on = True
    rig.run(2)
    assert rig.until_valid() is not None


def test_bad_encoder_samples_are_counted_and_left_out():
    rig = Rig()
    rig.run(3)
    good = np.zeros(6)
    for states in (
        WheelStates(1, good, good, good),
        WheelStates(10**12, np.zeros(5), good, good),
        WheelStates(10**12, good, np.full(6, math.nan), good),
        WheelStates(10**12, np.full(6, math.inf), good, good),
    ):
        rig.reader.feed_wheel_states(states)
    assert rig.reader.health().wheel_states_rejected == 4
    errors = _valid_errors_deg(rig, rig.run(200))
    assert np.abs(errors).max() < 1.0


# --- damage ---------------------------------------------------------------------------------------------------------


def _pinned(channel, value):
    def damage(board, sums):
        if board == 0:
            sums[channel] = value(sums)
        return sums

    return damage


CASES = [
    ("open A", 0, lambda _sums: 0, {ContactStatus.FAULT_OPEN_A}),
    ("open B", 1, lambda _sums: 3, {ContactStatus.FAULT_OPEN_B}),
    (
        "A shorted to supply",
        0,
        lambda _sums: 4092,
        {ContactStatus.FAULT_SHORT, ContactStatus.FAULT_WIDTH, ContactStatus.FAULT_PLACE},
    ),
    ("B shorted to supply", 1, lambda _sums: 4092, {ContactStatus.FAULT_SHORT, ContactStatus.FAULT_WIDTH}),
    (
        "A stuck",
        0,
        lambda _sums: 2400,
        {ContactStatus.FAULT_STUCK, ContactStatus.FAULT_ORDER, ContactStatus.FAULT_WIDTH},
    ),
    (
        "B floats after A",
        1,
        lambda sums: sums[0],
        {
            ContactStatus.FAULT_FLOATING,
            ContactStatus.FAULT_ORDER,
            ContactStatus.FAULT_WIDTH,
            ContactStatus.FAULT_PLACE,
        },
    ),
    ("A too low", 0, lambda _sums: 900, {ContactStatus.FAULT_RANGE}),
]


@pytest.mark.parametrize(("name", "channel", "value", "expected"), CASES, ids=[case[0] for case in CASES])
def test_damage_is_a_named_fault_within_a_turn_and_the_others_do_not_suffer(name, channel, value, expected):
    rig = Rig(speed=2.0, noise_lsb=0.3)
    rig.until_valid()
    rig.damage = _pinned(channel, value)
    readings = rig.run(400)
    statuses = _statuses(readings, 0)
    faults = {status for status in statuses if status.is_fault}
    assert faults, name
    assert faults <= expected
    turn = 315
    begin = next(index for index, status in enumerate(statuses) if status.is_fault)
    assert begin < turn
    assert sum(status is ContactStatus.VALID for status in statuses[begin:]) < 0.25 * turn
    health = rig.reader.health()
    assert health.wheels[0].faults >= 1
    assert sum(count for status, count in health.wheels[0].scans.items() if status.is_fault) > 100
    assert [wheel.faults for wheel in health.wheels[1:]] == [0] * 5
    rig.damage = lambda _board, sums: sums
    rig.run(400)
    assert rig.reader.health().wheels[0].status in USABLE


def test_a_fault_holds_the_last_zone_and_its_std_grows():
    rig = Rig(speed=1.0)
    before = rig.until_valid()
    rig.damage = _pinned(0, lambda _sums: 0)
    angles = [reading.angles for reading in rig.run(60)]
    assert [a.status[0] for a in angles[:2]] == [ContactStatus.PREDICTED, ContactStatus.FAULT_OPEN_A]
    assert all(a.status[0] == ContactStatus.FAULT_OPEN_A for a in angles[1:])
    assert all(a.theta_1[0] == before.theta_1[0] and a.theta_2[0] == before.theta_2[0] for a in angles)
    std = np.array([a.theta_1_std[0] for a in angles])
    assert (np.diff(std) > 0.0).all()
    # 0.6 s at 1 rad/s: 0.15 per rad and 0.1 per s, at right angles
    assert std[-1] == pytest.approx(math.hypot(0.15 * 0.6, 0.1 * 0.58, before.theta_1_std[0]), rel=0.05)


def test_a_single_bad_scan_is_bridged_and_not_a_fault():
    rig = Rig()
    rig.until_valid()
    rig.speed = 0.0
    hits = iter([True, False] * 50)
    rig.damage = lambda board, sums: [0, *sums[1:]] if board == 0 and next(hits, False) else sums
    statuses = _statuses(rig.run(20), 0)
    assert set(statuses) == {ContactStatus.VALID}  # the other scan of the tick is good
    health = rig.reader.health().wheels[0]
    assert health.faults == 0
    assert health.scans[ContactStatus.PREDICTED] == 20


def test_a_seam_that_lasts_too_long_is_a_short():
    rig = Rig(speed=2.0)
    rig.until_valid()
    rig.damage = lambda board, sums: [4092, 4092, *sums[2:]] if board == 0 else sums
    statuses = _statuses(rig.run(280), 0)
    first = statuses.index(ContactStatus.FAULT_SHORT)
    assert set(statuses[:first]) == {ContactStatus.PREDICTED}
    assert 175 <= first <= 225  # 3.5 rad at 2 rad/s, and up to a zone's width when it began in the seam
    assert set(statuses[first:]) == {ContactStatus.FAULT_SHORT}


def test_an_input_that_copies_its_neighbour_is_found_where_it_looks_valid():
    """With V_B = V_A the zone looks sound for beta_1 from a quarter to half a turn."""
    rig = Rig(speed=2.0, settings=replace(SETTINGS, theta_max_rad=math.pi))
    rig.until_valid()
    low, high = (float(v) for v in rig.strap.terminal_voltages([2.0, 1.8], [2.0, 1.8])[0])
    while not low < rig.step().voltages.v_a[0] < high:
        pass
    rig.damage = _pinned(1, lambda sums: sums[0])
    statuses = _statuses(rig.run(40), 0)
    assert next(status for status in statuses if status.is_fault) is ContactStatus.FAULT_FLOATING


def test_a_fault_that_turns_into_another_is_renamed():
    rig = Rig(speed=0.5)
    rig.until_valid()
    rig.damage = _pinned(0, lambda _sums: 0)
    assert _statuses(rig.run(3), 0)[-1] is ContactStatus.FAULT_OPEN_A
    rig.damage = _pinned(1, lambda _sums: 0)
    assert _statuses(rig.run(3), 0)[-1] is ContactStatus.FAULT_OPEN_B
    assert rig.reader.health().wheels[0].faults == 1


def test_a_contradiction_is_over_only_after_half_a_radian_without_one():
    rig = Rig(speed=0.5)
    rig.until_valid()
    rig.damage = lambda board, sums: [1600, 1600, *sums[2:]] if board == 0 else sums
    assert _statuses(rig.run(3), 0)[-1] is ContactStatus.FAULT_ORDER
    rig.damage = lambda _board, sums: sums
    statuses = _statuses(rig.run(120), 0)
    assert set(statuses[:98]) == {ContactStatus.FAULT_ORDER}
    assert ContactStatus.FAULT_ORDER not in statuses[103:]


def test_a_fault_that_only_rotation_ends_says_how_else_and_a_reset_is_how():
    """The controller stands still for it: without the way out the rover would stand for good."""
    assert all(("~/reset" in remedy(status)) == (status in NEEDS_ROTATION) for status in ContactStatus)
    rig = Rig(speed=0.0)
    rig.run(20)
    rig.damage = lambda board, sums: [1600, 1600, *sums[2:]] if board == 0 else sums
    rig.run(3)
    rig.damage = lambda _board, sums: sums
    assert _statuses(rig.run(50), 0)[-1] is ContactStatus.FAULT_ORDER
    rig.reader.reset()
    assert _statuses(rig.run(200), 0)[-1] is ContactStatus.UNCONFIRMED  # until the wheel turns


def test_one_bad_moment_of_a_standing_wheel_is_over_after_a_second_of_good_ones():
    """The controller stands still for the fault, so that the wheel cannot turn to disprove it."""
    rig = Rig(speed=0.0)
    rig.run(20)
    rig.damage = lambda board, sums: [1600, 1600, *sums[2:]] if board == 0 else sums
    rig.run(3)
    rig.damage = lambda _board, sums: sums
    statuses = _statuses(rig.run(150), 0)
    assert set(statuses[:95]) == {ContactStatus.FAULT_ORDER}
    assert set(statuses[110:]) == {ContactStatus.UNCONFIRMED}


def test_what_an_end_did_while_nobody_looked_is_not_held_against_it():
    """A whole turn while the board was silent: the same volts as before, and no fault."""
    rig = Rig(speed=0.2)
    rig.until_valid()
    rig.mute = {0}
    rig.run(15)
    rig.position += 2.0 * math.pi
    rig.run(15)
    rig.mute = set()
    rig.run(30)
    assert [wheel.faults for wheel in rig.reader.health().wheels[:3]] == [0, 0, 0]


def test_a_standing_wheel_whose_ends_read_the_same_is_not_taken_to_float_because_its_encoder_came_late():
    """As after a restart of the driver on a rover that has come far: the first scans know no position."""
    rig = Rig(speed=0.0)
    rig.position = 20.999
    rig.damage = lambda _board, _sums: [2200] * 6
    rig.encoder_on = False
    assert set(_statuses(rig.run(20), 4)) == {ContactStatus.STALE_ENCODER}
    rig.encoder_on = True
    readings = rig.run(20)
    assert ContactStatus.FAULT_FLOATING not in _statuses(readings, 4)
    assert _statuses(readings, 4)[-1] is ContactStatus.UNCONFIRMED


def test_a_wheel_in_the_air_stays_there_when_a_scan_is_missing():
    rig = Rig()
    rig.until_valid()
    rig.contact = False
    rig.run(3)
    rig.mute = {1}
    assert _statuses(rig.run(3), 5) == [ContactStatus.NO_CONTACT] * 3


def test_positions_are_not_made_up_across_a_gap_of_the_encoder():
    encoder = EncoderTrack(1, 30_000_000)
    for stamp_ns, angle in ((0, 1.0), (50_000_000, 1.1), (250_000_000, 3.0)):
        encoder.add(WheelStates(stamp_ns, np.array([angle]), np.array([2.0]), np.zeros(1)))
    assert encoder.at(25_000_000) == [pytest.approx(1.05)]
    assert encoder.at(70_000_000) == [pytest.approx(1.14)]
    assert encoder.at(150_000_000) is None
    assert encoder.at(230_000_000) == [pytest.approx(2.96)]
    assert encoder.at(280_000_000) == [pytest.approx(3.06)]
    assert encoder.at(281_000_000) is None
    assert encoder.at(-30_000_000) == [pytest.approx(0.94)]
    assert encoder.at(-31_000_000) is None
    for index in range(1000):
        encoder.add(WheelStates(10**9 + index, np.zeros(1), np.zeros(1), np.zeros(1)))
    assert len(encoder._stamps) <= 64
    assert encoder.at(10**9 + 998) == [0.0]


def test_a_standing_wheel_is_never_stuck():
    rig = Rig()
    rig.until_valid()
    rig.speed = 0.0
    readings = rig.run(300)
    assert all(set(_statuses(readings, wheel)) <= set(MEASURED) for wheel in range(6))


# --- boards ---------------------------------------------------------------------------------------------------------


def test_a_silent_board_costs_its_own_wheels_only():
    rig = Rig()
    rig.until_valid()
    rig.mute = {1}
    readings = rig.run(60)
    for wheel in range(3):
        assert set(_statuses(readings, wheel)) <= USABLE
    for wheel in range(3, 6):
        statuses = _statuses(readings, wheel)
        assert set(statuses[:9]) == {ContactStatus.PREDICTED}
        assert set(statuses[11:]) == {ContactStatus.NO_DATA}
    rig.mute = set()
    assert rig.until_valid() is not None


def test_without_any_board_no_data_is_said_at_each_tick():
    rig = Rig()
    rig.mute = {0, 1}
    readings = rig.run(60)
    assert all(reading.angles is None for reading in readings[:10])
    said = [reading.angles for reading in readings[12:]]
    assert all((angles.status == ContactStatus.NO_DATA).all() for angles in said)
    assert all((angles.theta_1_std == math.pi).all() for angles in said)
    assert all(reading.voltages is None for reading in readings)
    stamps = [angles.stamp_ns for angles in said]
    assert stamps == sorted(set(stamps))


def test_a_board_is_asked_for_hello_each_half_second_until_it_comes():
    rig = Rig(hello=False)
    readings = rig.run(150)
    assert [request.board_index for request in rig.requests] == [0, 1, 0, 1, 0, 1]
    assert {request.data for request in rig.requests} == {b"?"}
    assert all(reading.voltages is None for reading in readings)
    assert sum(len(reading.raw) for reading in readings) == 600
    assert (readings[-1].angles.status == ContactStatus.NO_DATA).all()
    health = rig.reader.health()
    assert [board.scans_before_hello for board in health.boards] == [300, 300]
    rig.hello = True
    for board in rig.boards:
        board.feed(b"?")
    asked = len(rig.requests)
    assert rig.until_valid() is not None
    rig.run(100)
    assert len(rig.requests) == asked


def test_an_unknown_protocol_is_refused_and_said():
    rig = Rig()
    rig.until_valid()
    hello = rig.reader.health().boards[1].hello
    rig.reader.feed_bytes(1, encode_hello(replace(hello, proto=2, version="new")), rig.now_ns)
    readings = rig.run(5)
    assert set(_statuses(readings, 4)) == {ContactStatus.UNKNOWN_PROTOCOL}
    assert rig.reader.health().boards[1].refused.version == "new"
    assert rig.reader.health().boards[0].refused is None
    rig.boards[1].feed(b"?")
    assert rig.until_valid() is not None
    assert rig.reader.health().boards[1].refused is None


def test_a_board_that_restarts_goes_on_without_a_wrong_angle():
    rig = Rig(speed=2.0)
    readings = rig.run(100)[5:]
    rig.boards[0].restart()
    rig.boot_us[0] = rig.now_ns // 1000
    readings += rig.run(200)
    errors = _valid_errors_deg(rig, readings)
    assert np.abs(errors).max() < 1.0
    health = rig.reader.health().boards
    assert [board.frames.restart for board in health] == [1, 0]
    assert [board.clock_resets for board in health] == [1, 0]


def test_a_restart_whose_hello_was_lost_waits_for_the_next_one():
    rig = Rig()
    rig.until_valid()
    rig.hello = False
    rig.boards[0].restart()
    rig.boot_us[0] = rig.now_ns // 1000
    before = rig.reader.health().boards[0].scans
    rig.run(30)
    health = rig.reader.health().boards[0]
    assert health.hello is None
    assert health.scans <= before + 1
    assert [request.board_index for request in rig.requests] == [0]
    rig.hello = True
    rig.boards[0].feed(b"?")
    assert rig.until_valid() is not None


def test_a_reopened_link_is_a_new_start():
    rig = Rig()
    rig.run(250)
    assert rig.reader.health().boards[0].clock_ppm == 0.0
    rig.reader.reopen_board(0)
    assert rig.reader.health().boards[0].hello is None
    assert rig.reader.health().boards[0].clock_ppm is None
    rig.step()
    assert rig.requests[-1].board_index == 0
    rig.boards[0].feed(rig.requests[-1].data)
    assert rig.until_valid() is not None
    assert rig.reader.health().boards[0].frames.restart == 0


def test_health_is_a_copy_and_counts_what_happened():
    rig = Rig()
    rig.run(50)
    before = rig.reader.health()
    rig.reader.feed_bytes(0, b"junk\0" * 3, rig.now_ns)
    rig.run(50)
    after = rig.reader.health()
    assert before.boards[0].frames.data == before.boards[0].scans == 100
    assert after.boards[0].frames.data == 200
    assert after.boards[0].frames.bad_cobs == 3
    assert before.boards[0].frames.bad_cobs == 0
    assert after.boards[0].mismatched_hellos == 0
    assert sum(after.wheels[0].scans.values()) == 200
    assert [board.board_id for board in after.boards] == list(rig.reader.board_ids) == [3, 7]
    assert all(board.clock_ppm is None for board in after.boards)
    rig.run(150)
    assert [board.clock_ppm for board in rig.reader.health().boards] == [0.0, 0.0]
    assert [board.frame_delay_ms for board in rig.reader.health().boards] == [0.0, 0.0]


def test_a_board_with_other_settings_is_noticed_and_still_right():
    rig = Rig(settings=replace(SETTINGS, osr=3))
    errors = _valid_errors_deg(rig, rig.run(200)[5:])
    assert np.abs(errors).max() < 1.0
    assert rig.reader.health().boards[0].mismatched_hellos > 0


def test_frames_that_no_tick_takes_are_bounded_and_counted():
    rig = Rig()
    rig.run(2)
    seq = rig.reader.health().boards[0].hello.seq + 4
    for index in range(5000):
        frame = DataFrame(3, (seq + index) & 0xFFFF, 20_000 + 5000 * index, 0, 4, (2000,) * 6)
        rig.reader.feed_bytes(0, encode_data(frame), rig.now_ns + 5_000_000 * index)
    reading = rig.reader.tick(rig.now_ns + 25_000_000_000)
    assert len(reading.raw) == 4096
    assert rig.reader.health().boards[0].dropped_frames == 5000 - 4096


# --- the host clock is set -------------------------------------------------------------------------------------------

HOUR_NS = 3_600_000_000_000
STEPS_NS = [HOUR_NS, -HOUR_NS, 2_000_000_000, -2_000_000_000, 300_000_000, -300_000_000]


@pytest.mark.parametrize("encoder_first", [True, False])
@pytest.mark.parametrize("step_ns", STEPS_NS)
def test_a_step_of_the_host_clock_is_over_within_a_second(step_ns, encoder_first):
    rig = Rig(speed=1.0)
    before = rig.run(100)[-1]
    if encoder_first:  # the encoder's process sees the new time before the driver's tick does
        everyone = np.full(6, rig.position), np.full(6, rig.speed), np.zeros(6)
        rig.reader.feed_wheel_states(WheelStates(rig.now_ns + 1_000_000 + step_ns, *everyone))
    rig.shift_ns = step_ns
    rig.run(100)
    rejected = rig.reader.health().wheel_states_rejected
    readings = rig.run(150)
    errors = _valid_errors_deg(rig, readings)
    assert np.abs(errors).max() < 1.0
    assert rig.reader.health().wheel_states_rejected == rejected <= 32
    for wheel in range(6):
        assert set(_statuses(readings, wheel)) <= USABLE
    stamps = np.array([reading.angles.stamp_ns for reading in readings])
    assert (np.diff(stamps) == TICK_NS).all()
    assert stamps[0] - before.angles.stamp_ns == pytest.approx(101 * TICK_NS + step_ns, abs=2)
    assert [wheel.faults for wheel in rig.reader.health().wheels] == [0] * 6
    assert [board.clock_resets for board in rig.reader.health().boards] == [1, 1]


@pytest.mark.parametrize("step_ns", [step_ns for step_ns in STEPS_NS if step_ns != -300_000_000])  # is waited for
def test_stamps_are_never_of_the_future_when_the_host_clock_is_set(step_ns, monkeypatch):
    rig = Rig()
    rig.run(100)
    tick = rig.reader.tick
    with monkeypatch.context() as patch:  # set between the frames' receipt and the tick
        patch.setattr(rig.reader, "tick", lambda now_ns: tick(now_ns + step_ns))
        readings = [(rig.step(), rig.now_ns)]
    rig.shift_ns = step_ns
    readings += [(rig.step(), rig.now_ns) for _ in range(100)]
    for reading, now_ns in readings:
        assert reading.angles.stamp_ns <= now_ns + 1_000_000 + step_ns


@pytest.mark.parametrize("step_ms", [80, 100, 300, 450, -100, -300, -900, -2000, 2000])
def test_no_angle_is_called_valid_that_a_step_of_the_clock_has_spoiled(step_ms):
    rig = Rig(speed=2.0)
    rig.run(100)
    rig.shift_ns = 1_000_000 * step_ms
    errors = _valid_errors_deg(rig, rig.run(200))
    assert np.abs(errors).max() < 1.0


@pytest.mark.parametrize("step_ns", STEPS_NS)
def test_a_board_that_falls_silent_as_the_host_clock_is_set_is_noticed(step_ns):
    rig = Rig()
    rig.until_valid()
    rig.mute = {0, 1}
    rig.shift_ns = step_ns
    readings = rig.run(60)
    for wheel in range(6):
        assert set(_statuses(readings[11:], wheel)) == {ContactStatus.NO_DATA}
    assert len(_statuses(readings[11:], 0)) == 49


@pytest.mark.parametrize("step_ns", STEPS_NS)
def test_boards_that_never_spoke_are_missed_though_the_host_clock_was_set(step_ns):
    rig = Rig()
    rig.mute = {0, 1}
    rig.run(3)
    rig.shift_ns = step_ns
    assert set(_statuses(rig.run(60)[12:], 0)) == {ContactStatus.NO_DATA}


@pytest.mark.parametrize("step_ns", STEPS_NS)
def test_a_held_zone_ages_by_the_time_that_passed_and_not_by_the_clock_s_step(step_ns):
    rig = Rig()
    rig.until_valid()
    rig.speed = 0.0
    before = rig.run(2)[-1].angles
    rig.damage = _pinned(0, lambda _sums: 0)
    rig.run(200)
    rig.shift_ns = step_ns
    angles = rig.run(100)[-1].angles
    assert angles.status[0] == ContactStatus.FAULT_OPEN_A
    held_s = 2.98 + (min(step_ns, 990_000_000) * 1e-9 if step_ns > 0 else -0.01)
    assert angles.theta_1_std[0] == pytest.approx(math.hypot(0.1 * held_s, before.theta_1_std[0]), rel=0.01)


@pytest.mark.parametrize("step_ns", STEPS_NS)
def test_a_board_without_hello_is_asked_on_when_the_host_clock_was_set(step_ns):
    rig = Rig(hello=False)
    rig.run(70)
    assert len(rig.requests) == 4
    rig.shift_ns = step_ns
    rig.run(60)
    assert len(rig.requests) >= 6


@pytest.mark.parametrize("step_ns", [-HOUR_NS, HOUR_NS])
def test_what_an_end_did_while_the_clock_was_set_is_not_held_against_it(step_ns):
    rig = Rig(speed=0.2)
    rig.until_valid()
    rig.shift_ns = step_ns
    rig.position += 2.0 * math.pi
    rig.mute = {0, 1}
    rig.run(2)
    rig.mute = set()
    rig.run(150)
    assert [wheel.faults for wheel in rig.reader.health().wheels] == [0] * 6


def test_old_encoder_samples_and_those_of_the_future_are_left_out_in_normal_times():
    rig = Rig()
    rig.run(5)
    now_ns = rig.now_ns
    for stamp_ns in (now_ns, now_ns - 1, now_ns - HOUR_NS, now_ns + 520_000_000, now_ns + HOUR_NS):
        rig.reader.feed_wheel_states(WheelStates(stamp_ns, np.full(6, 99.0), np.zeros(6), np.zeros(6)))
    assert rig.reader.health().wheel_states_rejected == 5
    assert rig.reader._encoder.latest()[0] == [rig.position] * 6


# --- reset and retune -----------------------------------------------------------------------------------------------


def _replayed(reader, inputs):
    """What a reader makes of recorded inputs: (now_ns, wheel states, frames of the tick)."""
    readings = []
    for now_ns, states, frames in inputs:
        for host_ns, payload, board_index in frames:
            reader.feed_bytes(board_index, encode_payload(payload), host_ns)
        reader.feed_wheel_states(states)
        readings.append(reader.tick(now_ns))
    return readings


def _plain(readings):
    """Readings as plain data that compares."""
    return [
        (
            reading.raw,
            reading.requests,
            reading.voltages
            and (reading.voltages.stamp_ns, reading.voltages.v_a.tolist(), reading.voltages.v_b.tolist()),
            reading.angles
            and [
                reading.angles.stamp_ns,
                *(
                    getattr(reading.angles, name).tolist()
                    for name in ("theta_1", "theta_2", "theta_1_std", "theta_2_std", "status")
                ),
            ],
        )
        for reading in readings
    ]


def _inputs(rig, ticks):
    inputs = []
    for _ in range(ticks):
        reading = rig.step()
        everyone = np.full(6, rig.position), np.full(6, rig.speed), np.zeros(6)
        inputs.append((rig.now_ns + 1_000_000, WheelStates(rig.now_ns, *everyone), reading.raw))
    return inputs


@pytest.fixture(scope="module")
def every_trouble():
    """Recorded inputs of 0.5 s in which all is well, and of 14 s in which everything else happens."""
    rig = Rig(speed=2.0, noise_lsb=0.4)
    inputs = _inputs(rig, 50)
    for channel, value, ticks in (
        (0, lambda _sums: 0, 60),
        (0, lambda _sums: 3900, 120),
        (0, lambda _sums: 900, 60),
        (0, lambda _sums: 2400, 200),
        (1, lambda sums: sums[0], 200),
    ):
        rig.damage = _pinned(channel, value)
        inputs += _inputs(rig, ticks)
        rig.damage = lambda _board, sums: sums
        inputs += _inputs(rig, 60)
    rig.damage = lambda board, sums: [4092, 4092, *sums[2:]] if board == 0 else sums
    inputs += _inputs(rig, 250)
    rig.damage = lambda _board, sums: sums
    rig.contact = False
    inputs += _inputs(rig, 20)
    rig.contact = True
    rig.mute = {1}
    inputs += _inputs(rig, 40)
    rig.mute = set()
    inputs += _inputs(rig, 60)
    rig.zone = (0.9, -0.35)  # a stone
    inputs += _inputs(rig, 60)
    rig.hello = False
    rig.boards[0].restart()
    rig.boot_us[0] = rig.now_ns // 1000
    return inputs + _inputs(rig, 80)


@pytest.fixture(scope="module")
def untouched(every_trouble):
    """What a reader with the default settings makes of it."""
    return _plain(_replayed(Rig().reader, every_trouble))


OTHER_SETTINGS = {
    "noise_lsb": 2.0,
    "resistance_std_ratio": 0.05,
    "angle_floor_std_rad": 0.1,
    "contact_level": 0.3,
    "seam_level": 0.9,
    "range_margin": 0.5,
    "order_margin_rad": 0.8,
    "width_max_rad": 0.5,
    "seam_rotation_max_rad": 1.0,
    "theta_max_rad": 0.5,
    "jump_rad": 1.0,
    "slide_rad": 0.2,
    "settle_rotation_rad": 1.0,
    "stuck_rotation_rad": 1.0,
    "stuck_band_v": 0.3,
    "fault_scans": 7,
    "recovery_scans": 40,
    "recovery_rotation_rad": 0.1,
    "predicted_std_per_rad": 1.0,
    "fault_std_per_s": 1.0,
    "silent_s": 0.3,
    "hello_period_s": 0.1,
}


SHOW_AT_ONCE = {"width_max_rad", "stuck_band_v", "stuck_rotation_rad", "theta_max_rad", "resistance_std_ratio"}


def test_every_tunable_setting_is_tried_below():
    tunable = {row.name for row in fields(StrapReaderSettings) if row.metadata.get("tunable", False)}
    assert tunable == set(OTHER_SETTINGS)


@pytest.mark.parametrize("name", OTHER_SETTINGS)
def test_a_retuned_reader_is_like_one_built_so(name, every_trouble, untouched):
    other = replace(SETTINGS, **{name: OTHER_SETTINGS[name]})
    changed, built = Rig().reader, Rig(settings=other).reader
    before = 0 if name in SHOW_AT_ONCE else 40  # ticks that find no fault with either settings
    _replayed(changed, every_trouble[:before])
    _replayed(built, every_trouble[:before])
    changed.retune(other)
    plain = _plain(_replayed(changed, every_trouble[before:]))
    assert plain == _plain(_replayed(built, every_trouble[before:]))
    assert plain != untouched[before:]
    assert changed.health().wheels == built.health().wheels


@pytest.mark.parametrize(
    ("name", "value"), [("osr", 2), ("total_resistance_ohm", 7e5), ("clock_window_s", 20.0), ("inverted", True)]
)
def test_what_is_not_tunable_needs_a_restart(name, value, every_trouble, untouched):
    reader = Rig().reader
    with pytest.raises(ValueError, match=f"{name}: cannot change while the driver runs; restart it"):
        reader.retune(replace(SETTINGS, noise_lsb=5.0, **{name: value}))
    assert _plain(_replayed(reader, every_trouble[:60])) == untouched[:60]


def test_levels_that_do_not_fit_the_strap_change_nothing(every_trouble):
    weak = Strap(SETTINGS.total_resistance_ohm, 2e5, 2e5, 5.0)
    reader, other = Rig(strap=weak).reader, Rig(strap=weak).reader
    with pytest.raises(ValueError, match="contact_level"):
        reader.retune(replace(SETTINGS, noise_lsb=5.0, contact_level=0.25))
    assert _plain(_replayed(reader, every_trouble[:60])) == _plain(_replayed(other, every_trouble[:60]))


@pytest.mark.parametrize("ticks", [50, 130, 250, 1010])
def test_a_reset_reader_is_like_a_new_one_and_keeps_its_counts(ticks, every_trouble):
    reader, fresh = Rig().reader, Rig().reader
    _replayed(reader, every_trouble[:ticks])
    before = reader.health()
    reader.reset()
    forgotten = reader.health()
    assert [board.hello for board in forgotten.boards] == [None, None]
    assert [board.frames for board in forgotten.boards] == [board.frames for board in before.boards]
    assert [board.scans for board in forgotten.boards] == [board.scans for board in before.boards]
    assert [(wheel.scans, wheel.faults) for wheel in forgotten.wheels] == [
        (wheel.scans, wheel.faults) for wheel in before.wheels
    ]
    assert {wheel.status for wheel in forgotten.wheels} == {ContactStatus.NO_DATA}
    after = _replayed(reader, every_trouble[ticks:])
    assert _plain(after) == _plain(_replayed(fresh, every_trouble[ticks:]))
    assert [request.board_index for request in after[0].requests] == [0, 1]
    assert [board.clock_resets for board in reader.health().boards] == [
        old.clock_resets + 1 + new.clock_resets for old, new in zip(before.boards, fresh.health().boards, strict=True)
    ]


def test_stamps_go_on_after_a_reset():
    rig = Rig()
    before = rig.until_valid()
    rig.reader.reset()
    for board in rig.boards:
        board.feed(b"?")
    after = [reading.angles for reading in rig.run(20) if reading.angles is not None]
    stamps = [before.stamp_ns, *(angles.stamp_ns for angles in after)]
    assert stamps == sorted(set(stamps))
    assert (after[-1].status < ContactStatus.FAULT_OPEN_A).all()


# --- settings and bindings ------------------------------------------------------------------------------------------


def test_default_settings_are_those_of_a_quarter_metre_wheel():
    assert SETTINGS.total_resistance_ohm == pytest.approx(785.398e3, rel=1e-6)
    assert SETTINGS.pull_down_a_ohm / SETTINGS.total_resistance_ohm == pytest.approx(0.577, abs=5e-4)
    assert SETTINGS.strap() == Strap(
        SETTINGS.total_resistance_ohm, SETTINGS.pull_down_a_ohm, SETTINGS.pull_down_b_ohm, 5.0
    )


def test_every_setting_is_documented_and_bounded():
    for name, row in StrapReaderSettings.__dataclass_fields__.items():
        assert len(row.metadata["doc"]) > 10, name
        if isinstance(row.default, bool):
            continue
        assert row.metadata["min"] <= row.default <= row.metadata["max"]
        for beyond in (row.metadata["min"] - 1, row.metadata["max"] + 1, math.nan):
            with pytest.raises(ValueError, match=name):
                replace(SETTINGS, **{name: beyond})


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"osr": 8}, "osr"),
        ({"baud": 9600, "rate_hz": 50.0}, "baud"),
        ({"rate_hz": 400.0}, "osr"),
        ({"contact_level": 0.4}, "contact_level"),
        ({"pull_down_a_ohm": 1e4}, "contact_level"),
    ],
)
def test_settings_that_do_not_fit_together_are_refused(changes, named):
    with pytest.raises(ValueError, match=named):
        replace(SETTINGS, **changes)


def test_bindings_must_cover_each_wheel_once():
    strap, mounting = SETTINGS.strap(), StrapMounting(0.0)
    good = StrapBinding(0, 1, 0, strap, mounting)
    for wheels, named in (
        ([], "0..W-1"),
        ([good, good], "share an input"),
        ([replace(good, wheel=1)], "0..W-1"),
        ([good, replace(good, wheel=1)], "share an input"),
    ):
        with pytest.raises(ValueError, match=named):
            StrapReader(wheels)
    with pytest.raises(ValueError, match="channel"):
        replace(good, channel=3)
    with pytest.raises(ValueError, match="board_id"):
        replace(good, board_id=256)
    assert StrapReader([good]).board_ids == (1,)
