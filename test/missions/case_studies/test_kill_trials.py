import pytest

from missions.case_studies.kill_trials import CONTROLLER, RECORDER, WORLD, judge_kill_trial

MS = 1_000_000


def judged(drive, node, killed_ms=1000, started_ms=1012, bags=2):
    return judge_kill_trial(drive.series, node, killed_ms * MS, started_ms * MS, bags)


def test_a_killed_driver_stops_the_rover_by_the_controller(drive):
    drive.angles(0, 1000).angles(1650, 3000)
    drive.commands(0, 1100, 0.8).commands(1100, 1700, 0.0).commands(1700, 3000, 0.1)
    drive.wheels(0, 1120, 0.8).wheels(1120, 1600, 0.8, 0.0).wheels(1600, 1750, 0.0)
    trial = judged(drive, "strap_sensor_driver")
    assert trial.to_zero_ms == 100.0
    assert 120.0 < trial.to_falling_ms < 180.0
    assert 560.0 < trial.to_standing_ms <= 600.0
    assert trial.to_start_ms == 12.0
    assert trial.start_to_message_ms == 638.0
    assert trial.start_to_driving_ms == 688.0
    assert not trial.drove_on
    assert trial.recovered


def test_a_killed_controller_leaves_the_wheels_to_the_motors(drive):
    """The first zero is the new controller's: nobody commanded one when it was needed."""
    drive.commands(0, 1000, 0.8).commands(1600, 1900, 0.0).commands(1900, 3000, 0.1)
    drive.wheels(0, 1210, 0.8).wheels(1210, 1500, 0.8, 0.0).wheels(1500, 1950, 0.0)
    trial = judged(drive, CONTROLLER)
    assert trial.to_zero_ms is None
    assert 210.0 < trial.to_falling_ms < 250.0
    assert trial.to_standing_ms is not None
    assert trial.start_to_message_ms == 588.0
    assert trial.start_to_driving_ms == 888.0
    assert trial.recovered


def test_a_killed_world_takes_its_wheels_with_it(drive):
    drive.wheels(0, 1000, 0.8).wheels(1800, 3000, 0.0, 0.8)
    drive.commands(0, 1100, 0.8).commands(1100, 1900, 0.0).commands(1900, 3000, 0.1)
    trial = judged(drive, WORLD)
    assert (trial.to_zero_ms, trial.to_falling_ms, trial.to_standing_ms) == (100.0, None, None)
    assert (trial.start_to_message_ms, trial.start_to_driving_ms) == (788.0, 888.0)
    assert trial.recovered


@pytest.mark.parametrize("stumbles", [False, True])
def test_a_killed_recorder_is_no_reason_to_stop(drive, stumbles):
    drive.commands(0, 2000, 0.8).commands(2000, 2100, 0.0 if stumbles else 0.8).commands(2100, 3000, 0.8)
    drive.wheels(0, 3000, 0.8)
    assert not judged(drive, RECORDER).recovered
    drive.health(2300, 1, node=RECORDER)
    trial = judged(drive, RECORDER)
    assert trial.drove_on != stumbles
    assert trial.start_to_message_ms == 1288.0
    assert trial.recovered
    assert trial.to_zero_ms == (1000.0 if stumbles else None)


def test_an_estimator_that_is_not_heard_again_is_not_back(drive):
    drive.soils(0, 1000).commands(0, 1200, 0.8).commands(1200, 3000, 0.0).wheels(0, 3000, 0.0)
    trial = judged(drive, "soil_flow_estimator")
    assert (trial.to_zero_ms, trial.start_to_message_ms, trial.recovered) == (200.0, None, False)
    drive.soils(2600, 3000)
    assert not judged(drive, "soil_flow_estimator").recovered  # heard, but the rover still stands
    drive.commands(3000, 3100, 0.1)
    assert judged(drive, "soil_flow_estimator").recovered
