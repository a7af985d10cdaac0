"""Settings of the player: parameters of the node `player`, options of `strap_rover bag play`."""

from dataclasses import dataclass, field

SLOWEST_RATE = 0.001


@dataclass(frozen=True, slots=True)
class PlayerSettings:
    """What of a bag to play, and how."""

    bag: str = field(metadata={"doc": "folder of a bag, or an .mcap file"})
    rate: float = field(
        default=1.0, metadata={"doc": "times real time; 0 as fast as possible", "min": 0.0, "max": 1000.0}
    )
    start_offset_s: float = field(default=0.0, metadata={"doc": "begin this long after the bag does [s]", "min": 0.0})
    loop: bool = field(default=False, metadata={"doc": "begin again at the end, which sets /clock back"})
    topics: tuple[str, ...] = field(
        default=(), metadata={"doc": "what to play; none: the inputs of estimator and controller; `all`: everything"}
    )
    clock: bool = field(default=True, metadata={"doc": "send bag time on /clock, at 100 Hz of bag time"})
    wait_s: float = field(
        default=10.0,
        metadata={
            "doc": "wait this long for a listener to every topic, then begin anyway [s]",
            "min": 0.0,
            "max": 3600.0,
        },
    )

    def __post_init__(self) -> None:
        if 0.0 < self.rate < SLOWEST_RATE:
            raise ValueError(f"rate: {self.rate} is too slow; give {SLOWEST_RATE} or more, or 0: as fast as possible")
