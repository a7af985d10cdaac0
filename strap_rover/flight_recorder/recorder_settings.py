"""Settings of the recorder node: parameters of `recorder`, keys of its YAML."""

from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class RecorderSettings:
    """Where and how to record."""

    directory: str = field(
        default="", metadata={"doc": "the bag; must not exist or be empty; '' is strap_rover_<UTC date and time> here"}
    )
    compression: str = field(default="zstd", metadata={"doc": "of the chunks", "choices": ("zstd", "none")})
    poll_period_s: float = field(
        default=0.015, metadata={"doc": "how often waiting messages are taken [s]", "min": 0.001, "max": 0.1}
    )
    flush_period_s: float = field(
        default=0.2, metadata={"doc": "a killed recorder loses this and hold_s [s]", "min": 0.01, "max": 10.0}
    )
    sync_period_s: float = field(
        default=2.0, metadata={"doc": "a power cut loses this and hold_s [s]", "min": 0.1, "max": 60.0}
    )
    hold_s: float = field(
        default=0.1, metadata={"doc": "how late a message may come and still be in order [s]", "min": 0.0, "max": 10.0}
    )
    queue_depth: int = field(
        default=1000,
        metadata={"doc": "messages a topic may bring between two polls", "min": 10, "max": 100000},
    )
    max_file_bytes: int = field(default=0, metadata={"doc": "begin a new file beyond this [B]; 0 never", "min": 0})
    max_file_duration_s: float = field(default=0.0, metadata={"doc": "the same by time [s]; 0 never", "min": 0.0})
