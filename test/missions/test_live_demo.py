"""What the live demo looks at before it starts anything; whole runs: test/integration/test_live_process.py."""

import tempfile

import pytest

from missions.live_demo import OtherGraphError, _operator, domain_lock
from missions.plan import plan_run

pytestmark = pytest.mark.ros


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    monkeypatch.setattr(tempfile, "gettempdir", lambda: str(tmp_path))
    return tmp_path


def test_a_second_demo_in_the_domain_is_refused_with_the_way_out(folder, monkeypatch):
    with domain_lock():
        with pytest.raises(OtherGraphError, match=r"a live demo of this machine; .*ROS_DOMAIN_ID=8"), domain_lock():
            pass
        monkeypatch.setenv("ROS_DOMAIN_ID", "8")
        with domain_lock():
            pass
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    with domain_lock():
        pass


def test_a_folder_that_is_another_users_keeps_nobody_from_driving(folder):
    (folder / "strap_rover").write_text("no folder of ours", encoding="utf-8")
    with domain_lock():
        pass


def test_a_demo_that_is_interrupted_leaves_no_executor_behind_its_context(domain_id):
    held = []

    def interrupted():
        with _operator(plan_run("single_wheel", "soil_flow")) as (operator, work):
            work()
            held.append(operator.executor)
            raise InterruptedError

    with pytest.raises(InterruptedError):
        interrupted()
    assert held[0].get_nodes() == []  # it was shut down, before what it stands on
