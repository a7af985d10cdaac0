"""What a rosbag2 bag of ROS 2 Jazzy says about itself: topics, counts, times, quality of service, as YAML.

Metadata version 9 (rosbag2 0.26): every field is mandatory, `offered_qos_profiles` is a YAML sequence with
policies in words, `custom_data` maps strings to strings. The same text, less its root key, stands in the
metadata record `rosbag2` of each MCAP file. Times are integer nanoseconds.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import yaml

from strap_rover.topics import Delivery, Topic

METADATA_VERSION = 9
METADATA_FILE = "metadata.yaml"
NO_TIME_NS = 2**63 - 1
"""`starting_time` of a bag without messages, and the duration that never ends (sec 9223372036, nsec 854775807)."""

_ROOT = "rosbag2_bagfile_information"
_SECOND_NS = 10**9
_POLICY_WORDS: dict[str, frozenset[str]] = {
    "history": frozenset({"system_default", "keep_last", "keep_all", "unknown"}),
    "reliability": frozenset({"system_default", "reliable", "best_effort", "unknown", "best_available"}),
    "durability": frozenset({"system_default", "transient_local", "volatile", "unknown", "best_available"}),
    "liveliness": frozenset({"system_default", "automatic", "manual_by_topic", "unknown", "best_available"}),
}


class BagError(ValueError):
    """A bag that cannot be read or written: one line with where it is, what is wrong and what to do about it."""

    def __init__(self, where: str | Path, problem: str, remedy: str) -> None:
        super().__init__(f"{where}: {problem}; {remedy}")
        self.where = Path(where)
        self.problem = problem
        self.remedy = remedy


@dataclass(frozen=True, slots=True)
class QosProfile:
    """What one publisher offers, policies in rosbag2's words, durations in ns.

    ValueError when a policy word is not one of rosbag2's or a number is negative.
    """

    history: str
    depth: int
    reliability: str
    durability: str
    deadline_ns: int = NO_TIME_NS
    lifespan_ns: int = NO_TIME_NS
    liveliness: str = "automatic"
    liveliness_lease_duration_ns: int = NO_TIME_NS
    avoid_ros_namespace_conventions: bool = False

    def __post_init__(self) -> None:
        for policy, words in _POLICY_WORDS.items():
            word = getattr(self, policy)
            if word not in words:
                raise ValueError(f"{policy} is {word!r}; use one of {', '.join(sorted(words))}")
        for name in ("depth", "deadline_ns", "lifespan_ns", "liveliness_lease_duration_ns"):
            if getattr(self, name) < 0:
                raise ValueError(f"{name} is {getattr(self, name)}; use a number >= 0")


def _profile(*, reliability: str, durability: str, depth: int) -> QosProfile:
    return QosProfile(history="keep_last", depth=depth, reliability=reliability, durability=durability)


OFFERED_QOS: dict[Delivery, QosProfile] = {
    Delivery.SENSOR: _profile(reliability="best_effort", durability="volatile", depth=5),
    Delivery.STREAM: _profile(reliability="reliable", durability="volatile", depth=500),
    Delivery.RELIABLE: _profile(reliability="reliable", durability="volatile", depth=10),
    Delivery.LATCHED: _profile(reliability="reliable", durability="transient_local", depth=1),
}
"""The topic contract's qualities of service as publishers offer them."""


@dataclass(frozen=True, slots=True)
class BagTopic:
    """One topic of a bag; `type_hash` is the RIHS01 string, or empty when it is not known."""

    name: str
    type_name: str
    offered_qos: tuple[QosProfile, ...] = ()
    type_hash: str = ""
    serialization_format: str = "cdr"


@dataclass(frozen=True, slots=True)
class TopicCount:
    """A topic and how many messages of it the bag holds."""

    topic: BagTopic
    message_count: int


@dataclass(frozen=True, slots=True)
class BagFile:
    """One storage file of a bag; `path` is relative to the bag's directory."""

    path: str
    starting_time_ns: int = NO_TIME_NS
    duration_ns: int = 0
    message_count: int = 0


@dataclass(frozen=True, slots=True)
class BagMetadata:
    """The whole of metadata.yaml, in rosbag2's order."""

    duration_ns: int
    starting_time_ns: int
    message_count: int
    topics: tuple[TopicCount, ...]
    files: tuple[BagFile, ...]
    relative_file_paths: tuple[str, ...]
    custom_data: Mapping[str, str] = field(default_factory=dict)
    storage_identifier: str = "mcap"
    compression_format: str = ""
    compression_mode: str = ""
    ros_distro: str = "jazzy"


def contract_topic(row: Topic, name: str | None = None, type_hash: str = "") -> BagTopic:
    """The bag topic of a row of the topic contract.

    `name` is the fully qualified name in the running graph; None means the root namespace.
    """
    return BagTopic(
        name=name if name is not None else "/" + row.name.lstrip("/"),
        type_name=row.type_name,
        offered_qos=(OFFERED_QOS[row.delivery],),
        type_hash=type_hash,
    )


# Writing


def qos_yaml(profiles: Sequence[QosProfile]) -> str:
    """The YAML sequence that goes into a channel's `offered_qos_profiles`."""
    return "\n".join(_block([_qos_node(profile) for profile in profiles], 0))


def metadata_yaml(metadata: BagMetadata, *, rooted: bool = True) -> str:
    """The text of metadata.yaml without a final newline; `rooted=False` for the record inside an MCAP file."""
    node = _metadata_node(metadata)
    return "\n".join(_block({_ROOT: node} if rooted else node, 0))


def _duration_node(duration_ns: int) -> dict[str, int]:
    return {"sec": duration_ns // _SECOND_NS, "nsec": duration_ns % _SECOND_NS}


def _qos_node(profile: QosProfile) -> dict[str, Any]:
    return {
        "history": profile.history,
        "depth": profile.depth,
        "reliability": profile.reliability,
        "durability": profile.durability,
        "deadline": _duration_node(profile.deadline_ns),
        "lifespan": _duration_node(profile.lifespan_ns),
        "liveliness": profile.liveliness,
        "liveliness_lease_duration": _duration_node(profile.liveliness_lease_duration_ns),
        "avoid_ros_namespace_conventions": profile.avoid_ros_namespace_conventions,
    }


def _metadata_node(metadata: BagMetadata) -> dict[str, Any]:
    return {
        "version": METADATA_VERSION,
        "storage_identifier": metadata.storage_identifier,
        "duration": {"nanoseconds": metadata.duration_ns},
        "starting_time": {"nanoseconds_since_epoch": metadata.starting_time_ns},
        "message_count": metadata.message_count,
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": row.topic.name,
                    "type": row.topic.type_name,
                    "serialization_format": row.topic.serialization_format,
                    "offered_qos_profiles": [_qos_node(profile) for profile in row.topic.offered_qos],
                    "type_description_hash": row.topic.type_hash,
                },
                "message_count": row.message_count,
            }
            for row in metadata.topics
        ],
        "compression_format": metadata.compression_format,
        "compression_mode": metadata.compression_mode,
        "relative_file_paths": list(metadata.relative_file_paths),
        "files": [
            {
                "path": file.path,
                "starting_time": {"nanoseconds_since_epoch": file.starting_time_ns},
                "duration": {"nanoseconds": file.duration_ns},
                "message_count": file.message_count,
            }
            for file in metadata.files
        ],
        "custom_data": dict(metadata.custom_data) or None,
        "ros_distro": metadata.ros_distro,
    }


# yaml-cpp, which rosbag2 uses, puts an empty sequence on a line of its own and writes null as "~"; PyYAML does
# neither, so the blocks are laid out here and only quoted scalars are left to PyYAML.
_PLAIN = re.compile(r"[A-Za-z_/][A-Za-z0-9_/.+-]*")
_WORDS_WITH_A_TYPE = frozenset({"true", "false", "yes", "no", "on", "off", "null", "y", "n"})


def _scalar(value: str | int | None) -> str:
    if value is None:
        return "~"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return str(value)
    if _PLAIN.fullmatch(value) and value.lower() not in _WORDS_WITH_A_TYPE:
        return value
    quoted: str = yaml.dump(value, default_style='"', width=float("inf"), allow_unicode=True)
    return quoted.removesuffix("\n")


def _block(node: dict[str, Any] | list[Any], indent: int) -> list[str]:
    pad = " " * indent
    if isinstance(node, dict):
        lines = []
        for key, value in node.items():
            if isinstance(value, dict | list):
                lines += [f"{pad}{_scalar(key)}:", *_block(value, indent + 2)]
            else:
                lines.append(f"{pad}{_scalar(key)}: {_scalar(value)}")
        return lines
    if not node:
        return [f"{pad}[]"]
    lines = []
    for item in node:
        if isinstance(item, dict | list):
            first, *rest = _block(item, indent + 2)
            lines += [f"{pad}- {first.lstrip()}", *rest]
        else:
            lines.append(f"{pad}- {_scalar(item)}")
    return lines


# Reading

_BROKEN_REMEDY = "rebuild it with `ros2 bag reindex`, or read the .mcap file itself"


@dataclass(frozen=True, slots=True)
class _Node:
    """A mapping of the YAML tree that knows where it stands, so that complaints can name the field."""

    file: str
    path: str
    fields: Mapping[str, Any]

    @classmethod
    def of(cls, value: object, file: str, path: str) -> Self:
        if not isinstance(value, Mapping):
            raise BagError(file, f"{path or 'the document'} is not a mapping", _BROKEN_REMEDY)
        return cls(file, path, value)

    def _raw(self, key: str) -> Any:
        if key not in self.fields:
            raise BagError(self.file, f"no field {self.path}{key}", _BROKEN_REMEDY)
        return self.fields[key]

    def node(self, key: str) -> "_Node":
        return _Node.of(self._raw(key), self.file, f"{self.path}{key}.")

    def nodes(self, key: str) -> "list[_Node]":
        path = f"{self.path}{key}"
        return [_Node.of(item, self.file, f"{path}[{index}].") for index, item in enumerate(self._sequence(key))]

    def texts(self, key: str) -> tuple[str, ...]:
        return tuple(str(item) for item in self._sequence(key))

    def _sequence(self, key: str) -> list[Any]:
        value = self._raw(key)
        if not isinstance(value, list):
            raise BagError(self.file, f"{self.path}{key} is not a sequence", _BROKEN_REMEDY)
        return value

    def text(self, key: str) -> str:
        value = self._raw(key)
        if not isinstance(value, str):
            raise BagError(self.file, f"{self.path}{key} is not a string", _BROKEN_REMEDY)
        return value

    def integer(self, key: str) -> int:
        text = self.text(key)
        try:
            return int(text)
        except ValueError:
            raise BagError(self.file, f"{self.path}{key} is {text!r}, not an integer", _BROKEN_REMEDY) from None

    def flag(self, key: str) -> bool:
        text = self.text(key)
        if text not in {"true", "false"}:
            raise BagError(self.file, f"{self.path}{key} is {text!r}, not true or false", _BROKEN_REMEDY)
        return text == "true"

    def duration_ns(self, key: str) -> int:
        parts = self.node(key)
        return parts.integer("sec") * _SECOND_NS + parts.integer("nsec")


def parse_metadata(text: str, where: str | Path = METADATA_FILE, *, rooted: bool = True) -> BagMetadata:
    """The metadata in `text`; BagError names `where` and the field that is missing or wrong.

    `rooted=False` for the text of the record inside an MCAP file, which lacks the root key.
    """
    file = str(where)
    try:
        # BaseLoader leaves every scalar a string: rosbag2 writes numbers in custom_data without quotes.
        document = yaml.load(text, Loader=yaml.BaseLoader)  # noqa: S506 - BaseLoader builds only str, list, dict
    except yaml.YAMLError as error:
        problem = " ".join(str(error).split())
        raise BagError(file, f"not YAML ({problem})", _BROKEN_REMEDY) from None
    root = _Node.of(document, file, "")
    if rooted:
        root = _Node(file, "", root.node(_ROOT).fields)
    version = root.integer("version")
    if version != METADATA_VERSION:
        raise BagError(
            file,
            f"metadata version {version}, not {METADATA_VERSION}",
            "convert the bag with ROS 2 Jazzy's `ros2 bag convert`, or read the .mcap file itself",
        )
    return BagMetadata(
        duration_ns=root.node("duration").integer("nanoseconds"),
        starting_time_ns=root.node("starting_time").integer("nanoseconds_since_epoch"),
        message_count=root.integer("message_count"),
        topics=tuple(
            TopicCount(_parse_topic(row.node("topic_metadata")), row.integer("message_count"))
            for row in root.nodes("topics_with_message_count")
        ),
        files=tuple(
            BagFile(
                path=row.text("path"),
                starting_time_ns=row.node("starting_time").integer("nanoseconds_since_epoch"),
                duration_ns=row.node("duration").integer("nanoseconds"),
                message_count=row.integer("message_count"),
            )
            for row in root.nodes("files")
        ),
        relative_file_paths=root.texts("relative_file_paths"),
        custom_data=_parse_custom_data(root),
        storage_identifier=root.text("storage_identifier"),
        compression_format=root.text("compression_format"),
        compression_mode=root.text("compression_mode"),
        ros_distro=root.text("ros_distro"),
    )


def _parse_topic(row: _Node) -> BagTopic:
    return BagTopic(
        name=row.text("name"),
        type_name=row.text("type"),
        serialization_format=row.text("serialization_format"),
        offered_qos=tuple(_parse_qos(profile) for profile in row.nodes("offered_qos_profiles")),
        type_hash=row.text("type_description_hash"),
    )


def parse_qos_profiles(text: str, where: str | Path) -> tuple[QosProfile, ...]:
    """The profiles of a channel's `offered_qos_profiles`; BagError when it is not a sequence in Jazzy's words."""
    try:
        document = yaml.load(text, Loader=yaml.BaseLoader)  # noqa: S506 - BaseLoader builds only str, list, dict
    except yaml.YAMLError as error:
        problem = " ".join(str(error).split())
        raise BagError(where, f"offered_qos_profiles is not YAML ({problem})", _BROKEN_REMEDY) from None
    node = _Node(str(where), "", {"offered_qos_profiles": document or []})
    return tuple(_parse_qos(profile) for profile in node.nodes("offered_qos_profiles"))


def _parse_qos(row: _Node) -> QosProfile:
    try:
        return QosProfile(
            history=row.text("history"),
            depth=row.integer("depth"),
            reliability=row.text("reliability"),
            durability=row.text("durability"),
            deadline_ns=row.duration_ns("deadline"),
            lifespan_ns=row.duration_ns("lifespan"),
            liveliness=row.text("liveliness"),
            liveliness_lease_duration_ns=row.duration_ns("liveliness_lease_duration"),
            avoid_ros_namespace_conventions=row.flag("avoid_ros_namespace_conventions"),
        )
    except BagError:
        raise
    except ValueError as error:
        raise BagError(row.file, f"{row.path.rstrip('.')}: {error}", _BROKEN_REMEDY) from None


def _parse_custom_data(root: _Node) -> dict[str, str]:
    if root.fields.get("custom_data") in ("~", "", "null"):
        return {}
    node = root.node("custom_data")
    return {key: node.text(key) for key in node.fields}


def read_metadata(path: str | Path) -> BagMetadata:
    """The metadata of the bag in directory `path` (or of the metadata.yaml at `path`); BagError when unreadable."""
    file = Path(path)
    if file.is_dir():
        file /= METADATA_FILE
    try:
        text = file.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise BagError(file, "no such file", "give the directory of a bag, the one with metadata.yaml in it") from None
    except UnicodeDecodeError as error:
        raise BagError(file, f"not UTF-8 text ({error.reason})", _BROKEN_REMEDY) from None
    except OSError as error:
        raise BagError(file, f"cannot be read ({error.strerror})", "check the path and its permissions") from None
    return parse_metadata(text, file)
