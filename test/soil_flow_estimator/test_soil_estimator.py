import math
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from soil_flow_estimator.estimator_settings import SoilEstimatorSettings
from soil_flow_estimator.soil_estimator import DeformabilityTable, SoilEstimator
from soil_flow_estimator.soil_state import SoilState, SoilStatus
from strap_rover.rover import load_rover
from strap_rover.telemetry import Attitude, BodyMotion, Suspension, WheelStates
from strap_rover.terramechanics.contact import Wheel, deformability_from_zone, static_contact_zone
from strap_rover.terramechanics.soil import soil_from_de_st
from strap_rover.terramechanics.spiral_flow import critical_flow_ratio
from strap_rover.topics import SOIL_STATE
from strap_sensor_driver.contact_zone import ContactAngles, ContactStatus, travel_angles

ROVER = load_rover("curiosity")
WHEEL = Wheel(0.25, 0.40)
LOAD = ROVER.vertical_load_n / 6.0
ONES = np.ones(6)
MS = 1_000_000
DAY_NS = 86_400_000 * MS


class Bench:
    """Feeds an estimator given numbers every 10 ms."""

    def __init__(self, rover=ROVER, **settings):
        self.estimator = SoilEstimator(rover, SoilEstimatorSettings(**settings))
        self.now_ns = 1_000_000_000_000
        self.angle = np.zeros(6)
        self.omega = np.zeros(6)
        self.speed = 0.0
        self.speed_std = 0.005
        self.torque = 0.0
        self.theta_1 = 0.4 * ONES
        self.theta_2 = -0.4 * ONES
        self.angle_std = 0.0075
        self.status = np.zeros(6, dtype=np.int64)
        self.pitch_deg = None
        self.silent = set()
        self.lead_ns = {}

    def stand_on(self, de, load=LOAD):
        half = 0.5 * np.asarray(static_contact_zone(WHEEL, soil_from_de_st(de, 0.5), load))
        self.theta_1, self.theta_2, self.omega, self.speed = half * ONES, -half * ONES, np.zeros(6), 0.0

    def roll(self, omega=0.8, speed=0.18, theta_1=0.5, theta_2=-0.1):
        self.omega, self.speed = omega * ONES, speed
        self.theta_1, self.theta_2 = theta_1 * ONES, theta_2 * ONES

    def tick(self):
        self.now_ns += 10 * MS
        self.angle = self.angle + 0.01 * self.omega
        e = self.estimator
        std = self.angle_std * ONES
        if self.pitch_deg is not None:
            e.feed_attitude(replace(pitched(self.pitch_deg), stamp_ns=self.stamp("attitude")))
        if "wheels" not in self.silent:
            e.feed_wheel_states(WheelStates(self.stamp("wheels"), self.angle, self.omega, self.torque * ONES))
        if "odometry" not in self.silent:
            e.feed_body_motion(BodyMotion(self.stamp("odometry"), 0.0, 0.0, 0.0, self.speed, self.speed_std))
        if "angles" not in self.silent:
            stamp_ns = self.stamp("angles")
            e.feed_contact_angles(ContactAngles(stamp_ns, self.theta_1, self.theta_2, std, std, self.status))
        return e.tick(self.now_ns)

    def stamp(self, name):
        return self.now_ns + self.lead_ns.get(name, 0)

    def run(self, seconds):
        state = None
        for _ in range(round(seconds * 100)):
            state = self.tick()
        return state


def pitched(degrees):
    half = 0.5 * math.radians(degrees)
    return Attitude(0, (0.0, -math.sin(half), 0.0, math.cos(half)), 0.0)


def test_record_has_the_fields_of_the_topic_in_order():
    names = [name for name in SoilState.__slots__ if name != "stamp_ns"]
    assert names == [quantity.name for quantity in (*SOIL_STATE.per_wheel, *SOIL_STATE.whole_rover)]


# The table against the law it was made from, at points that are no nodes.
@pytest.mark.parametrize("ratio", [0.47, 0.73, 0.97, 1.0, 1.08, 1.37])
def test_table_is_the_law(ratio):
    table = DeformabilityTable((WHEEL,), (LOAD,))
    zone = np.linspace(0.05, 3.1, 1999)
    law = np.asarray(deformability_from_zone(WHEEL, LOAD * ratio, zone))
    read = table(zone[:, None], np.full((1,), math.log(ratio)))[:, 0]
    inside = law < 0.95
    assert np.abs(read - law)[inside].max() < 3e-4
    assert np.abs(read - law).max() < 2e-3


def test_table_keeps_to_its_edges_outside():
    table = DeformabilityTable((WHEEL, Wheel(0.2, 0.2)), (LOAD, 70.0))
    read = table(np.array([[-1.0, 0.0], [4.0, 9.0]]), np.array([[-9.0, 0.0], [-9.0, 0.0]]))
    assert np.isfinite(read).all()
    assert (read[0] < 1e-4).all()
    assert (read[1] > 0.98).all()
    heaviest = table(np.array([1.0, 1.0]), np.array([9.0, 9.0]))
    assert heaviest == pytest.approx(table(np.array([1.0, 1.0]), np.log([1.4, 1.4])), abs=1e-5)


# The law forwards: soil -> zone of the standing wheel; the estimator has to find the soil again.
@pytest.mark.parametrize("de", [0.02, 0.1, 0.3, 0.6, 0.9])
@pytest.mark.parametrize("st", [0.0, 1.0])
def test_standing_wheel_finds_its_soil_whatever_the_stickiness(de, st):
    bench = Bench()
    half = 0.5 * float(static_contact_zone(WHEEL, soil_from_de_st(de, st), LOAD))
    bench.theta_1, bench.theta_2 = half * ONES, -half * ONES
    state = bench.run(0.5)
    assert state.de == pytest.approx(de * ONES, abs=3e-4)
    assert state.status.tolist() == [SoilStatus.STATIC_ESTIMATE] * 6
    assert (state.st == 0.5).all()
    assert state.st_std == pytest.approx(0.2887 * ONES, abs=1e-3)


@pytest.mark.parametrize("pitch_deg", [-20.0, 12.0])
def test_slope_takes_load_off_the_wheels(pitch_deg):
    bench = Bench()
    bench.stand_on(0.3, LOAD * math.cos(math.radians(pitch_deg)))
    level = bench.run(0.5).de[0]
    bench.estimator.feed_attitude(pitched(pitch_deg))
    assert bench.run(0.5).de == pytest.approx(0.3 * ONES, abs=3e-4)
    assert level < 0.299


def test_load_share_of_each_wheel_counts():
    shares = (0.1, 0.2, 0.2, 0.1, 0.2, 0.2)
    wheels = tuple(replace(w, load_share=share) for w, share in zip(ROVER.wheels, shares, strict=True))
    bench = Bench(rover=replace(ROVER, wheels=wheels))
    half = [0.5 * float(static_contact_zone(WHEEL, soil_from_de_st(0.3, 0.5), LOAD * 6 * share)) for share in shares]
    bench.theta_1, bench.theta_2 = np.array(half), -np.array(half)
    assert bench.run(0.5).de == pytest.approx(0.3 * ONES, abs=3e-4)


def test_wheel_without_load_is_refused():
    wheels = tuple(replace(w, load_share=x) for w, x in zip(ROVER.wheels, (0.0, 0.2, 0.2, 0.2, 0.2, 0.2), strict=True))
    with pytest.raises(ValueError, match="fl"):
        SoilEstimator(replace(ROVER, wheels=wheels), SoilEstimatorSettings())


def test_linear_rule_of_the_paper_reads_what_it_is_known_to_read():
    for de, known in ((0.1, 0.268), (0.3, 0.490), (0.6, 0.891)):
        bench = Bench(deformability_rule="paper_linear")
        bench.stand_on(de)
        assert bench.run(0.5).de == pytest.approx(known * ONES, abs=1e-3)


@pytest.mark.parametrize("de", [0.1, 0.3, 0.6])
def test_static_std_covers_the_errors_it_claims_to_cover(de):
    rng = np.random.default_rng(7)
    scores = []
    for _ in range(40):
        bench = Bench()
        load = LOAD * (1.0 + 0.1 * rng.standard_normal(6))
        half = 0.5 * np.asarray(static_contact_zone(WHEEL, soil_from_de_st(de, 0.5), np.maximum(load, 0.5 * LOAD)))
        bias_1, bias_2 = 0.006 * rng.standard_normal((2, 6))
        for _ in range(30):
            bench.theta_1 = half + bias_1 + 0.0075 * rng.standard_normal(6)
            bench.theta_2 = -half + bias_2 + 0.0075 * rng.standard_normal(6)
            state = bench.tick()
        scores.extend((state.de - de) / state.de_std)
    # 240 scores: the mean square of a good std is 1 +- 0.09.
    assert 0.7 < np.mean(np.square(scores)) < 1.4


def test_averaging_helps_down_to_what_it_cannot_average():
    stds = []
    for seconds in (0.05, 0.5, 5.0):
        bench = Bench(load_std_ratio=0.0, angle_bias_std_rad=0.002)
        bench.angle_std = 0.02
        bench.stand_on(0.3)
        stds.append(bench.run(seconds).de_std[0])
    assert stds[0] > 2.0 * stds[1] > 2.0 * stds[2]
    exact = Bench(load_std_ratio=0.0)
    exact.angle_std = 0.0
    exact.stand_on(0.3)
    assert exact.run(0.5).de_std[0] == pytest.approx(0.004 * math.sqrt(2.0) * 0.006 / math.radians(0.5), rel=0.5)


def test_by_the_linear_rule_rolling_holds_de_and_its_std_grows_to_the_prior():
    bench = Bench(deformability_rule="paper_linear")
    bench.stand_on(0.3)
    before = bench.run(0.5)
    bench.roll()
    after = bench.run(2.0)
    assert after.de.tolist() == before.de.tolist()
    assert after.status.tolist() == [SoilStatus.HELD] * 6
    rim = 0.25 * 0.8 * 2.0
    assert after.de_std**2 - before.de_std**2 == pytest.approx(0.16**2 * rim * ONES, rel=0.01)
    assert bench.run(60.0).de_std == pytest.approx(0.2887 * ONES, abs=1e-3)


def test_standing_again_estimates_again():
    bench = Bench()
    bench.stand_on(0.3)
    bench.run(0.5)
    bench.roll()
    bench.run(3.0)
    bench.stand_on(0.6)
    state = bench.run(0.5)
    assert state.de == pytest.approx(0.6 * ONES, abs=3e-4)
    assert state.status.tolist() == [SoilStatus.STATIC_ESTIMATE] * 6


@pytest.mark.parametrize(
    "spoil",
    [
        {"omega": 0.05 * ONES},
        {"speed": 0.1},
        {"status": np.full(6, int(ContactStatus.PREDICTED))},
        {"theta_2": -0.1 * ONES},
    ],
    ids=["turning", "sliding", "predicted", "asymmetric"],
)
def test_no_static_estimate_from_a_contact_that_is_not_static(spoil):
    bench = Bench()
    for name, value in spoil.items():
        setattr(bench, name, value)
    state = bench.run(1.0)
    assert state.status.tolist() == [SoilStatus.PRIOR] * 6
    assert (state.de == 0.5).all()
    assert bench.estimator.health().static_readings == 0


def test_creeping_counts_as_standing():
    bench = Bench()
    bench.stand_on(0.3)
    bench.omega, bench.speed = 0.01 * ONES, 0.0025
    assert bench.run(2.0).de == pytest.approx(0.3 * ONES, abs=3e-4)


def test_each_wheel_is_judged_alone():
    bench = Bench()
    bench.stand_on(0.3)
    bench.status = np.array([0, 1, 0, int(ContactStatus.FAULT_SHORT), int(ContactStatus.NO_CONTACT), 0])
    state = bench.run(0.5)
    expected = [SoilStatus.STATIC_ESTIMATE] * 6
    expected[1], expected[3], expected[4] = SoilStatus.PRIOR, SoilStatus.NO_DATA, SoilStatus.NO_DATA
    assert state.status.tolist() == expected
    assert state.vc[3] == 1.0
    assert state.slip_max[3] == 0.45
    assert state.m_ent[3] == state.m_out[3] == 0.0


def test_zone_beyond_the_family_says_so():
    bench = Bench()
    bench.theta_1, bench.theta_2 = 1.569 * ONES, -1.569 * ONES
    state = bench.run(0.5)
    assert state.status.tolist() == [SoilStatus.STATIC_AT_BOUND] * 6
    assert state.de_std == pytest.approx(0.2887 * ONES, abs=1e-3)
    rock = Bench()
    rock.theta_1, rock.theta_2 = 0.05 * ONES, -0.05 * ONES
    state = rock.run(0.5)
    assert state.status.tolist() == [SoilStatus.STATIC_AT_BOUND] * 6
    assert (state.de < 1e-3).all()


@pytest.mark.parametrize(
    ("speed", "omega"),
    [(0.18, 0.8), (0.05, 0.25), (0.4, 1.0), (-0.18, -0.8), (-0.4, -1.0), (0.02, 1.5)],
)
def test_slip_std_is_that_of_a_sample(speed, omega):
    rng = np.random.default_rng(3)
    speeds = speed + 0.005 * rng.standard_normal(20000)
    rims = 0.25 * (omega + 0.005 * rng.standard_normal(20000))
    driving = np.abs(rims) >= np.abs(speeds)
    sample = np.where(driving, 1.0 - speeds / rims, rims / speeds - 1.0)
    bench = Bench()
    bench.roll(omega, speed)
    state = bench.run(0.1)
    assert state.slip[0] == pytest.approx(sample.mean(), abs=0.01)
    assert state.slip_std[0] == pytest.approx(sample.std(), rel=0.05)


def test_slip_at_rest_is_zero_and_unknown():
    state = Bench().run(0.1)
    assert (state.slip == 0.0).all()
    assert (state.slip_std == 1.0).all()
    assert (state.slip_max == 0.45).all()  # a symmetric contact has no s_max


def test_soil_flow_of_a_known_soil():
    bench = Bench()
    bench.stand_on(0.3)
    bench.run(0.5)
    bench.roll(omega=0.2 / (0.25 * 0.8), speed=0.2, theta_1=math.radians(30.0), theta_2=math.radians(-5.0))
    state = bench.run(0.1)
    assert state.slip == pytest.approx(0.2 * ONES)
    assert state.vc == pytest.approx(1.354084 * ONES, abs=1e-6)
    assert state.m_ent == pytest.approx(0.067219 * ONES, rel=2e-3)  # de is read to 3e-4
    assert state.m_out == pytest.approx(0.049642 * ONES, rel=2e-3)
    assert state.slip_max == pytest.approx(0.263760 * ONES, abs=1e-6)
    denser = Bench(soil_density_kgpm3=3200.0)
    denser.roll(omega=1.0, speed=0.2)
    lighter = Bench()
    lighter.roll(omega=1.0, speed=0.2)
    assert denser.run(0.1).m_ent == pytest.approx(2.0 * lighter.run(0.1).m_ent)


@pytest.mark.parametrize("slip", [-0.3, 0.0, 0.02, 0.1])
def test_low_slip_raises_no_alarm_on_a_shallow_contact(slip):
    theta = math.radians(15.0), math.radians(-3.0)
    assert float(critical_flow_ratio(0.0, *theta)) < 1.0  # the false root this guards against
    bench = Bench()
    rim = 0.2 / (1.0 - slip) if slip >= 0.0 else 0.2 * (1.0 + slip)
    bench.roll(rim / 0.25, 0.2, *theta)
    assert (bench.run(0.1).vc > 1.0).all()
    bench.roll(0.2 / 0.25 / (1.0 - 0.25), 0.2, *theta)
    assert (bench.run(0.1).vc < 1.0).all()


def test_backwards_is_forwards_mirrored():
    forwards, backwards, swapped = Bench(), Bench(), Bench()
    forwards.roll(0.8, 0.18, 0.5, -0.1)
    backwards.roll(-0.8, -0.18, 0.1, -0.5)
    swapped.roll(-0.8, -0.18, -0.5, 0.1)
    for name in ("slip", "slip_std", "vc", "m_ent", "m_out", "slip_max"):
        states = [bench.run(0.1) for bench in (forwards, backwards, swapped)]
        assert getattr(states[1], name) == pytest.approx(getattr(states[0], name))
        assert getattr(states[2], name) == pytest.approx(getattr(states[0], name))
    entry, leave = travel_angles(np.array([0.1]), np.array([-0.5]), -1.0)
    assert (entry[0], leave[0]) == (0.5, -0.1)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_odometry_noise_of_a_standing_rover_does_not_turn_it_round(sign):
    bench = Bench()
    theta = sorted((sign * 0.5, sign * -0.1), reverse=True)
    bench.roll(sign * 0.8, sign * 0.18, *theta)
    bench.run(0.1)
    bench.roll(0.0, 0.0, *theta)
    before = bench.run(0.1)
    for share in (-2.9, 2.9, -1.0, 1.0):
        bench.speed = share * bench.speed_std
        state = bench.tick()
        assert state.slip_max.tolist() == before.slip_max.tolist()
        assert state.vc.tolist() == before.vc.tolist()
    bench.speed = -sign * 0.02  # beyond 1 mm/s and three 1-sigma
    assert bench.tick().slip_max.tolist() != before.slip_max.tolist()


@pytest.mark.parametrize("missing", ["angles", "wheels", "odometry"])
def test_nothing_is_said_without_every_input_or_with_an_old_one(missing):
    bench = Bench()
    bench.silent = {missing}
    assert bench.run(0.5) is None
    bench.silent = set()
    assert bench.tick() is not None
    bench.silent = {missing}
    assert bench.run(0.2) is not None
    assert bench.tick() is None
    assert bench.estimator.health().late_ticks == 1


@pytest.mark.parametrize("dead", ["wheels", "odometry"])
def test_nobody_knows_whether_a_wheel_stands_whose_encoder_or_odometry_is_old(dead):
    bench = Bench()
    bench.stand_on(0.3)
    bench.run(0.5)
    bench.silent = {dead}
    bench.stand_on(0.6)
    bench.run(0.2)
    readings = bench.estimator.health().static_readings
    bench.run(1.0)
    assert bench.estimator.health().static_readings == readings


ANGLES = "contact angles are {}: is strap_sensor_driver running?"
WHEELS = "wheel_states are {}: does the rover or sim_bridge send them?"
ODOMETRY = "odom is {}: does the rover or sim_bridge send it?"
IMU = "imu is {}: does the rover or sim_bridge send it? {}"


@pytest.mark.parametrize(
    ("silent", "pitch_deg", "seconds", "told"),
    [
        (set(), 0.0, 1.0, []),
        ({"angles"}, 0.0, 0.35, [ANGLES.format("0.35 s old")]),
        ({"wheels"}, 0.0, 0.35, [WHEELS.format("0.35 s old")]),
        ({"odometry"}, 0.0, 60.0, [ODOMETRY.format("60.00 s old")]),
        ({"wheels", "odometry"}, 0.0, 0.35, [WHEELS.format("0.35 s old"), ODOMETRY.format("0.35 s old")]),
        (set(), None, 0.35, [IMU.format("0.35 s old", "its last pitch stands in")]),
    ],
)
def test_what_is_late_is_told_with_its_age_and_remedy(silent, pitch_deg, seconds, told):
    bench = Bench()
    bench.pitch_deg = 0.0
    bench.run(0.1)
    bench.silent, bench.pitch_deg = silent, pitch_deg
    bench.run(seconds)
    health = bench.estimator.health()
    assert list(health.complaints) == told
    assert health.is_answering is (not silent)


def test_what_never_came_is_missing():
    bench = Bench()
    assert bench.estimator.health().complaints == ()
    bench.silent = {"angles", "wheels", "odometry"}
    bench.tick()
    health = bench.estimator.health()
    assert health.complaints == (
        ANGLES.format("missing"),
        WHEELS.format("missing"),
        ODOMETRY.format("missing"),
        IMU.format("missing", "the ground counts as level"),
    )
    assert (health.is_answering, health.answered_ticks) == (False, 0)
    bench.silent = set()
    bench.tick()
    health = bench.estimator.health()
    assert health.complaints == (IMU.format("missing", "the ground counts as level"),)
    assert (health.is_answering, health.answered_ticks) == (True, 1)


def test_a_reset_forgets_records_and_soil_and_keeps_the_counters():
    bench = Bench()
    bench.pitch_deg = 20.0
    bench.stand_on(0.3)
    bench.run(0.5)
    bench.roll(-0.8, -0.18, 0.1, -0.5)
    bench.run(0.1)
    bench.estimator.feed_body_motion(BodyMotion(0, 0.0, 0.0, 0.0, 0.0, 0.005))
    before = bench.estimator.health()
    bench.estimator.reset()
    health = bench.estimator.health()
    assert (health.wheels_estimated, health.is_answering) == (0, False)
    for name in ("answered_ticks", "rejected_records", "late_ticks", "static_readings"):
        assert getattr(health, name) == getattr(before, name) > 0 or name == "late_ticks"
    assert bench.estimator.tick(bench.now_ns) is None
    bench.pitch_deg = None
    state, fresh = bench.run(0.1), Bench()
    fresh.angle = bench.angle - 0.1 * bench.omega
    fresh.roll(-0.8, -0.18, 0.1, -0.5)
    assert same_soil(state, fresh.run(0.1))


def same_soil(one, other):
    if one is None or other is None:
        return one is other
    names = [name for name in SoilState.__slots__ if name != "stamp_ns"]
    return all(np.asarray(getattr(one, name)).tobytes() == np.asarray(getattr(other, name)).tobytes() for name in names)


ROWS = [
    ("standing_speed_radps", 0.0),
    ("standing_travel_m", 0.05),
    ("readings_min", 20),
    ("asymmetry_max", 0.05),
    ("angle_bias_std_rad", 0.05),
    ("load_std_ratio", 0.3),
    ("wheel_speed_std_radps", 0.1),
    ("de_drift_per_sqrt_m", 0.5),
    ("st_drift_per_sqrt_m", 1.0),
    ("uses_torque", False),
    ("torque_std_nm", 20.0),
    ("slip_relaxation_m", 0.5),
    ("caution_z", -10.0),
    ("stop_z", -10.0),
    ("slip_alarm", 0.05),
    ("soil_density_kgpm3", 2000.0),
    ("input_timeout_s", 0.02),
]
TUNABLE = [item.name for item in fields(SoilEstimatorSettings) if item.metadata.get("tunable")]


def story(bench):
    """Everything that can happen to an estimate, in 4 s; what was said on every tick."""

    def part(seconds):
        said.extend(bench.tick() for _ in range(round(seconds * 100)))

    said = []
    bench.pitch_deg = 2.0
    bench.stand_on(0.3)
    part(0.1)
    bench.theta_1, bench.theta_2 = 0.45 * ONES, -0.35 * ONES  # not quite symmetric
    bench.omega = 0.015 * ONES  # creeping
    part(0.4)
    bench.roll()
    bench.torque = 34.0
    part(2.5)
    bench.silent = {"odometry"}
    part(0.1)
    bench.silent = set()
    bench.stand_on(0.6)
    bench.omega = 0.02 * ONES
    part(1.0)
    return said


def same_story(one, other):
    return all(same_soil(a, b) for a, b in zip(one, other, strict=True))


def test_every_tunable_setting_has_a_row_and_nothing_else_is_tunable():
    assert [name for name, _ in ROWS] == TUNABLE
    assert {item.name for item in fields(SoilEstimatorSettings)} - set(TUNABLE) == {
        "deformability_rule",
        "excavation_depth_m",
    }


@pytest.mark.parametrize(("name", "value"), ROWS)
def test_a_tuned_estimator_says_what_one_built_so_says(name, value):
    old, built, tuned = Bench(), Bench(**{name: value}), Bench()
    tuned.estimator.retune(SoilEstimatorSettings(**{name: value}))
    told = story(built)
    assert same_story(story(tuned), told)
    assert not same_story(story(old), told)


@st.composite
def tunings(draw):
    ranges = {
        "standing_speed_radps": st.floats(0.0, 0.1),
        "standing_travel_m": st.floats(0.001, 0.1),
        "readings_min": st.integers(1, 20),
        "asymmetry_max": st.floats(0.0, 1.0),
        "angle_bias_std_rad": st.floats(0.0, 0.1),
        "load_std_ratio": st.floats(0.0, 0.3),
        "wheel_speed_std_radps": st.floats(0.0, 0.1),
        "de_drift_per_sqrt_m": st.floats(0.0, 1.0),
        "st_drift_per_sqrt_m": st.floats(0.0, 1.0),
        "uses_torque": st.booleans(),
        "torque_std_nm": st.floats(0.1, 20.0),
        "slip_relaxation_m": st.floats(0.01, 1.0),
        "caution_z": st.floats(-10.0, 10.0),
        "stop_z": st.floats(-10.0, 10.0),
        "slip_alarm": st.floats(0.05, 1.0),
        "soil_density_kgpm3": st.floats(500.0, 3000.0),
        "input_timeout_s": st.floats(0.01, 0.5),
    }
    assert list(ranges) == TUNABLE
    return draw(st.fixed_dictionaries(ranges))


PARTS = st.lists(
    st.fixed_dictionaries(
        {
            "ticks": st.integers(1, 30),
            "omega": st.sampled_from([0.0, 0.01, 0.05, 0.8, -0.8]),
            "speed": st.sampled_from([0.0, 0.002, 0.18, -0.18]),
            "theta_1": st.sampled_from([0.1, 0.4, 0.9]),
            "theta_2": st.sampled_from([-0.1, -0.35, -0.4]),
            "status": st.sampled_from([0, 0, 1, 2, 10, 21]),
            "silent": st.sets(st.sampled_from(["angles", "odometry", "wheels"]), max_size=1),
        }
    ),
    min_size=1,
    max_size=8,
)


def played(bench, parts):
    """What an estimator says while it is told this."""
    said = []
    for part in parts:
        bench.omega, bench.speed, bench.silent = part["omega"] * ONES, part["speed"], part["silent"]
        bench.theta_1, bench.theta_2 = part["theta_1"] * ONES, part["theta_2"] * ONES
        bench.status = np.array([part["status"], 0, 0, 0, 0, 0])
        said += [bench.tick() for _ in range(part["ticks"])]
    return said


@settings(max_examples=60, deadline=None)
@given(tunings(), tunings(), PARTS, PARTS)
def test_an_estimator_tuned_and_reset_on_the_way_goes_on_as_a_new_one_built_so(first, second, before, after):
    tuned, built = Bench(**first), Bench(**second)
    played(tuned, before)
    tuned.estimator.retune(SoilEstimatorSettings(**second))
    tuned.estimator.reset()
    built.angle, built.now_ns = tuned.angle, tuned.now_ns
    assert same_story(played(tuned, after), played(built, after))


@settings(max_examples=30, deadline=None)
@given(tunings(), tunings(), PARTS, PARTS)
def test_tuning_there_and_back_between_two_ticks_is_as_nothing(tuning, other, before, after):
    there, same_as_ever = Bench(**tuning), Bench(**tuning)
    played(there, before)
    played(same_as_ever, before)
    there.estimator.retune(SoilEstimatorSettings(**other))
    there.estimator.retune(SoilEstimatorSettings(**tuning))
    assert same_story(played(there, after), played(same_as_ever, after))


def test_a_running_estimator_keeps_its_rule():
    with pytest.raises(ValueError, match="deformability_rule 'paper_linear': a running estimator keeps 'inverse'"):
        Bench().estimator.retune(SoilEstimatorSettings(deformability_rule="paper_linear"))


@pytest.mark.parametrize("early", ["angles", "wheels", "odometry"])
@pytest.mark.parametrize("ticks_before", [0, 5])
def test_one_stamp_of_tomorrow_does_not_switch_the_time_out_off(early, ticks_before):
    bench = Bench()
    for _ in range(ticks_before):
        bench.tick()
    bench.lead_ns = {early: DAY_NS}
    bench.tick()
    bench.lead_ns = {}
    bench.silent = {early}
    for _ in range(40):
        state = bench.tick()
    assert state is None
    bench.silent = set()
    assert bench.tick() is not None
    assert bench.estimator.health().rejected_records == (1 if ticks_before else 0)


def test_stamps_ahead_by_less_than_the_time_out_are_as_good_as_any():
    bench = Bench()
    bench.lead_ns = dict.fromkeys(("angles", "wheels", "odometry"), 150 * MS)
    for _ in range(20):
        assert bench.tick() is not None
    assert bench.estimator.health().rejected_records == 0


@pytest.mark.parametrize("back_ns", [300 * MS, DAY_NS])
def test_a_clock_that_is_set_back_is_followed(back_ns):
    bench = Bench()
    bench.run(0.5)
    bench.now_ns -= back_ns
    assert bench.tick() is None
    assert bench.tick() is not None
    assert bench.estimator.health().rejected_records == 3  # of the moment before anybody knew


@settings(max_examples=60, deadline=None)
@given(
    st.lists(
        st.tuples(
            st.one_of(
                st.integers(-3_600_000, 3_600_000), st.integers(-500, 500), st.sampled_from([-3_600_000, 3_600_000])
            ),
            st.integers(0, 30),
        ),
        min_size=1,
        max_size=4,
    ),
    st.sampled_from(["angles", "wheels", "odometry"]),
)
def test_a_clock_that_is_set_is_over_in_a_moment_and_hides_nothing(steps, silent):
    bench = Bench()
    bench.pitch_deg = 5.0
    bench.run(0.1)
    for step_ms, ticks in steps:
        bench.now_ns += step_ms * MS
        for _ in range(ticks):
            bench.tick()
    bench.run(0.25)  # the time-out, within which a step may go unnoticed and order is kept
    assert bench.tick() is not None
    assert bench.estimator.health().complaints == ()
    bench.now_ns += steps[0][0] * MS  # and now something falls silent in the moment in which the clock is set
    bench.silent = {silent}
    assert bench.run(0.42) is None


@pytest.mark.parametrize("dead", ["angles", "wheels", "odometry"])
def test_what_died_when_the_clock_was_set_back_is_not_alive_when_it_comes_by_again(dead):
    bench = Bench()
    bench.run(0.5)
    died_ns = bench.now_ns
    bench.silent = {dead}
    bench.now_ns -= 3_600_000 * MS
    assert bench.run(0.5) is None
    bench.now_ns = died_ns - 20 * MS
    for _ in range(5):
        assert bench.tick() is None


def test_every_number_is_finite_for_any_contact():
    rng = np.random.default_rng(11)
    bench = Bench(readings_min=1)
    for _ in range(500):
        bench.theta_1, bench.theta_2 = rng.uniform(-3.2, 3.2, (2, 6))
        bench.omega = rng.choice([0.0, 1.0, -1.0], 6) * rng.uniform(0.0, 2.0, 6)
        bench.speed = float(rng.choice([0.0, 0.5]) * rng.standard_normal())
        bench.status = rng.choice([0, 1, 2, 10], 6)
        state = bench.tick()
        for name in SoilState.__slots__:
            assert np.isfinite(getattr(state, name)).all(), name
        assert ((state.de >= 0.0) & (state.de <= 1.0)).all()


def test_bad_records_are_counted_and_not_used():
    bench = Bench()
    bench.run(0.5)
    e, now = bench.estimator, bench.now_ns
    nan, codes = np.full(6, np.nan), np.zeros(6, dtype=np.int64)
    e.feed_contact_angles(ContactAngles(now, nan, -ONES, ONES, ONES, codes))
    e.feed_contact_angles(ContactAngles(now - 1, ONES, -ONES, ONES, ONES, codes))
    e.feed_wheel_states(WheelStates(now, np.zeros(5), np.zeros(5), np.zeros(5)))
    e.feed_body_motion(BodyMotion(now, 0.0, 0.0, 0.0, 0.1, math.inf))
    e.feed_attitude(Attitude(now, (0.0, math.nan, 0.0, 1.0), 0.0))
    e.feed_suspension(Suspension(now, np.array([math.nan])))
    assert e.health().rejected_records == 6
    assert np.isfinite(bench.tick().de).all()


def test_settings_name_what_is_wrong():
    with pytest.raises(ValueError, match="deformability_rule"):
        SoilEstimatorSettings(deformability_rule="guess")
    with pytest.raises(ValueError, match="load_std_ratio"):
        SoilEstimatorSettings(load_std_ratio=-0.1)
