import pytest

from missions.case_studies.fault_schedule import EVERY_BOARD, FaultSpell
from missions.case_studies.line_trials import TELLTALES, Course, counts, judge_line_trial
from sim_bridge.line_faults import LineFault
from sim_bridge.world import SensorSettings
from strap_sensor_driver.contact_zone import ContactStatus
from traction_controller.supervisor import Fault

MS = 1_000_000
BOARDS = SensorSettings(board_boot_s=0.0)


def course(fault, asked_ms, begun_ms, over_ms, struck=(1, 2), share=1.0):
    board = EVERY_BOARD if len(struck) > 1 else struck[0]
    spell = FaultSpell(fault, share, board, 0.0, 1e-3 * (over_ms - asked_ms))
    return Course(spell, struck, asked_ms * MS, begun_ms * MS, over_ms * MS)


def judged(drive, one, back_ms=5000, before=None):
    return judge_line_trial(drive.series, one, back_ms * MS, before or {}, BOARDS)


@pytest.fixture
def stalled(drive):
    """Board 2 is silent from 1000 to 2000 ms; the rover stands from 1104 to 2030 ms."""
    drive.frames(1, 0, 3000).frames(2, 0, 1000).frames(2, 2012, 3000, seq=400)
    drive.commands(0, 1104, 0.8).commands(1104, 2030, 0.0).commands(2030, 3000, 0.02)
    drive.angles(0, 1100).angles(1100, 2010, ContactStatus.NO_DATA).angles(2020, 3000)
    drive.state(500, Fault.NONE).state(1105, Fault.SENSOR_LATE).state(2030, Fault.NONE)
    return drive.health(900, 1).health(900, 2).health(1900, 2, line="SILENT").health(2900, 1).health(2900, 2)


def test_a_silent_board_stops_the_rover_until_it_speaks(stalled):
    trial = judged(stalled, course(LineFault.STALL, 1001, 1003, 2000, struck=(2,)))
    assert trial.to_zero_ms == 109.0  # from the scan at 995
    assert trial.to_first_frame_ms == 12.0
    assert trial.to_usable_ms == 20.0
    assert trial.to_driving_ms == 30.0
    assert trial.recovered
    assert trial.noticed
    assert trial.good_share == 0.0
    assert trial.line_states == ("SILENT",)
    assert trial.statuses == ("NO_DATA",)
    assert trial.controller_faults == ("SENSOR_LATE",)


def test_it_is_over_when_frames_straps_and_rover_are_back(stalled):
    one = course(LineFault.STALL, 1001, 1003, 2000, struck=(2,))
    assert one.is_over(stalled.series)
    commands = list(stalled.series.commands)
    stalled.series.commands[:] = [command for command in commands if command.at_ns < 2025 * MS]
    assert not one.is_over(stalled.series)
    assert not judged(stalled, one).recovered
    stalled.series.commands[:] = commands
    stalled.series.angles[:] = [record for record in stalled.series.angles if record.at_ns < 2015 * MS]
    assert not one.is_over(stalled.series)
    stalled.series.frames[:] = [frame for frame in stalled.series.frames if frame.at_ns < 2005 * MS]
    trial = judged(stalled, one)
    assert (trial.to_first_frame_ms, trial.to_usable_ms, trial.recovered) == (None, None, False)


def test_a_stop_after_all_was_well_again_is_not_the_faults(drive):
    drive.frames(1, 0, 3000).frames(2, 0, 3000).angles(0, 3000)
    drive.commands(0, 2500, 0.8).commands(2500, 3000, 0.0)
    one = course(LineFault.NOISE, 1000, 1002, 2000, share=0.25)
    trial = judged(drive, one, back_ms=2100)
    assert (trial.to_zero_ms, trial.to_driving_ms, trial.recovered) == (None, None, True)
    assert judged(drive, one, back_ms=3000).to_zero_ms == 1500.0


def test_a_share_of_frames_is_counted_and_need_not_stop_the_rover(drive):
    drive.frames(1, 0, 3000).frames(2, 0, 1000).frames(2, 1500, 3000, seq=300)
    drive.commands(0, 3000, 0.8).angles(0, 3000)
    drive.health(900, 1, bad_crc=4).health(900, 2, bad_crc=1, lost=7)
    drive.health(2900, 1, bad_crc=4, bad_cobs=2).health(2900, 2, bad_crc=9, lost=7)
    before = {"bad_crc": 5, "lost": 7}
    trial = judged(drive, course(LineFault.FLIP, 1000, 1000, 2000, share=0.01), before=before)
    assert trial.counters == {"bad_cobs": 2, "bad_crc": 8}
    assert trial.noticed
    assert trial.good_share == 0.75
    assert (trial.to_zero_ms, trial.to_driving_ms, trial.recovered) == (None, None, True)


@pytest.mark.parametrize("fault", [fault for fault in LineFault if fault not in {LineFault.NONE, LineFault.STALL}])
def test_a_fault_is_noticed_by_what_tells_of_it_alone(drive, fault):
    drive.frames(1, 0, 3000).frames(2, 0, 3000).commands(0, 3000, 0.8).angles(0, 3000)
    one = course(fault, 1000, 1000, 2000)
    drive.health(2900, 1, lost=9, **{"clock resets": 3})
    assert not judged(drive, one).noticed
    drive.health(2950, 1, lost=9, **{min(TELLTALES[fault]): 1})
    assert judged(drive, one).noticed


def test_a_reset_is_over_when_the_boards_own_time_has_begun_anew(drive):
    drive.frames(1, 0, 1004, seq=900).frames(2, 0, 1004, seq=900)
    drive.frames(1, 3004, 4000).frames(2, 3010, 4000)
    drive.commands(0, 1110, 0.8).commands(1110, 3040, 0.0).commands(3040, 4000, 0.1)
    drive.angles(0, 1100).angles(1100, 3020, ContactStatus.NO_DATA).angles(3020, 4000)
    drive.health(3900, 1, restart=1).health(3900, 2, restart=1)
    trial = judged(drive, course(LineFault.RESET, 1000, 1003, 1000))
    assert trial.counters == {"restart": 2}
    assert trial.to_first_frame_ms == 2010.0
    assert trial.to_usable_ms == 2020.0
    assert trial.to_zero_ms == 110.0  # from when it was asked for: scans come on until then
    assert trial.to_driving_ms == 2040.0
    assert trial.good_share is None


def test_counts_are_the_newest_of_the_boards_asked_for(drive):
    drive.health(100, 1, lost=1).health(100, 2, lost=10).health(200, 1, lost=3, bad_crc=1)
    assert {name: count for name, count in counts(drive.series.health, (1, 2)).items() if count} == {
        "lost": 13,
        "bad_crc": 1,
    }
    assert counts(drive.series.health, (1,))["lost"] == 3
    assert not any(counts([], (1, 2)).values())
