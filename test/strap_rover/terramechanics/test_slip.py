import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from strap_rover.terramechanics.slip import (
    LOCKED_FLOOR,
    REST_SPEED,
    at_rest,
    slip_kernel,
    slip_ratio,
    transport_ratio_kernel,
)

ROUNDING = 1e-12
RADIUS = 0.25
speeds = st.floats(-5.0, 5.0)
forward = st.floats(0.01, 5.0)


@pytest.mark.parametrize(
    ("speed", "rim", "slip"),
    [
        (0.5, 0.5, 0.0),  # rolling
        (0.15, 0.20, 0.25),  # driving: a quarter of the rim's way is lost
        (0.20, 0.15, -0.25),  # braking: the rim covers a quarter less than the ground
        (0.0, 0.3, 1.0),  # spinning on the spot
        (0.3, 0.0, -1.0),  # locked
        (-0.3, 0.0, -1.0),  # locked, sliding back
        (-0.1, 0.3, 1.0),  # driven against its motion
        (0.1, -0.3, 1.0),
        (0.0, 0.0, 0.0),
    ],
)
def test_known_motions(speed: float, rim: float, slip: float) -> None:
    assert slip_ratio(speed, RADIUS, rim / RADIUS) == pytest.approx(slip, abs=ROUNDING)
    assert slip_kernel(speed, rim) == pytest.approx(slip, abs=ROUNDING)


@given(speed=st.floats(-0.999, 0.999), rim=st.floats(-0.999, 0.999))
def test_at_rest_slip_is_zero_and_flagged(speed: float, rim: float) -> None:
    v, r_omega = speed * REST_SPEED, rim * REST_SPEED
    assert slip_ratio(v, 1.0, r_omega) == 0.0
    assert at_rest(v, 1.0, r_omega)


@given(speed=speeds, rim=speeds)
def test_a_motion_that_has_a_slip_is_not_at_rest(speed: float, rim: float) -> None:
    moves = max(abs(speed), abs(rim)) >= REST_SPEED
    assert bool(at_rest(speed, 1.0, rim)) is not moves


@given(speed=forward, slip=st.floats(0.0, 0.99))
def test_driving_slip_is_recovered_from_the_rim_speed_it_needs(speed: float, slip: float) -> None:
    omega = speed / (1.0 - slip) / RADIUS
    assert slip_ratio(speed, RADIUS, omega) == pytest.approx(slip, abs=1e-10)


@given(speed=forward, slip=st.floats(-1.0, 0.0))
def test_braking_slip_is_recovered_from_the_rim_speed_it_needs(speed: float, slip: float) -> None:
    omega = speed * (1.0 + slip) / RADIUS
    assert slip_ratio(speed, RADIUS, omega) == pytest.approx(slip, abs=1e-10)


@given(speed=speeds, rim=speeds)
def test_reversing_mirrors(speed: float, rim: float) -> None:
    assert slip_ratio(-speed, 1.0, -rim) == slip_ratio(speed, 1.0, rim)


@given(speed=speeds, rim=speeds)
@example(speed=0.0, rim=-0.0)
@example(speed=REST_SPEED, rim=0.0)
@example(speed=-1.0, rim=-0.0)
@example(speed=1.0, rim=5e-324)
def test_kernel_and_array_form_are_the_same_function(speed: float, rim: float) -> None:
    slip = slip_kernel(speed, rim)
    assert -1.0 <= slip <= 1.0
    assert slip == pytest.approx(float(slip_ratio(speed, 1.0, rim)), abs=ROUNDING)


@given(speed=forward, rim=forward, more=st.floats(1.0, 3.0))
def test_slip_grows_with_the_rim_speed(speed: float, rim: float, more: float) -> None:
    assert slip_ratio(speed, 1.0, rim * more) >= slip_ratio(speed, 1.0, rim) - ROUNDING


@given(speed=forward, rim=forward)
def test_transport_ratio_is_speed_over_rim_speed(speed: float, rim: float) -> None:
    slip = slip_kernel(speed, rim)
    if slip >= LOCKED_FLOOR - 1.0:
        assert transport_ratio_kernel(slip) == pytest.approx(speed / rim, rel=1e-9, abs=1e-12)


def test_transport_ratio_of_a_locked_wheel_is_finite() -> None:
    assert transport_ratio_kernel(-1.0) == pytest.approx(20.0)
    assert transport_ratio_kernel(-0.951) == pytest.approx(20.0)
    assert transport_ratio_kernel(1.0) == 0.0


def test_broadcasts_over_wheels() -> None:
    slip = slip_ratio(np.array([[0.1], [0.2]]), np.array([0.25, 0.25, 0.2]), 1.0)
    assert slip.shape == (2, 3)
    assert slip[1, 2] == pytest.approx(0.0)
    assert math.isclose(slip[0, 0], 0.6)
