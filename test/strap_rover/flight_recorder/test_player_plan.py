import dataclasses

import pytest

from strap_rover import topics
from strap_rover.flight_recorder.bag_format import BagError, BagTopic, contract_topic
from strap_rover.flight_recorder.bag_reader import iterate_messages
from strap_rover.flight_recorder.bag_writer import BagWriter
from strap_rover.flight_recorder.player_plan import INPUTS, contract_row, plan_playing
from strap_rover.flight_recorder.player_settings import PlayerSettings
from strap_rover.settings import SettingsError

MS = 1_000_000


@pytest.fixture
def make_bag(tmp_path, samples):
    """A bag of (topic, log time) with the content depending on the place; the topics are rows, or rows with a name."""

    def make(directory, messages, bag_topics=(), file=None, **keywords):
        bag_topics = bag_topics or tuple(contract_topic(row) for row in topics.CONTRACT)
        types = {topic.name: topic.type_name for topic in bag_topics}
        with BagWriter(tmp_path / directory, bag_topics, **keywords) as writer:
            for number, (name, time_ns) in enumerate(messages):
                writer.write(name, samples.serialised(types[name], number), time_ns, time_ns)
        return tmp_path / directory

    return make


def names(plan):
    return [topic.name for topic in plan.topics]


def test_the_inputs_of_estimator_and_controller_are_played_and_nothing_they_make(make_bag, bag):
    assert {row.publisher for row in INPUTS}.isdisjoint({"soil_flow_estimator", "traction_controller"})
    plan = plan_playing(PlayerSettings(str(bag)))
    assert names(plan) == ["/wheel_states", "/cmd_vel"]
    assert plan.warnings == ("the bag has no messages of strap/contact_angles, odom, imu, suspension",)
    assert [m.data for m in plan.messages()] == [m.data for m in iterate_messages(bag, ["/wheel_states", "/cmd_vel"])]
    assert (plan.start_ns, plan.end_ns, plan.bag_start_ns) == (0, 1970 * MS, 0)
    assert plan.duration_s == 1.97


def test_topics_by_name_with_or_without_the_slash(bag):
    plan = plan_playing(PlayerSettings(str(bag), topics=("strap/raw", "/wheel_states", "strap/raw")))
    assert names(plan) == ["/wheel_states", "/strap/raw"]
    assert plan.warnings == ()


def test_wheel_commands_are_played_on_demand_only_and_with_a_warning(bag):
    for asked in (("wheel_commands",), ("all",), ("/wheel_commands", "cmd_vel")):
        plan = plan_playing(PlayerSettings(str(bag), topics=asked))
        assert "/wheel_commands" in names(plan)
        (warning,) = plan.warnings
        assert warning.startswith("/wheel_commands is played: any rover that listens will drive")


def test_a_recorded_namespace_is_found_by_relative_names(make_bag):
    rows = (topics.ODOM, topics.CMD_VEL, topics.WHEEL_COMMANDS)
    named = tuple(contract_topic(row, f"/rover_1/{row.name}") for row in rows)
    sent = [("/rover_1/cmd_vel", MS), ("/rover_1/wheel_commands", 2 * MS)]
    run = make_bag("run", sent, named)
    assert names(plan_playing(PlayerSettings(str(run)))) == ["/rover_1/cmd_vel"]
    assert names(plan_playing(PlayerSettings(str(run), topics=("cmd_vel",)))) == ["/rover_1/cmd_vel"]
    everything = plan_playing(PlayerSettings(str(run), topics=("all",)))
    assert "/rover_1/wheel_commands is played" in everything.warnings[0]
    with pytest.raises(SettingsError, match=r"no '/cmd_vel' in .*; it has /rover_1/odom, /rover_1/cmd_vel"):
        plan_playing(PlayerSettings(str(run), topics=("/cmd_vel",)))


def test_a_topic_in_the_root_goes_before_its_namesake(make_bag):
    named = (contract_topic(topics.CMD_VEL), contract_topic(topics.CMD_VEL, "/other/cmd_vel"))
    run = make_bag("run", [("/other/cmd_vel", 1), ("/cmd_vel", 2)], named)
    assert names(plan_playing(PlayerSettings(str(run), topics=("cmd_vel",)))) == ["/cmd_vel"]


def test_contract_rows_by_full_name():
    assert contract_row("/strap/raw") is topics.STRAP_RAW
    assert contract_row("/clock") is topics.CLOCK
    assert contract_row("/rover_1/strap/raw") is topics.STRAP_RAW
    assert contract_row("/rover_1/clock") is None
    assert contract_row("/odometry") is None
    assert contract_row("/wodom") is None


def test_the_clock_of_the_bag_gives_way_to_the_players_own(make_bag, bag):
    rows = (contract_topic(topics.CLOCK), contract_topic(topics.CMD_VEL))
    with BagWriter(bag.parent / "clocked", rows) as writer:
        writer.write("/clock", b"\x00\x01\x00\x00" + bytes(8), 0, 0)
        writer.write("/cmd_vel", bytes(8), 5, 5)
    run = str(bag.parent / "clocked")
    assert names(plan_playing(PlayerSettings(run, topics=("all",)))) == ["/cmd_vel"]
    asked = plan_playing(PlayerSettings(run, topics=("clock", "cmd_vel")))
    assert (names(asked), asked.warnings) == (
        ["/cmd_vel"],
        ("/clock of the bag is not played: the player sends its own",),
    )
    assert names(plan_playing(PlayerSettings(run, topics=("all",), clock=False))) == ["/clock", "/cmd_vel"]


def test_unknown_topics_are_named_each_with_those_there_are(bag):
    with pytest.raises(SettingsError) as caught:
        plan_playing(PlayerSettings(str(bag), topics=("odom", "cmd_vel", "/foo")))
    there = "/wheel_states, /cmd_vel, /wheel_commands, /strap/raw"
    assert caught.value.problems == (
        f"topics: no 'odom' in {bag}; it has {there}",
        f"topics: no '/foo' in {bag}; it has {there}",
    )


def test_a_bag_without_any_message_to_play_is_refused(make_bag):
    run = make_bag("run", [("/strap/raw", 1)])
    with pytest.raises(BagError, match=r"none of the topics to play has a message; name topics; it has /strap/raw$"):
        plan_playing(PlayerSettings(str(run)))
    empty = make_bag("empty", [])
    with pytest.raises(BagError, match=r"it has no messages at all$"):
        plan_playing(PlayerSettings(str(empty)))


def test_the_start_counts_from_the_bags_first_message(make_bag):
    run = make_bag("run", [("/strap/raw", 1_000 * MS), ("/cmd_vel", 3_000 * MS), ("/cmd_vel", 5_000 * MS)])
    plan = plan_playing(PlayerSettings(str(run), start_offset_s=2.5))
    assert (plan.bag_start_ns, plan.start_ns, plan.end_ns) == (1_000 * MS, 3_500 * MS, 5_000 * MS)
    assert [m.log_time_ns for m in plan.messages()] == [5_000 * MS]
    assert len(list(plan_playing(PlayerSettings(str(run), start_offset_s=4.0)).messages())) == 1  # the very last one
    with pytest.raises(SettingsError, match=r"start 4.001 s: the last message to play in .* is at 4.000 s"):
        plan_playing(PlayerSettings(str(run), start_offset_s=4.001))


def test_a_type_that_is_not_installed_is_refused_with_its_topic(make_bag, samples):
    exotic = BagTopic("/scan", "exotic_msgs/msg/Scan")
    known = contract_topic(topics.CMD_VEL)
    with BagWriter(
        make_bag("x", []).parent / "run", (known, exotic), definitions={exotic.type_name: "int32 x"}
    ) as writer:
        writer.write("/scan", bytes(8), 1, 1)
        writer.write("/cmd_vel", samples.serialised(known.type_name, 1), 2, 2)
        run = str(writer.directory)
    with pytest.raises(BagError) as caught:
        plan_playing(PlayerSettings(run, topics=("all",)))
    assert str(caught.value) == (
        f"{run}: /scan is of type 'exotic_msgs/msg/Scan': message type is not installed; "
        "install it, or name the topics to play without it"
    )
    assert names(plan_playing(PlayerSettings(run))) == ["/cmd_vel"]  # what is not played need not be known


def test_another_version_of_a_type_is_refused(make_bag):
    stale = dataclasses.replace(contract_topic(topics.CMD_VEL), type_hash="RIHS01_" + 64 * "0")
    run = make_bag("run", [("/cmd_vel", 1)], (stale,))
    with pytest.raises(BagError, match=r"/cmd_vel was recorded with another version of geometry_msgs/msg/TwistStamped"):
        plan_playing(PlayerSettings(str(run)))


def test_no_bag_and_a_cut_off_bag_are_refused_before_anything_is_played(bag, tmp_path):
    with pytest.raises(BagError, match="no such bag"):
        plan_playing(PlayerSettings(str(tmp_path / "nowhere")))
    (file,) = bag.glob("*.mcap")
    file.write_bytes(file.read_bytes()[:-500])
    with pytest.raises(BagError, match="is cut off"):
        plan_playing(PlayerSettings(str(bag)))


def files_of(make_bag, tmp_path, **parts):
    """One bag of several files, as they lie side by side in a folder; name -> log times [ms] of cmd_vel."""
    folder = tmp_path / "joined"
    folder.mkdir()
    for name, times in parts.items():
        run = make_bag(name, [("/cmd_vel", time * MS) for time in times])
        (run / f"{name}_0.mcap").rename(folder / f"{name}.mcap")
    return folder


def played_ms(folder, **settings):
    return [m.log_time_ns // MS for m in plan_playing(PlayerSettings(str(folder), **settings)).messages()]


def test_files_that_overlap_are_merged_by_log_time(make_bag, tmp_path):
    folder = files_of(make_bag, tmp_path, a=(10, 20, 30), b=(25, 35, 40), c=(40, 50), d=(5, 15))
    assert played_ms(folder) == [5, 10, 15, 20, 25, 30, 35, 40, 40, 50]
    groups = plan_playing(PlayerSettings(str(folder))).groups
    assert [[file.stem for file in group] for group in groups] == [["d", "a", "b"], ["c"]]


def test_files_before_the_start_are_not_even_opened(make_bag, tmp_path):
    folder = files_of(make_bag, tmp_path, a=(10, 20), b=(30, 40), c=(), d=(50, 60))
    plan = plan_playing(PlayerSettings(str(folder), start_offset_s=0.03))
    assert [[file.stem for file in group] for group in plan.groups] == [["b"], ["d"]]
    assert [m.log_time_ns // MS for m in plan.messages()] == [40, 50, 60]


def test_a_plan_in_a_line(bag):
    assert str(plan_playing(PlayerSettings(str(bag), rate=2.0, loop=True, topics=("cmd_vel",)))) == (
        f"playing 1.97 s of {bag} at 2 x real time, again and again: /cmd_vel"
    )
    assert "s of" in str(plan_playing(PlayerSettings(str(bag), rate=0.0)))
    assert " as fast as possible: /wheel_states, /cmd_vel" in str(plan_playing(PlayerSettings(str(bag), rate=0.0)))
