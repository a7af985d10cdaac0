import numpy as np
import pytest

from missions.case_studies.baselines import BASELINES, SOIL_FLOW
from missions.case_studies.mars_snag_claims import claims, compare, comparison_tables, window_members
from missions.case_studies.mars_snag_runs import Result
from missions.case_studies.study_result import Verdict
from missions.summary import Outcome
from sim_bridge.scenarios import SnagCase

MEMBERS = 20


def results(off, depth):
    """`off` and `depth` of (controller, member) on trapping sand."""
    return [
        Result(
            member,
            "trapping",
            name,
            SnagCase(),
            (Outcome.DROVE_OFF if off(name, member) else Outcome.BURIED).value,
            9.0,
            depth(name, member),
            50.0,
            0,
        )
        for name in BASELINES
        for member in range(MEMBERS)
    ]


def in_order(name, member):
    """Constant speeds drive off nowhere, slip limits on the first ten, ours on two more."""
    return member < {SOIL_FLOW: 12, "slip 0.3": 10, "slip 0.4": 10}.get(name, 0)


def test_the_window_is_where_the_choice_decides():
    found = results(in_order, lambda _name, _member: 60.0)
    assert window_members(found, "trapping") == frozenset(range(12))
    everywhere = results(lambda name, member: name == "constant 2 rad/s" or in_order(name, member), lambda *_: 60.0)
    assert window_members(everywhere, "trapping") == frozenset()  # nobody is needed there
    assert window_members(found, "refilling") == frozenset()


def test_pairs_are_counted_member_by_member():
    found = results(in_order, lambda name, member: 60.0 + member - (3.0 if name == SOIL_FLOW else 0.0))
    by_name = {c.other: c for c in compare(found, "trapping")}
    assert list(by_name) == [name for name in BASELINES if name != SOIL_FLOW]
    slip = by_name["slip 0.3"]
    assert (slip.rates.both, slip.rates.only_first, slip.rates.only_second, slip.rates.neither) == (10, 2, 0, 8)
    assert slip.off == (12, 10)
    assert slip.sinkage.median_difference == -3.0
    assert slip.sinkage.p_value < slip.p_sinkage < 0.001
    assert by_name["constant 2 rad/s"].p_rates < 0.05 < slip.p_rates
    assert [c.members for c in compare(found, "trapping", frozenset({1, 2}))] == [2] * 5


def test_the_order_of_the_results_is_of_no_matter():
    found = results(in_order, lambda name, member: 60.0 + member - (3.0 if name == SOIL_FLOW else 0.0))
    shuffled = [found[index] for index in np.random.default_rng(1).permutation(len(found))]
    assert compare(shuffled, "trapping") == compare(found, "trapping")


@pytest.mark.parametrize(
    ("change_mm", "verdicts"),
    [
        (-3.0, (Verdict.MET, Verdict.MET, Verdict.MET)),
        (0.0, (Verdict.MET, Verdict.MET, Verdict.NOT_MET)),
        (4.0, (Verdict.MET, Verdict.NOT_MET, Verdict.NOT_MET)),
    ],
)
def test_digging_less_with_the_same_outcome_meets_the_goal(change_mm, verdicts):
    def off(name, member):
        return in_order("slip 0.3" if name == SOIL_FLOW else name, member)

    found = claims(results(off, lambda name, member: 60.0 + member + (change_mm if name == SOIL_FLOW else 0.0)))
    assert [claim.figure for claim in found] == ["trapping sand, every member"] * 3 + ["trapping sand, window"] * 3
    assert tuple(claim.verdict for claim in found[:3]) == verdicts
    assert "10 of 20, slip 0.3 10" in found[0].measured


def test_who_drives_off_less_often_has_not_met_it_however_shallow():
    def off(name, member):
        return member < {SOIL_FLOW: 9, "slip 0.3": 10}.get(name, 0)

    found = claims(results(off, lambda name, member: member + (10.0 if name == SOIL_FLOW else 60.0)))
    assert [claim.verdict for claim in found[:3]] == [Verdict.NOT_MET, Verdict.MET, Verdict.NOT_MET]


def test_a_rival_that_gives_up_is_no_measure_of_sinkage():
    found = claims(results(in_order, lambda name, member: member + (5.0 if "constant" in name else 60.0)))
    assert "slip 0.3" in found[1].measured or "slip 0.4" in found[1].measured
    assert found[1].verdict is Verdict.MET


def test_tables_leave_out_what_nobody_met():
    tables = comparison_tables(results(in_order, lambda *_: 60.0))
    assert [len(table.rows) for table in tables] == [5, 5, 0, 0]
    assert tables[0].rows[2][:6] == ("slip 0.3", "20", "10", "2", "0", "8")
