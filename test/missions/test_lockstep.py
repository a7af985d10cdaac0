"""The run through the real nodes: equal to the run without ROS, equal to itself, and loud when a message is lost."""

import os
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rclpy
from std_msgs.msg import Empty

import strap_rover
from missions import lockstep
from missions.core_run import run_cores
from missions.lockstep import LockstepError, LockstepGraph, run_lockstep
from missions.plan import plan_run
from missions.summary import summarize
from strap_rover.flight_recorder.bag_reader import iterate_messages, read_bag_summary
from strap_rover.flight_recorder.canonical import compare_bags
from strap_rover.ros_shell.qos import qos_profile
from strap_rover.topics import WHEEL_COMMANDS

pytestmark = pytest.mark.ros
ROOT = str(Path(strap_rover.__file__).resolve().parents[1])


def assert_same_log(through_nodes, through_cores):
    """Every number of every series is the same number, not a near one.

    The records map bit for bit to messages, both runs call the same cores in the same order, and the barriers take
    timing out of it. A tolerance would hide a message taken a period late, which moves the numbers little.
    """
    assert through_nodes.wheels == through_cores.wheels
    assert through_nodes.series.keys() == through_cores.series.keys()
    for name, series in through_nodes.series.items():
        expected = through_cores.series[name]
        assert series.stamp_ns.size > 10, name
        np.testing.assert_array_equal(series.stamp_ns, expected.stamp_ns, err_msg=name)
        np.testing.assert_array_equal(series.per_wheel, expected.per_wheel, err_msg=name)
        np.testing.assert_array_equal(series.whole_rover, expected.whole_rover, err_msg=name)


def test_nodes_and_cores_agree_through_stall_wait_and_retry(recorded):
    cores = run_cores(recorded.plan)
    summary = summarize(recorded.plan, cores)
    what = [event.what for event in summary.events]
    wanted = ["snag of 600 N catches", "STALL", "WAIT", "RETRY", "snag lets go", "DRIVE"]
    assert what == wanted  # otherwise the comparison says little
    assert_same_log(recorded.log, cores)


@pytest.mark.parametrize(
    ("scenario", "controller", "duration_s"),
    [("single_wheel", "soil_flow", 2.5), ("composite", "slip_limit", 3.0)],
)
def test_nodes_and_cores_agree_in_named_scenarios(make_recording, scenario, controller, duration_s):
    run = make_recording(plan_run(scenario, controller, seed=3, duration_s=duration_s))
    assert_same_log(run.log, run_cores(run.plan))


def test_nodes_and_cores_agree_on_a_baseline_with_other_settings(make_plan, make_recording):
    plan = make_plan("constant", seed=1, duration_s=4.0)
    plan = replace(plan, world=replace(plan.world, encoder_step_rad=0.01, adc_noise_lsb=2.0))
    run = make_recording(plan)
    assert_same_log(run.log, run_cores(plan))


def test_the_same_seed_gives_the_same_bag_and_summary(recorded, demonstrated):
    comparison = compare_bags(recorded.bag, demonstrated.result.folder / "bag")
    assert comparison.equal, comparison.differing
    assert all(row.count_a == row.count_b > 0 and row.equal_log_times for row in comparison.topics)
    assert summarize(recorded.plan, recorded.log) == demonstrated.result.summary
    custom = [read_bag_summary(bag).custom_data for bag in (recorded.bag, demonstrated.result.folder / "bag")]
    assert custom[0] == custom[1]


def test_another_seed_gives_other_readings(make_plan, make_recording, recorded):
    other = make_recording(make_plan(seed=1, duration_s=0.5))
    differing = {row.name: row for row in compare_bags(recorded.bag, other.bag).differing}
    for name in ("/strap/raw", "/strap/contact_angles", "/wheel_states", "/odom", "/imu"):
        assert differing[name].first_difference < differing[name].count_b // 2, name  # not merely shorter
    assert differing["/clock"].first_difference == differing["/clock"].count_b  # only shorter


def test_without_a_bag_nothing_is_recorded(make_plan):
    assert run_lockstep(make_plan(duration_s=0.1), None) == 10


def test_progress_is_told_the_cycles_done(make_plan, tmp_path):
    told = []
    assert run_lockstep(make_plan(duration_s=0.35), tmp_path / "bag", told.append) == 35
    assert told == [10, 20, 30]


def test_a_graph_may_be_closed_twice(make_plan, tmp_path):
    graph = LockstepGraph(make_plan(duration_s=0.1), tmp_path / "bag")
    graph.step()
    graph.close()
    graph.close()
    assert read_bag_summary(tmp_path / "bag").message_count > 10


def test_a_run_that_is_stopped_keeps_what_is_done(make_plan, tmp_path):
    asked = []

    def stopped():
        asked.append(True)
        return len(asked) > 20

    assert run_lockstep(make_plan(), tmp_path / "bag", None, stopped) == 20
    summary = read_bag_summary(tmp_path / "bag")
    assert summary.topic("/clock").message_count == summary.topic("/wheel_commands").message_count == 20


def test_an_error_on_the_way_closes_the_bag(make_plan, tmp_path):
    def fail(done):
        raise RuntimeError(f"after {done}")

    with pytest.raises(RuntimeError, match="after 10"):
        run_lockstep(make_plan(), tmp_path / "bag", fail)
    assert read_bag_summary(tmp_path / "bag").topic("/clock").message_count == 10


def test_a_message_that_never_arrives_ends_the_run_with_topic_node_and_counts(make_plan, tmp_path, monkeypatch):
    monkeypatch.setattr(lockstep, "BARRIER_TIMEOUT_S", 0.3)
    with LockstepGraph(make_plan(), tmp_path / "bag") as graph:
        for _ in range(4):
            graph.step()
        graph.driver.published["strap/contact_angles"] += 1  # as if one had been sent and lost
        with pytest.raises(LockstepError) as caught:
            graph.step()
        already = graph.controller.received["strap/contact_angles"]
    text = str(caught.value)
    for node in ("soil_flow_estimator", "traction_controller"):
        assert f"strap/contact_angles to {node}: {already} of {already + 1}" in text
    assert sum(1 for _ in iterate_messages(tmp_path / "bag")) > 20  # the bag is closed and whole


def test_messages_that_did_arrive_are_not_called_missing(make_plan, monkeypatch):
    monkeypatch.setattr(lockstep, "BARRIER_TIMEOUT_S", 0.3)
    with LockstepGraph(make_plan(), None) as graph:
        graph.driver.published["strap/contact_angles"] += 1
        with pytest.raises(LockstepError) as caught:
            graph.step()
    assert "strap/contact_angles" in str(caught.value)
    assert "wheel_states" not in str(caught.value)


def test_a_message_the_recorder_misses_ends_the_run(make_plan, tmp_path, monkeypatch):
    monkeypatch.setattr(lockstep, "BARRIER_TIMEOUT_S", 0.3)
    with LockstepGraph(make_plan(), tmp_path / "bag") as graph:
        graph.step()
        graph.operator.published["cmd_vel"] += 1
        graph.controller.received["cmd_vel"] += 1  # only the recorder has not had it
        with pytest.raises(LockstepError, match=r"recorder.*cmd_vel.*\b1 of 2\b"):
            graph.step()


def test_a_graph_that_does_not_come_together_says_who_waits_for_what(make_plan, monkeypatch):
    monkeypatch.setattr(lockstep, "BARRIER_TIMEOUT_S", 0.3)
    monkeypatch.setattr(lockstep.Operator, "subscription_counts", lambda _: {"cmd_vel": 0})
    with pytest.raises(LockstepError, match="operator announces cmd_vel: 0 of 1 found"):
        LockstepGraph(make_plan(), None)


STRANGER = """
import sys, threading
import rclpy
from std_msgs.msg import Empty, Float64MultiArray
from strap_rover.ros_shell.qos import qos_profile
from strap_rover.topics import WHEEL_COMMANDS

rclpy.init()
node, heard = rclpy.create_node("stranger"), []
profile = qos_profile(WHEEL_COMMANDS.delivery)
node.create_subscription(Float64MultiArray, WHEEL_COMMANDS.name, lambda _: heard.append("command"), profile)
node.create_subscription(Empty, "stranger_test", lambda _: heard.append("control"), profile)
threading.Thread(target=lambda: (sys.stdin.read(), rclpy.shutdown()), daemon=True).start()
print("ready", flush=True)
try:
    while rclpy.ok():
        rclpy.spin_once(node, timeout_sec=0.1)
        if heard[-1:] == ["control"] and heard.count("control") == 1:
            print("control", flush=True)
except Exception:
    if rclpy.ok():
        raise
print(heard.count("command"), flush=True)
"""


def test_nobody_outside_hears_the_commands_of_a_lockstep_run(make_plan):
    """A simulated run must never move a real rover on the same domain of the same machine."""
    with LockstepGraph(make_plan(), None) as graph:
        domain = graph._context.get_domain_id()
        with subprocess.Popen(
            [sys.executable, "-c", STRANGER],
            env=os.environ | {"ROS_DOMAIN_ID": str(domain), "PYTHONPATH": ROOT},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        ) as stranger:
            assert stranger.stdout.readline() == "ready\n"
            context = rclpy.Context()
            rclpy.init(args=[], context=context, domain_id=domain)
            try:
                profile = qos_profile(WHEEL_COMMANDS.delivery)
                talker = rclpy.create_node("talker", context=context).create_publisher(Empty, "stranger_test", profile)
                told = threading.Event()
                threading.Thread(
                    target=lambda: told.set() if stranger.stdout.readline() == "control\n" else None, daemon=True
                ).start()
                deadline = time.monotonic() + 15.0
                after = 0
                while after < 50:  # on for half a second after it is known not to be deaf
                    assert time.monotonic() < deadline, "the stranger does not even hear the control message"
                    graph.step()
                    talker.publish(Empty())
                    after += told.is_set()
                    time.sleep(0.01)
            finally:
                context.try_shutdown()
            out, _ = stranger.communicate("", timeout=20.0)
        assert out.split()[-1] == "0"
        assert graph.published()[WHEEL_COMMANDS.name] >= 50


def test_the_discovery_range_of_the_process_is_left_as_it_was(make_plan, monkeypatch):
    with LockstepGraph(make_plan(), None):
        assert os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"
    monkeypatch.delenv("ROS_AUTOMATIC_DISCOVERY_RANGE")
    with LockstepGraph(make_plan(), None):
        assert "ROS_AUTOMATIC_DISCOVERY_RANGE" not in os.environ
