"""What every test needs: ROS confined to this machine and to one domain per test; the switch that writes goldens."""

import itertools
import os
import time
from collections.abc import Callable, Iterator

import pytest

# Before rclpy is first imported; child processes inherit it.
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"
os.environ.setdefault("MPLBACKEND", "Agg")

_DOMAINS = 100  # 1 .. 100 are free of the system's own ports on Linux
_domains = itertools.count(os.getpid() * 7)


def pytest_addoption(parser):
    parser.addoption("--write-golden", action="store_true", help="write the golden CSVs anew instead of comparing")


@pytest.fixture
def write_golden(request) -> bool:
    return bool(request.config.getoption("--write-golden"))


@pytest.fixture
def domain_id(monkeypatch) -> int:
    """A ROS domain of this test's own, also in the environment, for child processes."""
    domain = next(_domains) % _DOMAINS + 1
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
