"""The ROS parameters of the simulated world's node."""

from dataclasses import dataclass, field

from sim_bridge.line_faults import LineFault
from sim_bridge.scenarios import SCENARIOS
from sim_bridge.strap_faults import StrapFault
from sim_bridge.world import SensorSettings
from strap_rover.rover import RoverDescription, StrapInput
from strap_rover.settings import SettingsError


@dataclass(frozen=True, slots=True)
class SimBridgeParameters(SensorSettings):
    """The sensors' settings and what the node adds."""

    scenario: str = field(
        default="mars_snag", metadata={"doc": "what the rover meets", "choices": tuple(sorted(SCENARIOS))}
    )
    rover: str = field(
        default="", metadata={"doc": "rover description: a name in config/rovers or a path; empty: the scenario's own"}
    )
    terrain_file: str = field(
        default="",
        metadata={"doc": "ground to drive on, an .npz (docs/terrain.md), without a snag; empty: the scenario's own"},
    )
    seed: int = field(default=0, metadata={"doc": "of terrain and noise", "min": 0, "max": 2**31 - 1})
    port: str = field(
        default="/tmp/strap_rover/board_{board}",  # noqa: S108 - a lock keeps others out, and it serves no secrets
        metadata={"doc": "live: link to the serial port of each virtual board, {board} stands for its id"},
    )
    line_fault: str = field(
        default=LineFault.NONE.value,
        metadata={
            "doc": "live: what is wrong with the serial lines, to practise with",
            "choices": tuple(fault.value for fault in LineFault),
            "tunable": True,
        },
    )
    line_fault_share: float = field(
        default=0.1,
        metadata={
            "doc": "share of the frames or bytes that the fault strikes",
            "min": 0.0,
            "max": 1.0,
            "tunable": True,
        },
    )
    line_fault_board: int = field(
        default=-1,
        metadata={"doc": "board that the fault strikes, -1: all", "min": -1, "max": 255, "tunable": True},
    )
    line_journal: str = field(
        default="",
        metadata={
            "doc": "live: file that each board's bytes go to as it sends them, before any line_fault, to compare with "
            "strap/raw; {board} stands for its id; empty: none"
        },
    )
    strap_fault: str = field(
        default=StrapFault.NONE.value,
        metadata={
            "doc": "what is wrong with straps, their leads or inputs, to practise with",
            "choices": tuple(fault.value for fault in StrapFault),
            "tunable": True,
        },
    )
    strap_fault_wheel: str = field(
        default="", metadata={"doc": "name of the wheel that the fault strikes; empty: all", "tunable": True}
    )
    strap_fault_strap: str = field(
        default="both",
        metadata={
            "doc": "which of a wheel's straps, where it has two",
            "choices": ("both", "first", "second"),
            "tunable": True,
        },
    )
    strap_fault_size: float = field(
        default=1.0,
        metadata={
            "doc": "times as bad as usual: noisy, drift, reference, floating, intermittent",
            "min": 0.0,
            "max": 10.0,
            "tunable": True,
        },
    )
    firmware: str = field(
        default="",
        metadata={
            "doc": "live: firmware (ELF) that simulated Unos execute, one per board; the program simulated_uno stands "
            "beside it; empty: virtual boards"
        },
    )

    def struck_straps(self, rover: RoverDescription) -> tuple[StrapInput, ...]:
        """The straps of `rover` that `strap_fault` strikes; SettingsError when it has no such wheel."""
        name = self.strap_fault_wheel
        if name and name not in rover.wheel_names:
            raise SettingsError([f"strap_fault_wheel: no wheel {name!r}; give one of {', '.join(rover.wheel_names)}"])
        return tuple(
            strap
            for strap in rover.strap_inputs
            if name in {"", rover.wheel_names[strap.wheel_index]}
            and self.strap_fault_strap in {"both", "second" if strap.is_second else "first"}
        )
