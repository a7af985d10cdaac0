"""The text and the hash of message types, as an MCAP file of a ROS 2 bag must carry them.

A schema of encoding `ros2msg` is the type's .msg text followed by the text of every type it is made of, depth
first, the dependencies of one type in sorted order, each once, each after a line of 80 "=" and a line
`MSG: package/Name` (MCAP format registry, "ros2msg"). Files are looked for in share/<package>/msg below each
entry of AMENT_PREFIX_PATH, then below `sys.prefix`, where the Python wheels of ROS 2 put them.
"""

import functools
import json
import os
import re
import sys
from pathlib import Path

from strap_rover.flight_recorder.bag_format import BagError

_SEPARATOR = "=" * 80
_PRIMITIVES = (
    frozenset({"bool", "byte", "char", "float32", "float64", "string", "wstring"})
    | frozenset({"int8", "int16", "int32", "int64"})
    | frozenset({"uint8", "uint16", "uint32", "uint64"})
)
# "type[bounds] name": the bound of a string ("string<=10 x") and of a sequence are not part of the type's name.
_FIELD = re.compile(r"\s*([a-zA-Z0-9_/]+)(?:<=\d+)?(?:\[[^\]]*\])?\s+[a-zA-Z]")
_TYPE_NAME = re.compile(r"[a-z][a-z0-9_]*/msg/[A-Z][A-Za-z0-9]*")
_INSTALL_REMEDY = "source the ROS 2 workspace that has it, or pip install its ros-jazzy wheel"


def message_definition(type_name: str) -> str:
    """The `ros2msg` schema of `package/msg/Name`; BagError when a .msg file is not installed."""
    _check(type_name)
    seen: set[str] = set()

    def expand(package: str, name: str) -> str:
        text = _message_file(package, name, ".msg").read_text(encoding="utf-8")
        parts = [text]
        for dependency in sorted(_dependencies(text, package)):
            if dependency not in seen:
                seen.add(dependency)
                inner_package, inner_name = dependency.split("/")
                parts.append(f"\n{_SEPARATOR}\nMSG: {dependency}\n{expand(inner_package, inner_name)}")
        return "".join(parts)

    package, _, name = type_name.split("/")
    return expand(package, name)


@functools.cache
def type_hash(type_name: str) -> str:
    """The RIHS01 hash of `package/msg/Name` (REP 2016); BagError when its type description is not installed."""
    _check(type_name)
    package, _, name = type_name.split("/")
    file = _message_file(package, name, ".json")
    try:
        hashes = json.loads(file.read_text(encoding="utf-8"))["type_hashes"]
        return next(str(row["hash_string"]) for row in hashes if row["type_name"] == type_name)
    except (json.JSONDecodeError, KeyError, TypeError, StopIteration):
        raise BagError(file, f"holds no type hash of {type_name}", "reinstall the message package") from None


def _check(type_name: str) -> None:
    if not _TYPE_NAME.fullmatch(type_name):
        raise ValueError(f"message type is {type_name!r}; write it as package/msg/Name")


def _dependencies(text: str, package: str) -> set[str]:
    names = set()
    for line in text.splitlines():
        match = _FIELD.match(line.split("#", 1)[0])
        if match and match[1] not in _PRIMITIVES:
            parts = match[1].split("/")
            names.add(f"{parts[0]}/{parts[-1]}" if len(parts) > 1 else f"{package}/{parts[0]}")
    return names


def _message_file(package: str, name: str, suffix: str) -> Path:
    prefixes = [entry for entry in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if entry]
    for prefix in (*prefixes, sys.prefix):
        file = Path(prefix, "share", package, "msg", name + suffix)
        if file.is_file():
            return file
    raise BagError(f"share/{package}/msg/{name}{suffix}", "message type is not installed", _INSTALL_REMEDY)
