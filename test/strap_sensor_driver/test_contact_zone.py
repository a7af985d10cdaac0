"""What two volts mean: every row of the table of conditions, and agreement with the divider."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from strap_sensor_driver.contact_zone import FIRST_FAULT, ContactStatus, ZoneLimits, classify, locate, remedy
from strap_sensor_driver.strap import FULL_TURN_RAD, Strap

STRAP = Strap(785e3, 453e3, 453e3, 5.0)
LIMITS = ZoneLimits.of(STRAP)


@pytest.mark.parametrize(
    ("v_a", "v_b", "status"),
    [
        (3.0, 2.9, ContactStatus.VALID),
        (4.99, 4.98, ContactStatus.PREDICTED),
        (5.0, 5.0, ContactStatus.PREDICTED),
        (0.0, 0.0, ContactStatus.NO_CONTACT),
        (0.01, 0.02, ContactStatus.NO_CONTACT),
        (0.0, 3.0, ContactStatus.FAULT_OPEN_A),
        (3.0, 0.0, ContactStatus.FAULT_OPEN_B),
        (0.0, 5.0, ContactStatus.FAULT_OPEN_A),
        (1.0, 3.0, ContactStatus.FAULT_RANGE),
        (3.0, 1.2, ContactStatus.FAULT_RANGE),
        (2.0, 2.0, ContactStatus.FAULT_ORDER),
        (4.7, 4.7, ContactStatus.PREDICTED),  # the seam, though the supply is not the reference
        (4.0, 4.0, ContactStatus.FAULT_WIDTH),
        (math.nan, 3.0, ContactStatus.FAULT_RANGE),
        (3.0, math.nan, ContactStatus.FAULT_RANGE),
        (math.nan, math.nan, ContactStatus.FAULT_RANGE),
    ],
)
def test_conditions(v_a, v_b, status):
    assert locate(v_a, v_b, LIMITS)[0] == status
    upside_down = Strap(785e3, 453e3, 453e3, 5.0, inverted=True)
    assert locate(5.0 - v_a, 5.0 - v_b, ZoneLimits.of(upside_down))[0] == status


@given(st.floats(0.05, 6.0), st.floats(0.02, 3.1), st.booleans())
def test_a_zone_is_found_where_the_divider_put_it(beta_1, width, inverted):
    strap = Strap(785e3, 453e3, 300e3, 5.0, inverted)
    beta_2 = min(beta_1 + width, FULL_TURN_RAD)
    v_a, v_b = (float(volts) for volts in strap.terminal_voltages(beta_1, beta_2))
    status, found_1, found_2 = locate(v_a, v_b, ZoneLimits.of(strap))
    assert status == ContactStatus.VALID
    assert found_1 == pytest.approx(beta_1, abs=1e-9)
    assert found_2 == pytest.approx(beta_2, abs=1e-9)


@given(st.floats(0.5, 5.0), st.floats(0.5, 5.0), st.booleans())
def test_the_fast_path_and_the_strap_agree(v_a, v_b, inverted):
    strap = Strap(785e3, 453e3, 300e3, 5.0, inverted)
    status, found_1, found_2 = locate(v_a, v_b, ZoneLimits.of(strap, order_margin_rad=0.0))
    if status == ContactStatus.VALID:
        beta_1, beta_2 = strap.strap_angles(v_a, v_b)
        assert found_1 == pytest.approx(float(beta_1), abs=1e-12)
        assert found_2 == pytest.approx(float(beta_2), abs=1e-12)


def test_ends_that_cross_within_the_margin_are_a_narrow_contact_in_their_middle():
    v_a, _ = STRAP.terminal_voltages(3.05, 3.05)
    _, v_b = STRAP.terminal_voltages(2.95, 2.95)
    status, beta_1, beta_2 = locate(float(v_a), float(v_b), LIMITS)
    assert status == ContactStatus.VALID
    assert beta_1 == beta_2 == pytest.approx(3.0, abs=1e-9)


def test_classify_is_locate_element_by_element():
    rng = np.random.default_rng(1)
    v_a, v_b = rng.uniform(0.0, 5.0, (2, 40, 25))
    status, beta_1, beta_2 = classify(v_a, v_b, LIMITS)
    assert status.shape == beta_1.shape == beta_2.shape == (40, 25)
    assert status.dtype == np.int64
    assert (int(status[7, 3]), beta_1[7, 3], beta_2[7, 3]) == locate(float(v_a[7, 3]), float(v_b[7, 3]), LIMITS)
    assert len(set(status.ravel().tolist())) >= 6
    empty = classify(np.empty((0,)), np.empty((0,)), LIMITS)
    assert [part.shape for part in empty] == [(0,)] * 3
    with pytest.raises(ValueError, match="shape"):
        classify(v_a, v_b[:1], LIMITS)


def test_every_status_has_a_remedy_and_faults_are_the_high_numbers():
    for status in ContactStatus:
        assert len(remedy(status)) > 10
        assert remedy(int(status)) == remedy(status)
        assert status.is_fault == (int(status) >= FIRST_FAULT)
    assert not ContactStatus.PREDICTED.is_fault
    with pytest.raises(ValueError):
        remedy(99)


def test_levels_that_would_swallow_good_contacts_are_refused():
    with pytest.raises(ValueError, match="contact_level"):
        ZoneLimits.of(STRAP, contact_level=0.35)
    with pytest.raises(ValueError, match="contact_level"):
        ZoneLimits.of(Strap(785e3, 50e3, 453e3, 5.0))
    with pytest.raises(ValueError, match="seam_level"):
        ZoneLimits.of(STRAP, seam_level=1.0)
