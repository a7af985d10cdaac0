"""The supervisor of the processes, with small stand-ins for the nodes: starts, deaths, ends."""

import signal
import sys
import time

import pytest
import yaml

from missions.live_graph import NODES, LiveGraph, NodeDiedError, bag_name, parameter_text
from missions.plan import plan_run
from strap_rover.settings import read_parameters_file, settings_from_mapping
from strap_sensor_driver.parameters import StrapDriverParameters

pytestmark = pytest.mark.ros
LIVES = "import signal, time; signal.signal(signal.SIGINT, lambda *_: exit(0)); print('up', flush=True); time.sleep(60)"
DEAF = "import signal, time; signal.signal(signal.SIGINT, signal.SIG_IGN); print('up', flush=True); time.sleep(60)"


@pytest.fixture
def plan():
    return plan_run("single_wheel", duration_s=1.0)


@pytest.fixture
def graph_of(tmp_path, plan):
    """A graph whose nodes are the given Python texts."""
    graphs = []

    def make(**programs):
        graph = LiveGraph(plan, tmp_path, tmp_path / "ports", nodes=tuple(programs))
        for name, program in programs.items():
            graph.nodes[name].arguments = [sys.executable, "-c", program]
        graphs.append(graph)
        return graph

    yield make
    for graph in graphs:
        graph.end()


def start(graph, wait_until, *names):
    for name in names:
        graph.start(name)
    wait_until(lambda: all("up" in graph.nodes[name].words() for name in names))


def test_nodes_run_until_they_are_ended_with_exit_code_0(graph_of, wait_until):
    graph = graph_of(recorder=LIVES, sim_bridge=LIVES)
    start(graph, wait_until, "sim_bridge", "recorder")
    assert graph.poll() == []
    assert all(node.is_running for node in graph.nodes.values())
    assert graph.end() == {"sim_bridge": 0, "recorder": 0}
    assert not any(node.is_running for node in graph.nodes.values())
    assert graph.end() == {"sim_bridge": 0, "recorder": 0}


def test_the_recorder_ends_when_all_others_have(graph_of, wait_until, tmp_path):
    mark = f"import time; open(r'{tmp_path}/ends', 'a').write('NAME\\n')"
    program = LIVES.replace("exit(0)", "finish()").replace(
        "signal.signal", f"\ndef finish():\n    {mark}\n    exit(0)\nsignal.signal", 1
    )
    graph = graph_of(**{name: program.replace("NAME", name) for name in ("recorder", "sim_bridge", "driver")})
    start(graph, wait_until, "recorder", "sim_bridge", "driver")
    graph.end()
    ends = (tmp_path / "ends").read_text(encoding="utf-8").split()
    assert sorted(ends[:2]) == ["driver", "sim_bridge"]
    assert ends[2] == "recorder"


def test_a_node_that_died_is_started_again_and_told(graph_of, wait_until):
    graph = graph_of(sim_bridge=LIVES)
    start(graph, wait_until, "sim_bridge")
    node = graph.nodes["sim_bridge"]
    first = node.process.pid
    node.process.kill()
    news = []
    wait_until(lambda: news.extend(graph.poll()) or (node.is_running and node.process.pid != first))
    assert len(news) == 1
    assert news[0].startswith("sim_bridge ended by itself, exit code -9")
    assert (node.starts, node.died, node.exit_codes) == (2, 1, [-9])


def test_a_death_that_nobody_looked_for_is_counted_in_the_end(graph_of, wait_until):
    full = "import time, sys; print('up', flush=True); time.sleep(0.2); sys.exit(3)"
    graph = graph_of(recorder=full, sim_bridge=LIVES)
    start(graph, wait_until, "recorder", "sim_bridge")
    graph.nodes["recorder"].process.wait()
    assert graph.end() == {"recorder": 3, "sim_bridge": 0}
    assert [node.died for node in graph.nodes.values()] == [1, 0]
    assert graph.end() == {"recorder": 3, "sim_bridge": 0}


def test_a_node_that_dies_again_and_again_is_given_up(graph_of, wait_until):
    graph = graph_of(sim_bridge="raise SystemExit('no world today')")

    def poll():
        graph.poll()
        time.sleep(0.02)

    graph.start("sim_bridge")
    with pytest.raises(NodeDiedError, match=r"sim_bridge ended by itself, exit code 1: no world today \(log: "):
        wait_until(lambda: False, poll)
    assert graph.nodes["sim_bridge"].starts == 4


def test_settings_that_are_refused_are_not_tried_again(graph_of, wait_until):
    graph = graph_of(sim_bridge="import sys; print('seed: too odd', flush=True); sys.exit(2)")
    graph.start("sim_bridge")
    with pytest.raises(NodeDiedError, match="exit code 2: seed: too odd"):
        wait_until(lambda: False, graph.poll)


def test_who_does_not_end_is_killed_and_said(graph_of, wait_until, monkeypatch):
    monkeypatch.setattr("missions.live_graph.END_LIMIT_S", 0.3)
    graph = graph_of(sim_bridge=DEAF, traction_controller=LIVES)
    start(graph, wait_until, "sim_bridge", "traction_controller")
    assert graph.end() == {"sim_bridge": -9, "traction_controller": 0}


def test_several_signals_can_be_sent(graph_of, wait_until):
    counting = (
        "import signal, time\nn = []\ndef take(*_):\n    n.append(1)\n    len(n) > 1 and exit(7)\n"
        "signal.signal(signal.SIGINT, take)\nprint('up', flush=True)\n"
        "while True:\n    time.sleep(0.01)\n"
    )
    graph = graph_of(sim_bridge=counting)
    start(graph, wait_until, "sim_bridge")
    node = graph.nodes["sim_bridge"]
    node.process.send_signal(signal.SIGINT)
    time.sleep(0.2)
    assert graph.end((signal.SIGINT,)) == {"sim_bridge": 7}


def test_processor_time_of_a_process_is_read(graph_of, wait_until):
    graph = graph_of(sim_bridge="print('up', flush=True)\nwhile True: pass")
    start(graph, wait_until, "sim_bridge")
    node = graph.nodes["sim_bridge"]
    wait_until(lambda: node.cpu_s() > 0.05)
    node.process.kill()
    wait_until(lambda: not node.is_running)
    assert node.cpu_s() == 0.0


def test_every_node_gets_its_settings_and_one_port_pattern(tmp_path):
    plan = plan_run("mars_snag", "slip_limit", seed=5)
    path = tmp_path / "p.yaml"
    path.write_text(parameter_text(plan, tmp_path / "ports"), encoding="utf-8")
    assert set(yaml.safe_load(path.read_text(encoding="utf-8"))) == set(NODES) - {"recorder"}
    pattern = f"{tmp_path}/ports/board_{{board}}"
    driver = settings_from_mapping(StrapDriverParameters, read_parameters_file(path, "strap_sensor_driver"))
    assert driver.port == pattern
    assert read_parameters_file(path, "sim_bridge")["port"] == pattern
    assert read_parameters_file(path, "sim_bridge")["seed"] == 5
    assert read_parameters_file(path, "traction_controller")["policy"] == "slip_limit"


def test_each_start_of_the_recorder_has_a_bag_of_its_own(graph_of, wait_until):
    assert [bag_name(starts) for starts in range(3)] == ["bag", "bag-2", "bag-3"]
    graph = graph_of(recorder=LIVES)
    start(graph, wait_until, "recorder")
    assert [bag.name for bag in graph.bags()] == ["bag"]
