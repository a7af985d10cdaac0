import math

import numpy as np
import pytest

from missions.case_studies.paired_tests import holm, paired_amounts, paired_rates


def outcomes(text):
    return np.array([letter == "+" for letter in text], dtype=bool)


def test_only_members_that_differ_count():
    rates = paired_rates(outcomes("++++++--"), outcomes("+-----+-"))
    assert (rates.both, rates.only_first, rates.only_second, rates.neither) == (1, 5, 1, 1)
    assert rates.p_value == pytest.approx(2 * (1 + 6) / 2**6)  # six coins, at most one falls the other way
    assert paired_rates(outcomes("-+--"), outcomes("-+--")).p_value == 1.0


def test_the_order_of_the_two_turns_the_difference_only():
    one, other = outcomes("+++++++-"), outcomes("+------+")
    there, back = paired_rates(one, other), paired_rates(other, one)
    assert there.p_value == back.p_value
    assert (there.only_first, there.only_second) == (back.only_second, back.only_first)


def test_amounts_that_are_always_less():
    depth = np.array([50.0, 61.0, 72.0, 84.0, 95.0])
    less = paired_amounts(depth - np.array([1.0, 2.0, 3.0, 4.0, 5.0]), depth)
    assert less.median_difference == -3.0
    assert less.p_value == pytest.approx(2 / 2**5)  # of 32 signs of the ranks, all minus or all plus
    assert paired_amounts(depth, depth).p_value == 1.0


def test_nothing_to_compare_proves_nothing():
    assert paired_rates(outcomes(""), outcomes("")).p_value == 1.0
    assert paired_amounts(np.empty(0), np.empty(0)).p_value == 1.0


def test_what_is_no_pair_is_refused():
    with pytest.raises(ValueError, match=r"\(2,\) and \(3,\) are no pairs"):
        paired_rates(outcomes("++"), outcomes("+++"))
    with pytest.raises(ValueError, match="no pairs"):
        paired_amounts(np.zeros(2), np.zeros(3))


def test_several_tests_ask_for_more():
    assert holm([0.04, 0.01, 0.03]) == pytest.approx((0.06, 0.03, 0.06))
    assert holm([0.6, 0.9]) == (1.0, 1.0)
    assert holm([]) == ()
    assert math.isclose(holm([0.02])[0], 0.02)
