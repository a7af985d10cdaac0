"""Records of a calibration: what they refuse, and how they are held against a rover."""

import dataclasses
import math

import pytest

from strap_sensor_driver.calibration import EndCalibration, RoverCalibration, StrapCalibration

END = EndCalibration(450e3, 0.0, 1.0, (450.0, 450e3, 900e3), (0.0, 3.0, 6.0), (0.0, 0.01, 0.02), 0.004)
STRAP = StrapCalibration("fl", 1, 0, "bench", "2026-05-01T10:00:00Z", "1.0", 18, 0.5, END, END)
ROVER = RoverCalibration("curiosity", (STRAP, dataclasses.replace(STRAP, wheel="ml", channel=1)), "0123456789ab")


def test_the_curve_is_in_terms_of_the_pull_down():
    curve = END.curve()
    assert curve.ratio == pytest.approx((0.001, 1.0, 2.0))
    assert curve.arc_rad == END.arc_rad
    assert END.contact_ohm == 450.0


@pytest.mark.parametrize(
    ("field", "value", "says"),
    [
        ("pull_down_ohm", 0.0, "finite resistance above 0"),
        ("pull_down_ohm", math.nan, "finite resistance above 0"),
        ("pull_down_ohm", math.inf, "finite resistance above 0"),
        ("offset_lsb", 51.0, "check wiring"),
        ("offset_lsb", math.nan, "check wiring"),
        ("gain", 0.79, "0.8 .. 1.2"),
        ("gain", math.nan, "0.8 .. 1.2"),
        ("residual_rms_rad", -0.1, "at least 0"),
        ("residual_rms_rad", math.inf, "at least 0"),
        ("resistance_ohm", (0.0, 2.0, 1.0), "calibrate again"),
        ("arc_rad", (0.0, 3.0), "as many of each column"),
    ],
)
def test_an_end_that_cannot_be_is_refused(field, value, says):
    with pytest.raises(ValueError, match=says):
        dataclasses.replace(END, **{field: value})


@pytest.mark.parametrize(("field", "value"), [("method", "guess"), ("noise_lsb", -1.0), ("noise_lsb", math.nan)])
def test_a_strap_that_cannot_be_is_refused(field, value):
    with pytest.raises(ValueError, match=field):
        dataclasses.replace(STRAP, **{field: value})


def test_a_strap_is_found_by_wheel_and_input():
    assert ROVER.of("fl", 1, 0) is STRAP
    assert ROVER.of("fl", 1, 1) is None
    assert ROVER.of("fl", 2, 0) is None
    assert ROVER.of("rr", 1, 0) is None


def test_what_fits_a_rover_has_no_mismatch():
    inputs = [("fl", 1, 0), ("ml", 1, 1), ("rl", 1, 2)]  # rl is not calibrated: no mismatch
    assert ROVER.mismatches("curiosity", inputs) == []


def test_mismatches_say_what_to_do():
    (other,) = ROVER.mismatches("spirit", [])
    assert other == "calibration 0123456789ab is of rover 'curiosity', not 'spirit': give that rover's, or calibrate"
    swapped = ROVER.mismatches("curiosity", [("fl", 1, 1), ("ml", 1, 0)])
    assert len(swapped) == 2
    assert "wheel 'fl' was calibrated on board 1 channel 0, which now reads wheel 'ml'" in swapped[0]
    (gone,) = ROVER.mismatches("curiosity", [("fl", 1, 0)])
    assert "board 1 channel 1, which now reads no wheel: put the leads back" in gone
