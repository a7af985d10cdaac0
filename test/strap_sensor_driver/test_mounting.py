"""Strap angles <-> contact angles: check values, geometry of a marked point, both mountings, both ways of travel."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from strap_sensor_driver.mounting import StrapMounting, wrap

angles = st.floats(-30.0, 30.0)
mountings = st.builds(StrapMounting, angles, st.sampled_from([1, -1]))


def test_known_contact_angles():
    mounting = StrapMounting(math.radians(50.0))
    theta_1, theta_2 = mounting.contact_angles(math.radians(200.0), math.radians(255.0), 0.0)
    assert math.degrees(float(theta_1)) == pytest.approx(35.0, abs=1e-9)
    assert math.degrees(float(theta_2)) == pytest.approx(-20.0, abs=1e-9)


@pytest.mark.parametrize("direction", [1, -1])
def test_rolling_forward_carries_a_point_of_the_strap_backward(direction):
    """A mark at strap angle beta moves through bottom dead centre from front (+) to rear (-) at wheel speed."""
    mounting = StrapMounting(0.7, direction)
    encoder = np.linspace(0.0, 0.2, 5)
    theta = mounting.contact_angles(4.0, 4.0, encoder)[0]
    np.testing.assert_allclose(np.diff(theta), -np.diff(encoder), rtol=1e-9)


def test_the_wheel_angle_turns_against_the_encoder_and_with_it_when_mirrored():
    assert float(StrapMounting(1.0, 1).wheel_angle(0.25)) == pytest.approx(0.75)
    assert float(StrapMounting(1.0, -1).wheel_angle(0.25)) == pytest.approx(1.25)


def test_the_mirror_image_of_a_wheel_reads_the_mirror_image():
    """Seen from the other side of the rover, forward is backward: angles and encoder change sign."""
    beta_1, beta_2, encoder = 3.1, 4.0, 0.4
    entry, leaving = StrapMounting(0.3, 1).contact_angles(beta_1, beta_2, encoder)
    mirrored_entry, mirrored_leaving = StrapMounting(0.3, -1).contact_angles(beta_1, beta_2, -encoder)
    assert float(mirrored_entry) == pytest.approx(-float(leaving))
    assert float(mirrored_leaving) == pytest.approx(-float(entry))


@given(mountings, st.floats(-1.4, 1.4), st.floats(0.01, 1.5), angles, st.booleans())
def test_round_trip_and_leading_end(mounting, front, width, encoder, reversing):
    rear = front - width
    theta_1, theta_2 = (rear, front) if reversing else (front, rear)
    beta_1, beta_2 = mounting.strap_angles(theta_1, theta_2, encoder, reversing=reversing)
    assert 0.0 <= float(beta_1) < 2.0 * math.pi
    assert 0.0 <= float(beta_2) < 2.0 * math.pi
    # from end A to end B the arc runs over the zone, whichever way round the strap is mounted
    assert (float(beta_2) - float(beta_1)) % (2.0 * math.pi) == pytest.approx(width, abs=1e-9)
    back_1, back_2 = mounting.contact_angles(beta_1, beta_2, encoder, reversing=reversing)
    assert float(back_1) == pytest.approx(theta_1, abs=1e-9)
    assert float(back_2) == pytest.approx(theta_2, abs=1e-9)


@given(mountings, st.floats(0.0, 6.28), st.floats(0.0, 6.28), angles)
def test_reversing_swaps_entry_and_exit_and_nothing_else(mounting, beta_1, beta_2, encoder):
    ahead = mounting.contact_angles(beta_1, beta_2, encoder)
    back = mounting.contact_angles(beta_1, beta_2, encoder, reversing=True)
    assert (float(ahead[0]), float(ahead[1])) == (float(back[1]), float(back[0]))


@given(st.floats(-1e3, 1e3))
def test_wrap_keeps_the_angle_and_lands_in_the_half_open_turn(angle):
    wrapped = float(wrap(angle))
    assert -math.pi < wrapped <= math.pi
    assert math.cos(wrapped) == pytest.approx(math.cos(angle), abs=1e-9)
    assert math.sin(wrapped) == pytest.approx(math.sin(angle), abs=1e-9)


def test_wrap_at_its_ends():
    assert float(wrap(math.pi)) == math.pi
    assert float(wrap(-math.pi)) == math.pi
    assert float(wrap(3.0 * math.pi)) == pytest.approx(math.pi)


@pytest.mark.parametrize(
    ("offset", "direction", "named"), [(0.0, 0, "direction"), (0.0, 2, "direction"), (math.nan, 1, "offset")]
)
def test_bad_mountings_are_refused(offset, direction, named):
    with pytest.raises(ValueError, match=named):
        StrapMounting(offset, direction)
