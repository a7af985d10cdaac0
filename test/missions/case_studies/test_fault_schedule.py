import itertools

import pytest

from missions.case_studies.fault_schedule import (
    EVERY_BOARD,
    FAULTY_SHARE,
    SILENCING,
    single_faults,
    soak_spells,
)
from sim_bridge.line_faults import LineFault

ALL = {fault for fault in LineFault if fault is not LineFault.NONE}
BOARDS = (1, 2)


def test_every_fault_strikes_all_boards_and_those_that_silence_one_alone():
    spells = single_faults(2, 3.0, heavy=False)
    assert {spell.fault for spell in spells if spell.board == EVERY_BOARD} == ALL
    assert {spell.fault for spell in spells if spell.board == 2} == {
        LineFault.STALL,
        LineFault.UNPLUG,
        LineFault.RESET,
    }
    assert len(spells) == len(ALL) + 3
    assert {spell.length_s for spell in spells if spell.fault is not LineFault.RESET} == {3.0}


def test_heavy_adds_a_large_share_to_each_fault_that_has_one():
    light, heavy = single_faults(2, 1.0, heavy=False), single_faults(2, 1.0, heavy=True)
    added = [spell for spell in heavy if spell not in light]
    assert {spell.fault for spell in added} == ALL - SILENCING - {LineFault.RESET}
    shares = {spell.fault: spell.share for spell in light}
    assert all(spell.share > shares[spell.fault] for spell in added)
    assert all(0.0 < spell.share <= 1.0 for spell in heavy)


def test_a_soak_is_its_seed():
    arguments = (600.0, BOARDS, 6.0, 10.0)
    assert soak_spells(3, *arguments) == soak_spells(3, *arguments)
    assert soak_spells(3, *arguments) != soak_spells(4, *arguments)


@pytest.mark.parametrize("seed", range(5))
def test_faults_of_a_soak_follow_each_other_with_pauses_and_leave_the_end_in_peace(seed):
    spells = soak_spells(seed, 60.0, BOARDS, 3.0, 5.0)
    assert len(spells) > 5
    assert spells[0].begin_s >= 1.5
    for before, after in itertools.pairwise(spells):
        assert after.begin_s - before.begin_s - before.length_s >= 1.5 - 1e-9
    assert spells[-1].begin_s + spells[-1].length_s <= 55.0
    assert all(0.1 <= spell.length_s <= 3.0 for spell in spells)


def test_a_long_soak_has_everything_and_is_faulty_for_a_third():
    spells = soak_spells(0, 20_000.0, BOARDS, 6.0, 10.0)
    assert {spell.fault for spell in spells} == ALL
    assert {spell.board for spell in spells} == {EVERY_BOARD, *BOARDS}
    faulty = sum(spell.length_s for spell in spells) / 20_000.0
    assert faulty == pytest.approx(FAULTY_SHARE, abs=0.02)
    assert all(0.0 < spell.share <= 1.0 for spell in spells)
    assert max(spell.share for spell in spells if spell.fault in {LineFault.FLIP, LineFault.DROP}) <= 0.1
