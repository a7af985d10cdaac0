from dataclasses import fields, replace

import pytest

from strap_rover.installed_data import config_file
from strap_rover.rover import load_rover
from strap_rover.settings import SettingsError, load_settings, settings_from_mapping
from strap_sensor_driver.calibration import EndCalibration, StrapCalibration
from strap_sensor_driver.calibration_file import rover_calibration, write_calibration
from strap_sensor_driver.end_curve import EndCurve
from strap_sensor_driver.parameters import StrapDriverParameters, bind_straps, load_calibration, port_paths
from strap_sensor_driver.reader_settings import StrapReaderSettings


def test_the_shipped_file_says_every_parameter_at_its_default():
    assert (
        load_settings(StrapDriverParameters, config_file("strap_sensor_driver.yaml"), "strap_sensor_driver")
        == StrapDriverParameters()
    )


def test_the_node_adds_rover_and_port_to_the_core_s_settings_and_nothing_else():
    added = {item.name for item in fields(StrapDriverParameters)} - {item.name for item in fields(StrapReaderSettings)}
    assert added == {"rover", "port", "calibration"}
    assert isinstance(StrapDriverParameters(), StrapReaderSettings)


def test_every_parameter_says_what_it_is():
    for item in fields(StrapDriverParameters):
        assert len(item.metadata["doc"]) > 5, item.name


def test_the_core_s_own_checks_hold_for_the_node_too():
    low = next(item for item in fields(StrapDriverParameters) if item.metadata.get("min", -1.0) >= 0.0)
    with pytest.raises(SettingsError, match=f"p.yaml: {low.name}: -1.* is out of range"):
        settings_from_mapping(StrapDriverParameters, {low.name: type(low.default)(-1)}, "p.yaml")


def test_wheels_are_bound_to_the_boards_and_channels_of_the_rover():
    rover = load_rover("curiosity")
    settings = StrapDriverParameters(resistance_std_ratio=0.01)
    bindings = bind_straps(rover, settings)
    assert [binding.wheel for binding in bindings] == list(range(6))
    for binding, wheel in zip(bindings, rover.wheels, strict=True):
        assert (binding.board_id, binding.channel) == (wheel.board, wheel.channel)
        assert (binding.mounting.offset_rad, binding.mounting.direction) == (
            wheel.strap_offset_rad,
            wheel.strap_direction,
        )
        assert binding.strap == settings.strap()
    assert len({(binding.board_id, binding.channel) for binding in bindings}) == 6


def test_a_port_for_each_board():
    assert port_paths("/dev/uno_{board}", (1, 2)) == {1: "/dev/uno_1", 2: "/dev/uno_2"}
    assert port_paths("/dev/ttyACM0", (7,)) == {7: "/dev/ttyACM0"}


@pytest.mark.parametrize("pattern", ["/dev/ttyACM0", "/dev/{side}", "/dev/{", "/dev/{}"])
def test_a_pattern_that_names_no_port_for_each_is_refused(pattern):
    with pytest.raises(SettingsError, match="port: "):
        port_paths(pattern, (1, 2))


# --- calibrated straps ----------------------------------------------------------------------------------------------

CURIOSITY = load_rover("curiosity")
END = EndCalibration(450e3, 0.5, 0.999, (400.0, 4e5, 8e5), (0.0, 3.0, 6.28), (0.001, 0.002, 0.003), 0.004)
OTHER_END = replace(END, pull_down_ohm=460e3)


def strap(wheel="fl", **more):
    its = next((one for one in CURIOSITY.wheels if one.name == wheel), CURIOSITY.wheels[0])
    known = StrapCalibration(
        wheel, its.board, its.channel, "bench", "2026-05-01T10:00:00Z", "1.0", 18, 0.7, END, OTHER_END
    )
    return replace(known, **more)


def file_of(tmp_path, *straps, rover="curiosity"):
    path = tmp_path / "straps.yaml"
    write_calibration(path, rover_calibration(rover, straps))
    return StrapDriverParameters(calibration=str(path))


def test_without_a_file_nothing_is_calibrated():
    assert load_calibration(CURIOSITY, StrapDriverParameters()) is None
    assert all(binding.calibration is None for binding in bind_straps(CURIOSITY, StrapDriverParameters()))


def test_a_calibrated_strap_is_bound_to_its_wheel_and_the_others_stay_nominal(tmp_path):
    settings = file_of(tmp_path, strap("rl"), strap("mr", noise_lsb=1.5))
    calibration = load_calibration(CURIOSITY, settings)
    assert calibration is not None
    bindings = dict(zip(CURIOSITY.wheel_names, bind_straps(CURIOSITY, settings, calibration), strict=True))
    known = {wheel: binding.calibration for wheel, binding in bindings.items() if binding.calibration is not None}
    assert known == {"rl": strap("rl"), "mr": strap("mr", noise_lsb=1.5)}
    limits = bindings["rl"].limits(settings)
    assert (limits.curve_a, limits.curve_b) == (END.curve(), OTHER_END.curve())
    assert limits.seam_a_v < settings.seam_level * settings.supply_v  # contact and lead count
    nominal = settings.strap()
    uniform = EndCurve.uniform(nominal.total_resistance_ohm / nominal.pull_down_a_ohm)
    assert bindings["fl"].limits(settings).curve_a == uniform


def test_an_uneven_layer_widens_the_table_of_a_nominal_strap_only(tmp_path):
    settings = replace(file_of(tmp_path, strap("fl")), resistance_std_ratio=0.05)
    bindings = bind_straps(CURIOSITY, settings, load_calibration(CURIOSITY, settings))
    assert bindings[0].limits(settings).curve_a == END.curve()
    assert max(bindings[1].limits(settings).curve_a.arc_std_rad) > 0.03


@pytest.mark.parametrize(
    ("straps", "rover", "says"),
    [
        ((strap(),), "other", r"is of rover 'other', not 'curiosity': give that rover's, or calibrate"),
        ((strap(board=9),), "curiosity", r"wheel 'fl' was calibrated on board 9 channel 0, which now reads no wheel"),
        (
            (strap(wheel="nose"),),
            "curiosity",
            r"wheel 'nose' .* board 1 channel 0, which now reads wheel 'fl': put the leads",
        ),
        (
            (replace(strap("fl"), channel=strap("ml").channel), strap("rl")),
            "curiosity",
            r"wheel 'fl' .* which now reads wheel 'ml': put the leads back, or calibrate the wheel again",
        ),
    ],
)
def test_a_calibration_of_another_rover_board_or_wheel_is_refused_with_the_remedy(tmp_path, straps, rover, says):
    settings = file_of(tmp_path, *straps, rover=rover)
    with pytest.raises(SettingsError, match=says) as refused:
        load_calibration(CURIOSITY, settings)
    assert all(problem.startswith(f"{settings.calibration}: ") for problem in refused.value.problems)
    assert len(refused.value.problems) == 1


def test_every_wheel_that_does_not_fit_is_named(tmp_path):
    fl, ml = strap("fl"), strap("ml")
    swapped = (replace(fl, channel=ml.channel), replace(ml, channel=fl.channel))
    with pytest.raises(SettingsError) as refused:
        load_calibration(CURIOSITY, file_of(tmp_path, *swapped))
    assert len(refused.value.problems) == 2


def test_a_file_that_is_missing_or_no_calibration_is_refused(tmp_path):
    with pytest.raises(SettingsError, match=r"gone\.yaml"):
        load_calibration(CURIOSITY, StrapDriverParameters(calibration=str(tmp_path / "gone.yaml")))
    path = tmp_path / "list.yaml"
    path.write_text("[1, 2]")
    with pytest.raises(SettingsError, match="make one with `strap_rover calibrate`"):
        load_calibration(CURIOSITY, StrapDriverParameters(calibration=str(path)))


def test_second_straps_are_bound_after_the_first_ones_with_their_own_calibration(tmp_path):
    rover = load_rover("curiosity_two_straps")
    first, second = ([one for one in rover.strap_inputs if one.is_second == is_second] for is_second in (False, True))
    wheel = rover.wheels[second[0].wheel_index].name
    known = strap(board=second[0].board, channel=second[0].channel)
    settings = file_of(tmp_path, replace(known, wheel=wheel), rover=rover.name)
    bindings = bind_straps(rover, settings, load_calibration(rover, settings))
    assert [binding.wheel for binding in bindings] == [one.wheel_index for one in (*first, *second)]
    calibrated = [index for index, binding in enumerate(bindings) if binding.calibration is not None]
    assert calibrated == [len(first)]
    apart = bindings[len(first)].mounting.offset_rad - bindings[second[0].wheel_index].mounting.offset_rad
    assert apart == pytest.approx(rover.wheels[second[0].wheel_index].second_strap_shift_rad)
