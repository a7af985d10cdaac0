"""What is late or faulty, and what an operator reads of it."""

import numpy as np
import pytest

from soil_flow_estimator.soil_state import SoilState
from strap_rover.rover import load_rover
from strap_rover.telemetry import BodyMotion, SpeedRequest, WheelStates
from strap_sensor_driver.contact_zone import ContactAngles, ContactStatus
from traction_controller.input_watch import InputWatch
from traction_controller.supervisor import Fault
from traction_controller.traction_settings import TractionSettings

ROVER = load_rover("curiosity")
ONES = np.ones(6)
MS = 1_000_000
NOW = 1_000_000 * MS


def codes(**by_wheel):
    return np.array([int(by_wheel.get(name, 0)) for name in ROVER.wheel_names])


def watch(ages_ms=None, status=None, **settings):
    """A watch that was told everything 1 ms ago, but for what `ages_ms` says; None: never."""
    told = {"angles": 1, "odometry": 1, "wheels": 1, "request": 1, "soil": 1} | (ages_ms or {})
    inputs = InputWatch(ROVER, TractionSettings(**settings))
    stamps = {name: NOW - age * MS for name, age in told.items() if age is not None}
    status = codes() if status is None else status
    if "angles" in stamps:
        inputs.take_contact_angles(ContactAngles(stamps["angles"], 0.5 * ONES, -0.1 * ONES, ONES, ONES, status))
    if "odometry" in stamps:
        inputs.take_body_motion(BodyMotion(stamps["odometry"], 0.0, 0.0, 0.0, 0.2, 0.005))
    if "wheels" in stamps:
        inputs.take_wheel_states(WheelStates(stamps["wheels"], ONES, ONES, ONES))
    if "request" in stamps:
        inputs.take_request(SpeedRequest(stamps["request"], 0.5))
    if "soil" in stamps:
        inputs.take_soil_state(SoilState(stamps["soil"], *np.full((10, 6), 0.3), np.full(6, 2)))
    return inputs


SENSOR, ODOMETRY, WHEELS = Fault.SENSOR_LATE, Fault.ODOMETRY_LATE, Fault.WHEEL_STATES_LATE
COMMAND, SOIL = Fault.COMMAND_LATE, Fault.SOIL_STATE_LATE


@pytest.mark.parametrize(
    ("ages_ms", "faults"),
    [
        ({}, ()),
        ({"angles": 100, "odometry": 200, "wheels": 100, "request": 500, "soil": 200}, ()),
        ({"angles": 101}, (SENSOR,)),
        ({"odometry": 201}, (ODOMETRY,)),
        ({"wheels": 101}, (WHEELS,)),
        ({"request": 501}, (COMMAND,)),
        ({"soil": 201}, (SOIL,)),
        ({"angles": None}, (SENSOR,)),
        ({"odometry": None}, (ODOMETRY,)),
        ({"wheels": None}, (WHEELS,)),
        ({"request": None}, ()),
        ({"soil": None}, ()),
        ({"angles": -101}, (SENSOR,)),
        ({"soil": -201}, (SOIL,)),
        (
            {"angles": 999, "odometry": 999, "wheels": 999, "request": 999, "soil": 999},
            (SENSOR, ODOMETRY, WHEELS, COMMAND, SOIL),
        ),
    ],
)
def test_every_fault_present_is_found_the_lowest_code_first(ages_ms, faults):
    inputs = watch(ages_ms)
    assert inputs.judge(NOW) == faults
    assert list(faults) == sorted(faults)


@pytest.mark.parametrize("policy", ["constant", "slip_limit", "angle_threshold"])
def test_only_the_soil_flow_policy_misses_the_soil_state(policy):
    inputs = watch({"soil": 999}, policy=policy)
    assert inputs.judge(NOW) == ()
    assert inputs.complaints() == []


NO_DATA, OPEN_A = ContactStatus.NO_DATA, ContactStatus.FAULT_OPEN_A
LEAD_A = "end A reads 0 V in contact: check the lead and slip ring of end A, and its pull-down"
USB = "the board is silent or has not said hello: check USB cable"


@pytest.mark.parametrize(
    ("ages_ms", "status", "settings", "told"),
    [
        ({}, {}, {}, []),
        ({"angles": None}, {}, {}, ["contact angles are missing: is strap_sensor_driver running?"]),
        ({"angles": 350}, {}, {}, ["contact angles are 0.35 s old: is strap_sensor_driver running?"]),
        ({"odometry": 350}, {}, {}, ["odom is 0.35 s old: does the rover or sim_bridge send it?"]),
        ({"wheels": 350}, {}, {}, ["wheel_states are 0.35 s old: does the rover or sim_bridge send them?"]),
        ({"request": 700}, {}, {}, ["cmd_vel is 0.70 s old: does the operator or planner still send it?"]),
        ({"soil": 700}, {}, {}, ["soil_state is 0.70 s old: is soil_flow_estimator running? ~/reset lets"]),
        ({"soil": None}, {}, {}, ["no soil_state: driving on the slip cap alone"]),
        ({"soil": None}, {}, {"policy": "constant"}, []),
        ({"odometry": 350, "wheels": None}, {}, {}, ["odom is 0.35 s old", "wheel_states are missing"]),
        ({}, {"fl": NO_DATA, "ml": NO_DATA}, {}, [f"strap of fl, ml: {USB}"]),
        ({}, {"fl": NO_DATA}, {"blind_wheels_max": 1}, []),
        ({}, {"fl": ContactStatus.UNKNOWN_PROTOCOL}, {}, ["strap of fl: the board speaks another frame protocol"]),
        ({}, {"rr": OPEN_A}, {}, [f"strap of rr: {LEAD_A}"]),  # never read well
        (
            {},
            {"fl": OPEN_A, "ml": NO_DATA, "rr": OPEN_A},
            {"blind_wheels_max": 1},
            [f"strap of fl, rr: {LEAD_A}; strap of ml: {USB}"],
        ),
        ({}, {"mr": 99}, {}, ["strap of mr: status 99 is unknown here: driver and controller must be of one version"]),
        ({}, {"mr": -(2**63)}, {}, ["strap of mr: status -9223372036854775808 is unknown here"]),
    ],
)  # fmt: skip
def test_what_an_operator_reads(ages_ms, status, settings, told):
    inputs = watch(ages_ms, codes(**status), **settings)
    assert inputs.complaints() == []  # not judged yet
    inputs.judge(NOW)
    complaints = inputs.complaints()
    assert len(complaints) == len(told)
    for complaint, start in zip(complaints, told, strict=True):
        assert complaint.startswith(start)


def test_a_strap_read_well_before_the_clock_was_set_back_needs_one_more_reading():
    inputs = watch({"odometry": 3_600_050, "wheels": 3_600_050, "request": 3_600_050, "soil": 3_600_050})
    inputs.angles.timeout_s = 1e5  # so that only the straps are judged
    inputs.judge(NOW - 3_600_000 * MS)
    assert inputs.blind.all()
    assert "the clock was set back" in inputs.complaints()[-1]


def test_a_faulty_strap_keeps_its_last_angles_and_a_wheel_in_the_air_has_none():
    inputs = watch()
    status = codes(fl=OPEN_A, fr=ContactStatus.NO_CONTACT, ml=ContactStatus.PREDICTED)
    inputs.take_contact_angles(ContactAngles(NOW, 0.7 * ONES, -0.2 * ONES, ONES, ONES, status))
    by_wheel = dict(
        zip(ROVER.wheel_names, zip(inputs.theta_1.tolist(), inputs.theta_2.tolist(), strict=True), strict=True)
    )
    assert by_wheel["fl"] == (0.5, -0.1)
    assert by_wheel["fr"] == (0.0, 0.0)
    assert by_wheel["ml"] == by_wheel["rr"] == (0.7, -0.2)
    assert inputs.faulty_readings == 1
    inputs.judge(NOW)
    assert not inputs.blind.any()


def test_request_and_soil_are_forgotten_and_the_sensors_are_not():
    inputs = watch()
    inputs.forget_request_and_soil()
    assert inputs.request.record is inputs.soil_state.record is None
    assert inputs.judge(NOW + 50 * MS) == ()
    assert inputs.judge(NOW + 150 * MS) == (SENSOR, WHEELS)
