import json
import math
from dataclasses import replace

import numpy as np
import pytest

from missions.case_studies.early_warning_families import (
    B_TUNE,
    FAMILIES,
    GOAL_BEYOND_M,
    SOFT_FROM_M,
    VARIANTS,
    Member,
    member,
    noise_seed,
)
from strap_rover.terramechanics.ground_grid import (
    EXCAVATION,
    HEIGHT,
    K_C,
    K_PHI,
    REFILL_RATIO,
    SHEAR_MODULUS,
    SLOPE,
    N,
)
from strap_rover.terramechanics.slip_sinkage import MEASURED_LAW, ContactLaw
from strap_rover.terramechanics.soil import soil_from_de_st

NUMBERS = range(60)


def drawn(family: str) -> list[Member]:
    return [member(family, number) for number in NUMBERS]


def spread(values: list[float]) -> tuple[float, float]:
    return min(values), max(values)


@pytest.mark.parametrize("family", FAMILIES)
def test_a_member_is_the_same_at_every_draw_and_like_no_other(family: str) -> None:
    again = drawn(family)
    assert [one.to_json() for one in again] == [one.to_json() for one in drawn(family)]
    assert len({one.wheel_speed for one in again}) == len(again)
    assert len({one.key for one in again}) == len(again)


def test_what_is_written_down_is_plain_json_and_differs_by_member() -> None:
    texts = {
        json.dumps(member(family, number, variant).to_json(), allow_nan=False)
        for family in FAMILIES
        for number in range(4)
        for variant in VARIANTS
    }
    assert len(texts) == len(FAMILIES) * 4 * len(VARIANTS)


@pytest.mark.parametrize("family", FAMILIES)
def test_half_of_every_family_is_on_sand_that_flows_back(family: str) -> None:
    for one in drawn(family):
        refills = one.number % 2 == 1
        assert one.kind == ("refilling" if refills else "trapping")
        assert one.kappa == 3.0 if refills else 0.0 <= one.kappa <= 0.5
        layer = one.terrain().at(SOFT_FROM_M + 0.5 * one.way.soft_m, 0.0)
        if one.way.blend_m < 0.4 * one.way.soft_m:
            assert layer[EXCAVATION] == pytest.approx(one.soft.delta * (4.0 if refills else 1.0))
            assert layer[REFILL_RATIO] == pytest.approx(one.kappa)


def test_only_members_of_b_with_small_numbers_tune() -> None:
    assert member("B", B_TUNE - 1).is_for_tuning
    assert not member("B", B_TUNE).is_for_tuning
    assert not any(member(family, 0).is_for_tuning for family in "ACD")


def test_family_a_is_the_estimators_own_law_with_nothing_wrong_but_noise() -> None:
    for one in drawn("A"):
        assert one.law is MEASURED_LAW
        assert (one.load_factor, one.load_shift, one.slip_relaxation, one.soft.delta) == (1.0, 0.0, 0.2, 0.025)
        assert (one.senses.angle_bias, one.senses.torque_gain, one.senses.torque_offset) == (0.0, 1.0, 0.0)
        soil = soil_from_de_st(one.soft.de, one.soft.st)
        assert (one.soft.n, one.soft.cohesion) == (soil.n, soil.cohesion)
        assert one.soft.modulus == pytest.approx(float(soil.k_c) / 0.4 + float(soil.k_phi))
        assert set(one.soil_factors().stiffness) == {1.0}


def test_family_b_has_other_numbers_within_the_bounds_that_are_told() -> None:
    ratios: dict[str, list[float]] = {"n": [], "pressure": [], "shear": [], "load": []}
    for one in drawn("B"):
        assert one.law is MEASURED_LAW
        soil = soil_from_de_st(one.soft.de, one.soft.st)
        ratios["n"].append(one.soft.n / float(soil.n))
        told = (float(soil.k_c) / 0.4 + float(soil.k_phi)) * 0.02 ** float(soil.n)
        ratios["pressure"].append(one.soft.modulus * 0.02**one.soft.n / told)
        ratios["shear"].append(one.soft.shear_modulus / 0.0114)
        ratios["load"].append(one.true_rover().vertical_load_n / one.believed_rover().vertical_load_n)
        assert 0.01 <= one.soft.delta <= 0.05
        assert 0.1 <= one.slip_relaxation <= 0.4
    bounds = {"n": (0.85, 1.15), "pressure": (math.exp(-0.1), math.exp(0.1)), "shear": (0.7, 1.3), "load": (0.9, 1.1)}
    for name, (least, most) in bounds.items():
        low, high = spread(ratios[name])
        width = most - least
        assert least - 1e-9 <= low < least + 0.15 * width
        assert most - 0.15 * width < high <= most + 1e-9


def test_family_c_has_other_laws_and_soils_of_no_family() -> None:
    members = drawn("C")
    assert all(math.isnan(one.soft.de) and math.isnan(one.firm.st) for one in members)
    humped = sum(one.law.residual_shear < 1.0 for one in members)
    digging = sum(one.law.digging_exponent > 0.0 for one in members)
    assert 15 < humped < 45
    assert 15 < digging < 45
    assert spread([one.law.exponent_growth for one in members])[1] > 0.15
    assert all(factor >= 1.0 for one in members for factor in one.soil_factors().stiffness)
    assert all(abs(one.senses.torque_gain - 1.0) <= 0.05 for one in members)
    assert all(isinstance(one.law, ContactLaw) and one.law != MEASURED_LAW for one in members)


def test_in_family_d_every_following_axle_finds_softer_sand_that_is_dug_deeper() -> None:
    for one in drawn("D"):
        factors = one.soil_factors()
        assert factors.stiffness[0] == factors.stiffness[3] == 1.0 > factors.stiffness[1] > factors.stiffness[2] >= 0.4
        assert factors.stiffness[:3] == factors.stiffness[3:]
        assert factors.excavation[0] == 1.0 < factors.excavation[1] < factors.excavation[2] <= 1.8
    gains = [one.senses.torque_gain for one in drawn("D")]
    assert spread(gains)[0] < 0.93
    assert spread(gains)[1] > 1.07
    assert spread([math.degrees(one.senses.angle_bias) for one in drawn("D")])[1] > 0.7
    assert spread([one.load_factor for one in drawn("D")])[1] > 1.11


def test_the_ground_is_firm_then_soft_then_firm_and_stiffness_changes_in_its_logarithm() -> None:
    one = member("B", 3)
    way = replace(one.way, soft_m=4.0, blend_m=1.0)
    ground = replace(one, way=way).terrain()
    firm, middle, soft, beyond = (ground.at(x, 0.7) for x in (2.95, 3.5, 5.0, 8.0))
    for sand, found in ((one.firm, firm), (one.soft, soft), (one.firm, beyond)):
        assert found[K_PHI] == pytest.approx(sand.modulus)
        assert found[K_C] == 0.0
        assert (found[N], found[SHEAR_MODULUS]) == pytest.approx((sand.n, sand.shear_modulus))
    assert middle[K_PHI] == pytest.approx(math.sqrt(one.firm.modulus * one.soft.modulus), rel=1e-6)


def test_heights_are_the_slopes_added_up_and_level_before_the_hill() -> None:
    one = member("A", 4)
    way = replace(one.way, slope=0.2, slope_from_m=3.5, ramp_m=1.0, slope_m=6.0, ripple=0.0, descent=0.0)
    ground = replace(one, way=way).terrain()
    assert ground.at(0.0, 0.0)[HEIGHT] == pytest.approx(0.0, abs=1e-12)
    assert ground.at(3.0, 0.0)[HEIGHT] == pytest.approx(0.0, abs=1e-12)
    assert ground.at(6.0, 0.0)[SLOPE] == pytest.approx(0.2)
    assert ground.at(6.0, 0.0)[HEIGHT] == pytest.approx(math.tan(0.2) * 1.5 + 0.5 * math.tan(0.2), abs=2e-3)
    assert ground.at(10.0, 0.0)[SLOPE] == pytest.approx(0.0, abs=1e-9)


def test_goal_lies_beyond_patch_and_hill_and_the_hazard_is_the_first_of_them() -> None:
    way = replace(member("A", 0).way, soft_m=4.0, slope_from_m=2.0, slope_m=3.0, slope=math.radians(8.0))
    assert way.goal_m == 7.0 + GOAL_BEYOND_M
    assert replace(way, slope_m=9.0).goal_m == 11.0 + GOAL_BEYOND_M
    assert way.hazard_m == 2.0
    assert replace(way, slope=math.radians(2.0)).hazard_m == SOFT_FROM_M
    assert replace(way, slope_from_m=5.0).hazard_m == SOFT_FROM_M


def test_a_snag_and_its_counterfactual_differ_by_the_snag_alone() -> None:
    for number in range(10):
        held, free = member("B", number, "snag"), member("B", number, "counterfactual")
        assert held.snag is not None
        assert SOFT_FROM_M - 0.5 <= held.snag.x <= SOFT_FROM_M + 6.0
        assert replace(held, snag=None, variant="counterfactual").to_json() == free.to_json()
        assert noise_seed(held).generate_state(2).tolist() == noise_seed(free).generate_state(2).tolist()
        plain = member("B", number)
        assert free.way.slope == pytest.approx(0.5 * plain.way.slope)


def test_a_dip_goes_down_before_it_climbs_so_that_the_way_back_climbs() -> None:
    for number in range(10):
        one = member("C", number, "dip")
        ground = one.terrain()
        before, behind = ground.at(1.0, 0.0)[SLOPE], ground.at(one.way.slope_from_m + one.way.ramp_m + 0.5, 0.0)[SLOPE]
        assert math.radians(-14.0) <= before <= math.radians(-3.0)
        assert behind > 0.0
        lowest = min(ground.at(float(x), 0.0)[HEIGHT] for x in np.arange(0.0, one.way.goal_m, 0.1))
        assert lowest < -0.15


def test_the_true_rover_is_heavier_and_leans_as_drawn() -> None:
    one = replace(member("C", 2), load_factor=1.1, load_shift=0.1, rolling_loss=17.0)
    believed, true = one.believed_rover(), one.true_rover()
    assert true.mass_kg == pytest.approx(1.1 * believed.mass_kg)
    assert true.vertical_load_n == pytest.approx(1.1 * believed.vertical_load_n)
    assert true.rolling_loss_n == 17.0
    shares = [wheel.load_share for wheel in true.wheels]
    assert sum(shares) == pytest.approx(1.0, abs=1e-12)
    assert shares[0] / shares[1] == pytest.approx(0.9)
    assert shares[2] / shares[1] == pytest.approx(1.1)


def test_what_is_no_member_is_named() -> None:
    with pytest.raises(ValueError, match=r"no family 'E'; known: A, B, C, D"):
        member("E", 0)
    with pytest.raises(ValueError, match="no variant 'hill'"):
        member("A", 0, "hill")
    with pytest.raises(ValueError, match="got -1"):
        member("A", -1)
