"""The player as a process: `strap_rover bag play` and the node, heard by others, stopped, refused."""

import signal

import pytest
from rclpy.node import Node
from rclpy.qos import HistoryPolicy
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from missions.lockstep import LockstepGraph
from missions.plan import plan_run
from strap_rover import topics
from strap_rover.flight_recorder.bag_reader import iterate_messages, read_bag_summary
from strap_rover.ros_shell.qos import message_class, qos_profile

pytestmark = pytest.mark.ros


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """The bag of two seconds of mars_snag, made in lockstep: its times begin near zero."""
    bag = tmp_path_factory.mktemp("demo") / "bag"
    plan = plan_run("mars_snag", duration_s=2.0)
    with LockstepGraph(plan, bag) as graph:
        for _ in range(plan.cycles):
            graph.step()
    return bag


@pytest.fixture
def listen(ros_context):
    """Raw subscriptions to rows of the contract; call what it gives to get what has come so far, by topic."""
    node = Node("listener", context=ros_context, use_global_arguments=False, enable_rosout=False)

    def subscribe(*rows):
        taps = {}
        for row in rows:
            profile = qos_profile(row.delivery)
            profile.history, profile.depth = HistoryPolicy.KEEP_LAST, 5000
            message_type = message_class(row.type_name)
            name = "/" + row.name.lstrip("/")
            taps[name] = node.create_subscription(message_type, row.name, print, profile, raw=True), message_type, []

        def heard():
            for subscription, message_type, messages in taps.values():
                with subscription.handle:
                    while (taken := subscription.handle.take_message(message_type, True)) is not None:
                        messages.append(taken[0])
            return {name: messages for name, (_, _, messages) in taps.items()}

        return heard

    yield subscribe
    node.destroy_node()


def test_a_listener_gets_the_recorded_bytes(strap_rover_command, run, listen, wait_until):
    """Of topics that are sent reliably: the others may lose their first messages until everybody knows of everybody."""
    rows = (topics.CMD_VEL, topics.SOIL_STATE, topics.TRACTION_COMMANDS)
    heard = listen(*rows)
    names = [row.name for row in rows]
    child = strap_rover_command("bag", "play", run, "--topics", *names, "--rate", 2, "--wait", 30)
    recorded = {f"/{name}": [m.data for m in iterate_messages(run, [f"/{name}"])] for name in names}
    child.wait_until(lambda: heard() == recorded)
    code, out, err = child.wait()
    assert (code, err) == (0, "")
    assert heard() == recorded
    assert sorted(len(messages) for messages in recorded.values()) == [20, 100, 200]
    assert out.splitlines()[-1].startswith("played 320 messages, at most ")


def test_the_estimator_lives_in_bag_time(start, run, listen, wait_until):
    """The soil state the estimator process makes of the recorded inputs is stamped with the bag's times."""
    heard = listen(topics.SOIL_STATE)
    arguments = ("--ros-args", "-p", "use_sim_time:=true")
    estimator = start("-m", "missions.node_processes", "soil_flow_estimator", *arguments)
    played = ("strap/contact_angles", "wheel_states", "odom", "imu", "suspension")
    arguments = ("--ros-args", "-p", f"bag:={run}", "-p", f"topics:={list(played)}", "-p", "wait_s:=60.0")
    code, out, err = start("-m", "missions.node_processes", "player", *arguments).wait(120.0)
    assert (code, out) == (0, "")
    assert "nobody listens" not in err
    assert "somebody else publishes" not in err  # a second graph in this domain would spoil what follows
    estimator.process.send_signal(signal.SIGINT)
    assert estimator.wait()[0] == 0
    states = [deserialize_message(data, JointState) for data in heard()["/soil_state"]]
    stamps = [state.header.stamp.sec + state.header.stamp.nanosec * 1e-9 for state in states]
    assert len(stamps) > 10  # its first second may be lost while both find each other
    assert stamps == sorted(stamps)
    assert stamps[0] >= 0.0
    assert stamps[-1] <= read_bag_summary(run).last_ns * 1e-9 + 0.01


@pytest.mark.parametrize(
    ("signals", "executor"),
    [((signal.SIGINT,), "single"), ((signal.SIGINT, signal.SIGINT), "events"), ((signal.SIGTERM,), "single")],
    ids=["int", "int_int_events", "term"],
)
def test_a_signal_ends_the_node_with_0_and_the_summary(start, run, signals, executor):
    arguments = ["--executor", executor, "--ros-args", "-p", f"bag:={run}", "-p", "wait_s:=0.0", "-p", "loop:=true"]
    child = start("-m", "missions.node_processes", "player", *arguments)
    child.wait_until(lambda: "from the start again" in child.err)
    for number in signals:
        child.process.send_signal(number)
    code, out, err = child.wait()
    assert (code, out) == (0, "")
    assert "Traceback" not in err
    last = err.splitlines()[-1]
    assert last.startswith("played ")
    assert "stopped at" in last


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=["int", "term"])
def test_a_signal_ends_the_command_with_130_and_the_summary(strap_rover_command, run, number):
    child = strap_rover_command("bag", "play", run, "--wait", 60)
    child.wait_until(lambda: "waiting up to 60 s" in child.out)
    child.process.send_signal(number)
    code, out, err = child.wait()
    assert (code, err) == (130, "")
    assert out.splitlines()[-1].startswith("played 0 messages, stopped at 0.00 s")


def test_the_node_refuses_in_one_line_each(start, run, tmp_path):
    (whole,) = run.glob("*.mcap")
    (tmp_path / "cut.mcap").write_bytes(whole.read_bytes()[:50_000])
    content = bytearray(whole.read_bytes())
    content[len(content) // 2] ^= 0xFF
    (tmp_path / "damaged.mcap").write_bytes(content)
    rate = ("-p", "rate:=0.0", "-p", "wait_s:=0.0")
    for bag, more, code, said in (
        (tmp_path / "nowhere", (), 2, "no such bag; give the directory of a bag or an .mcap file"),
        (tmp_path / "cut.mcap", (), 2, "is cut off"),
        (tmp_path / "damaged.mcap", rate, 3, "; played only "),
        (run, ("-p", "rate:=-1.0"), 2, "rate: -1.0 is out of range"),
        (run, ("-p", "topics:=['nope']"), 2, "topics: no 'nope' in"),
        (run, ("-p", "start_offset_s:=7.5"), 2, "start 7.5 s: the last message to play"),
    ):
        child = start("-m", "missions.node_processes", "player", "--ros-args", "-p", f"bag:={bag}", *more)
        assert child.wait()[:2] == (code, "")
        assert "Traceback" not in child.err
        complaint = [line for line in child.err.splitlines() if not line.startswith(("[", "played "))]
        assert len(complaint) == 1
        assert said in complaint[0]
