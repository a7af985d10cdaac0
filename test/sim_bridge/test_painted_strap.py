"""The imperfect strap: perfect without flaws, as imperfect as asked with them, monotone, and invertible."""

import math

import numpy as np
import pytest

from sim_bridge.painted_strap import FULL_COUNT, PaintedStrap, StrapFlaws, paint
from strap_rover.settings import SettingsError
from strap_sensor_driver.strap import FULL_TURN_RAD, Strap

NOMINAL = Strap(785e3, 453e3, 400e3, 5.0)
ANGLES = np.linspace(0.0, FULL_TURN_RAD, 721)


def painted(seed=0, nominal=NOMINAL, **flaws):
    return paint(nominal, StrapFlaws(**flaws), np.random.SeedSequence(seed))


@pytest.mark.parametrize("inverted", [False, True])
def test_without_flaws_it_is_the_nominal_strap_to_the_last_bit(inverted):
    nominal = Strap(785e3, 453e3, 400e3, 1.0, inverted=inverted)
    for strap in (PaintedStrap.perfect(nominal), painted(nominal=nominal)):
        for first, second in ((0.0, FULL_TURN_RAD), (1.0, 1.8), (4.0, 5.5), (0.1, 0.2)):
            v_a, v_b = nominal.terminal_voltages(first, second)
            assert strap.shares(first, second) == (float(v_a), float(v_b))
        assert (
            strap.shares(1.0, 2.0, touches=False) == strap.shares(3.0, 3.0) == ((1.0,) * 2 if inverted else (0.0,) * 2)
        )
        assert strap.shares(6.0, 0.4) == ((0.0,) * 2 if inverted else (1.0,) * 2)


def resistances(strap):
    """Between end A and each angle, over the nominal strap's resistance."""
    share = np.array([strap.shares(beta, FULL_TURN_RAD)[0] for beta in ANGLES[:-1]])
    return strap.gain_a_rad * (1.0 / share - 1.0) / FULL_TURN_RAD


@pytest.mark.parametrize("seed", range(8))
def test_the_layer_deviates_as_much_as_asked_and_keeps_the_turns_resistance(seed):
    strap = painted(seed, strap_nonuniformity=0.05)
    along = resistances(strap)
    density = np.diff(along) / np.diff(ANGLES[:-1]) * FULL_TURN_RAD
    assert np.abs(density - 1.0).max() == pytest.approx(0.05, rel=0.02)
    assert np.mean(density) == pytest.approx(1.0, abs=1e-3)
    middle = 0.5 * (ANGLES[1:-1] + ANGLES[:-2])
    np.testing.assert_allclose(density, [strap.density(beta) for beta in middle], atol=1e-4)
    from_b = strap.shares(0.0, 2.0)[1]
    rest = strap.gain_b_rad * (1.0 / from_b - 1.0) / FULL_TURN_RAD
    assert rest == pytest.approx(1.0 - np.interp(2.0, ANGLES[:-1], along), abs=1e-5)  # both ends see one layer


@pytest.mark.parametrize("seed", range(4))
def test_the_layer_is_monotone_and_no_table_of_a_few_straight_pieces(seed):
    along = resistances(painted(seed, strap_nonuniformity=0.8))
    assert np.all(np.diff(along) > 0.0)
    bent = np.diff(along, 2)
    assert np.abs(bent).max() > 0.0
    assert np.mean(np.abs(bent) > 0.02 * np.abs(bent).max()) > 0.8  # bent nearly everywhere: no straight pieces


def test_each_flaw_is_where_it_belongs():
    arc = (1.5, 4.0)
    true = painted().shares(*arc)

    def ratio(**flaws):
        strap = painted(3, **flaws)
        return [1.0 / share - 1.0 for share in strap.shares(*arc)], strap

    bare = [1.0 / share - 1.0 for share in true]
    wrong, strap = ratio(strap_resistance_error=0.05)
    assert [abs(got / due - 1.0) for got, due in zip(wrong, bare, strict=True)] == pytest.approx([0.05, 0.05])
    assert abs(strap.scale - 1.0) == pytest.approx(0.05)
    thick, _ = ratio(strap_thickness=2.0)
    assert thick == pytest.approx([0.5 * due for due in bare])
    behind, strap = ratio(strap_contact_ohm=6e3, strap_lead_ohm=2e3)
    assert behind == pytest.approx([bare[0] + 8e3 / 453e3, bare[1] + 8e3 / 400e3])
    assert strap.shares(6.0, 0.4) == pytest.approx((453e3 / 461e3, 400e3 / 408e3))  # the seam: nothing else is between
    _, strap = ratio(pull_down_error=0.01)
    assert [abs(strap.gain_a_rad / NOMINAL.gain_a_rad - 1.0), abs(strap.gain_b_rad / NOMINAL.gain_b_rad - 1.0)] == (
        pytest.approx([0.01, 0.01])
    )
    shifted = painted(3, adc_offset_lsb=2.0).shares(*arc)
    assert [abs(got - due) * FULL_COUNT for got, due in zip(shifted, true, strict=True)] == pytest.approx([2.0, 2.0])
    steeper = painted(3, adc_gain_error=0.01).shares(*arc)
    assert [abs(got / due - 1.0) for got, due in zip(steeper, true, strict=True)] == pytest.approx([0.01, 0.01])


def test_it_drifts_with_its_age_only():
    strap = painted(strap_drift_per_hour=0.36)
    assert strap.shares(2.0, 4.0) == painted().shares(2.0, 4.0)
    share = strap.shares(2.0, 4.0, age_s=1000.0)[0]
    grown = strap.gain_a_rad * (1.0 / share - 1.0) / 2.0
    assert abs(grown - 1.0) == pytest.approx(0.1)


def test_straps_of_one_source_are_equal_and_of_another_are_not():
    flaws = {"strap_nonuniformity": 0.05, "strap_resistance_error": 0.05, "pull_down_error": 0.01}
    assert painted(4, **flaws) == painted(4, **flaws) != painted(5, **flaws)
    signs = {painted(seed, **flaws).scale > 1.0 for seed in range(12)}
    assert signs == {True, False}
    # what is drawn is drawn whatever else is wrong
    assert painted(4, **flaws).waves == painted(4, strap_nonuniformity=0.05).waves


def test_its_arc_is_found_again_from_its_shares():
    strap = painted(
        2, strap_resistance_error=0.05, strap_nonuniformity=0.1, strap_contact_ohm=5e3, pull_down_error=0.01,
        adc_offset_lsb=1.0, adc_gain_error=0.002, strap_drift_per_hour=0.5,
    )  # fmt: skip
    rng = np.random.default_rng(1)
    for _ in range(50):
        first, second = np.sort(rng.uniform(0.01, FULL_TURN_RAD - 0.01, 2)).tolist()
        found = strap.arc(*strap.shares(first, second, age_s=500.0), age_s=500.0)
        assert found == pytest.approx((first, second), abs=1e-9)
    with pytest.raises(ValueError, match="no arc gives it"):
        strap.arc(0.1, 0.9)


def test_the_whole_strap_lies_between_an_end_at_the_supply_and_the_other():
    strap = painted(strap_lead_ohm=1e3)
    assert strap.through_a == pytest.approx(453e3 / (453e3 + 785e3 + 1e3))
    assert strap.through_b == pytest.approx(400e3 / (400e3 + 785e3 + 1e3))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("strap_nonuniformity", 1.0),
        ("strap_thickness", 0.0),
        ("strap_contact_ohm", -1.0),
        ("pull_down_error", math.nan),
    ],
)
def test_flaws_that_cannot_be_are_refused(name, value):
    with pytest.raises(SettingsError, match=name):
        StrapFlaws(**{name: value})
