"""The nodes as processes: what `ros2 run strap_rover NAME` and `python -m missions.node_processes NAME` start.

Signals are taken over before anything slow is imported: a Ctrl-C in a node's first second shows no traceback either.
"""

import os
import signal
import sys
from collections.abc import Callable, Mapping
from types import MappingProxyType

from strap_rover.ros_shell.quiet_start import take_signals

SUPERVISOR = "STRAP_ROVER_SUPERVISOR"
"""Environment variable with the process number of whoever started a node and whom it is not to outlive."""
_PR_SET_PDEATHSIG = 1


def strap_sensor_driver() -> int:
    """Bytes from the boards in; frames, volts and contact angles out. The exit code."""
    take_signals()
    from strap_sensor_driver.node import main  # noqa: PLC0415 - signals first

    return main()


def soil_flow_estimator() -> int:
    """Telemetry and contact angles in, soil state out. The exit code."""
    take_signals()
    from soil_flow_estimator.node import main  # noqa: PLC0415 - signals first

    return main()


def traction_controller() -> int:
    """Speed request and soil state in, wheel commands out. The exit code."""
    take_signals()
    from traction_controller.node import main  # noqa: PLC0415 - signals first

    return main()


def sim_bridge() -> int:
    """The simulated world: wheel commands in, telemetry and strap frames out. The exit code."""
    take_signals()
    from sim_bridge.node import main  # noqa: PLC0415 - signals first

    return main()


def recorder() -> int:
    """Every topic of the contract into a bag. The exit code."""
    take_signals()
    from strap_rover.flight_recorder.node import main  # noqa: PLC0415 - signals first

    return main()


def player() -> int:
    """A bag back into the graph. The exit code."""
    take_signals()
    from strap_rover.flight_recorder.player_node import main  # noqa: PLC0415 - signals first

    return main()


NODE_PROCESSES: Mapping[str, Callable[[], int]] = MappingProxyType(
    {
        function.__name__: function
        for function in (strap_sensor_driver, soil_flow_estimator, traction_controller, sim_bridge, recorder, player)
    }
)
"""Every node by the name of its executable."""


def main() -> int:
    """Run the node named by the first argument, which takes the others; the exit code."""
    name = sys.argv[1] if len(sys.argv) > 1 else ""
    if name not in NODE_PROCESSES:
        sys.stderr.write(f"usage: python -m missions.node_processes NAME; NAME {name!r}: {', '.join(NODE_PROCESSES)}\n")
        return 2
    del sys.argv[0]
    take_signals()
    _end_with_supervisor()
    return NODE_PROCESSES[name]()


def _end_with_supervisor() -> None:
    """Have the kernel send SIGTERM when the supervisor named in the environment ends, however it does."""
    supervisor = os.environ.get(SUPERVISOR)
    if supervisor is None:
        return
    import ctypes  # noqa: PLC0415 - signals first

    ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != int(supervisor):  # it ended before we asked
        os._exit(0)


if __name__ == "__main__":
    sys.exit(main())
