"""What every test needs: ROS confined to this machine and to one domain per test; the switch that writes goldens."""

import itertools
import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

# Before rclpy is first imported; child processes inherit it.
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"
os.environ.setdefault("MPLBACKEND", "Agg")

TESTS = Path(__file__).parent
LIVE = ("node", "live", "port", "link", "uno", "process", "driven_graph", "trials", "soak", "mars_snag", "messages")
"""Parts of the names of files, among those of `APART`, whose tests use ROS, ports, processes or wall time."""
APART = (
    "golden",
    "sim_bridge",
    "soil_flow_estimator",
    "strap_rover/terramechanics",
    "strap_sensor_driver",
    "traction_controller",
    "missions/case_studies",
    "missions/test_core_run.py",
    "missions/test_dashboard.py",
    "missions/test_plan.py",
    "missions/test_summary.py",
)
"""What only computes: with `pytest -n 2 --dist loadgroup` it runs beside the rest, which stays in one process."""

_DOMAINS = 50  # per worker of pytest-xdist, of the 1 .. 100 that are free of the system's own ports on Linux
_worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw")) % 2
_domains = itertools.count(os.getpid() * 7)


def pytest_addoption(parser):
    parser.addoption("--write-golden", action="store_true", help="write the golden CSVs anew instead of comparing")


def pytest_collection_modifyitems(items):
    """Files that only compute may run on any worker, each whole; all that is live would run on one, in order.

    pytest-xdist reads the groups before this hook has run, so today live tests are on both workers, in domains of their
    own. Run first (`tryfirst`) it would hold them together: 8.5 instead of 7.3 minutes on a busy machine.
    """
    for item in items:
        path = item.path.relative_to(TESTS)
        computes = any(path.is_relative_to(part) for part in APART)
        is_live = not computes or any(word in path.stem for word in LIVE)
        item.add_marker(pytest.mark.xdist_group("live" if is_live else path.as_posix()))


@pytest.fixture
def write_golden(request) -> bool:
    return bool(request.config.getoption("--write-golden"))


@pytest.fixture
def domain_id(monkeypatch) -> int:
    """A ROS domain of this test's own, also in the environment, for child processes."""
    domain = _worker * _DOMAINS + next(_domains) % _DOMAINS + 1
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    return domain


@pytest.fixture
def ros_context(domain_id) -> Iterator[object]:
    """An rclpy context of this test's own."""
    import rclpy

    context = rclpy.Context()
    rclpy.init(args=[], context=context, domain_id=domain_id)
    yield context
    context.try_shutdown()


@pytest.fixture
def wait_until() -> Callable[..., None]:
    """Call `step` until `condition` holds; the test fails when it never does."""

    def wait(condition: Callable[[], object], step: Callable[[], object] | None = None, limit_s: float = 10.0) -> None:
        end = time.monotonic() + limit_s
        while not condition():
            assert time.monotonic() < end, f"did not come true within {limit_s} s"
            if step is None:
                time.sleep(0.001)
            else:
                step()

    return wait
