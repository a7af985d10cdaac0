from pathlib import Path

import pytest
from mcap_ros2._dynamic import generate_dynamic
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from strap_rover.flight_recorder.bag_format import BagError
from strap_rover.flight_recorder.message_definition import message_definition, type_hash
from strap_rover.topics import CONTRACT

TYPE_NAMES = sorted({row.type_name for row in CONTRACT})


@pytest.mark.parametrize("type_name", TYPE_NAMES)
def test_another_parser_finds_the_same_types(type_name: str) -> None:
    """rosbags knows Jazzy's types by itself: the text must give the very definition, dependencies included."""
    store = get_typestore(Stores.ROS2_JAZZY)
    parsed = get_types_from_msg(message_definition(type_name), type_name)
    assert type_name in parsed
    for name, (_constants, fields) in parsed.items():
        assert fields == store.fielddefs[name][1], name


@pytest.mark.parametrize("type_name", TYPE_NAMES)
def test_hash_is_the_one_of_the_fields(type_name: str) -> None:
    """RIHS01 recomputed from the field definitions by rosbags (REP 2016)."""
    assert type_hash(type_name) == get_typestore(Stores.ROS2_JAZZY).hash_rihs01(type_name)


@pytest.mark.parametrize("type_name", TYPE_NAMES)
def test_mcap_ros2_support_parses_it(type_name: str) -> None:
    assert generate_dynamic(type_name, message_definition(type_name))


def test_dependencies_once_depth_first_with_separators() -> None:
    text = message_definition("nav_msgs/msg/Odometry")
    sections = [line.removeprefix("MSG: ") for line in text.splitlines() if line.startswith("MSG: ")]
    assert sections == [
        "geometry_msgs/PoseWithCovariance",
        "geometry_msgs/Pose",
        "geometry_msgs/Point",
        "geometry_msgs/Quaternion",
        "geometry_msgs/TwistWithCovariance",
        "geometry_msgs/Twist",
        "geometry_msgs/Vector3",
        "std_msgs/Header",
        "builtin_interfaces/Time",
    ]
    assert text.count("\n" + "=" * 80 + "\nMSG: ") == len(sections)


def test_ament_prefix_comes_before_the_interpreter(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "share" / "own_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Deep.msg").write_text("string<=10 label  # a bound\nuint8 LIMIT=3\nFlat[<=4] parts\n")
    (folder / "Flat.msg").write_text("float64[3] values\n")
    with pytest.raises(BagError, match=r"share/own_msgs/msg/Deep.msg: message type is not installed; source"):
        message_definition("own_msgs/msg/Deep")
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"/nowhere:{tmp_path}")
    text = message_definition("own_msgs/msg/Deep")
    assert text.endswith("\n" + "=" * 80 + "\nMSG: own_msgs/Flat\nfloat64[3] values\n")


@pytest.mark.parametrize("name", ["std_msgs/String", "std_msgs/msg/../../x", "String", ""])
def test_names_must_be_whole(name: str) -> None:
    with pytest.raises(ValueError, match="write it as package/msg/Name"):
        message_definition(name)


def test_hash_of_a_broken_description(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "share" / "own_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Odd.json").write_text("{}")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    with pytest.raises(BagError, match="no type hash"):
        type_hash("own_msgs/msg/Odd")
