import string
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

from strap_rover.flight_recorder.bag_format import (
    NO_TIME_NS,
    OFFERED_QOS,
    BagError,
    BagFile,
    BagMetadata,
    BagTopic,
    QosProfile,
    TopicCount,
    contract_topic,
    metadata_yaml,
    parse_metadata,
    parse_qos_profiles,
    qos_yaml,
    read_metadata,
)
from strap_rover.ros_shell.qos import qos_profile
from strap_rover.topics import CMD_VEL, CONTRACT, DIAGNOSTICS, Delivery

# Laid out as rosbag2 0.26 writes it (the empty sequence on its own line, "~", quoted empty strings).
JAZZY_TEXT = """\
rosbag2_bagfile_information:
  version: 9
  storage_identifier: mcap
  duration:
    nanoseconds: 4000000000
  starting_time:
    nanoseconds_since_epoch: 1700000000000000000
  message_count: 12
  topics_with_message_count:
    - topic_metadata:
        name: /chatter
        type: std_msgs/msg/String
        serialization_format: cdr
        offered_qos_profiles:
          - history: unknown
            depth: 0
            reliability: reliable
            durability: volatile
            deadline:
              sec: 9223372036
              nsec: 854775807
            lifespan:
              sec: 9223372036
              nsec: 854775807
            liveliness: automatic
            liveliness_lease_duration:
              sec: 9223372036
              nsec: 854775807
            avoid_ros_namespace_conventions: false
        type_description_hash: RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18
      message_count: 12
    - topic_metadata:
        name: /quiet
        type: std_msgs/msg/String
        serialization_format: cdr
        offered_qos_profiles:
          []
        type_description_hash: ""
      message_count: 0
  compression_format: ""
  compression_mode: ""
  relative_file_paths:
    - run_0.mcap
  files:
    - path: run_0.mcap
      starting_time:
        nanoseconds_since_epoch: 1700000000000000000
      duration:
        nanoseconds: 4000000000
      message_count: 12
  custom_data: ~
  ros_distro: jazzy"""

JAZZY = BagMetadata(
    duration_ns=4_000_000_000,
    starting_time_ns=1_700_000_000_000_000_000,
    message_count=12,
    topics=(
        TopicCount(
            BagTopic(
                "/chatter",
                "std_msgs/msg/String",
                (QosProfile("unknown", 0, "reliable", "volatile"),),
                "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
            ),
            12,
        ),
        TopicCount(BagTopic("/quiet", "std_msgs/msg/String"), 0),
    ),
    files=(BagFile("run_0.mcap", 1_700_000_000_000_000_000, 4_000_000_000, 12),),
    relative_file_paths=("run_0.mcap",),
)

counts = st.integers(0, 2**63 - 1)
names = st.text(string.ascii_letters + string.digits + "/_", min_size=1)
texts = st.text(st.characters(exclude_categories=["Cs"]), max_size=30)
profiles = st.builds(
    QosProfile,
    history=st.sampled_from(["keep_last", "keep_all", "system_default", "unknown"]),
    depth=st.integers(0, 10_000),
    reliability=st.sampled_from(["reliable", "best_effort", "best_available"]),
    durability=st.sampled_from(["volatile", "transient_local"]),
    deadline_ns=counts,
    lifespan_ns=counts,
    liveliness=st.sampled_from(["automatic", "manual_by_topic"]),
    liveliness_lease_duration_ns=counts,
    avoid_ros_namespace_conventions=st.booleans(),
)
metadatas = st.builds(
    BagMetadata,
    duration_ns=counts,
    starting_time_ns=counts,
    message_count=counts,
    topics=st.lists(
        st.builds(
            TopicCount,
            st.builds(BagTopic, names, names, st.lists(profiles, max_size=2).map(tuple), st.one_of(st.just(""), names)),
            counts,
        ),
        max_size=3,
    ).map(tuple),
    files=st.lists(st.builds(BagFile, texts, counts, counts, counts), max_size=3).map(tuple),
    relative_file_paths=st.lists(texts, max_size=3).map(tuple),
    custom_data=st.dictionaries(texts, texts, max_size=4),
)


def test_text_is_laid_out_as_rosbag2_does() -> None:
    assert metadata_yaml(JAZZY) == JAZZY_TEXT


def test_text_of_rosbag2_is_read() -> None:
    assert parse_metadata(JAZZY_TEXT) == JAZZY


@given(metadatas)
def test_metadata_round_trip(metadata: BagMetadata) -> None:
    assert parse_metadata(metadata_yaml(metadata)) == metadata
    assert parse_metadata(metadata_yaml(metadata, rooted=False), rooted=False) == metadata


@given(metadatas)
def test_any_yaml_reader_sees_strings_as_strings(metadata: BagMetadata) -> None:
    document = yaml.safe_load(metadata_yaml(metadata))["rosbag2_bagfile_information"]
    assert (document["custom_data"] or {}) == metadata.custom_data
    assert [row["path"] for row in document["files"]] == [file.path for file in metadata.files]


@given(st.lists(profiles, max_size=3).map(tuple))
def test_qos_round_trip(rows: tuple[QosProfile, ...]) -> None:
    assert parse_qos_profiles(qos_yaml(rows), "x") == rows


def test_infinite_durations_in_words_of_rosbag2() -> None:
    deadline = yaml.safe_load(qos_yaml(OFFERED_QOS.values()))[0]["deadline"]  # type: ignore[arg-type]
    assert deadline == {"sec": 9223372036, "nsec": 854775807}
    assert NO_TIME_NS == 9223372036 * 10**9 + 854775807


@pytest.mark.parametrize("delivery", Delivery)
def test_words_agree_with_the_profiles_the_nodes_use(delivery: Delivery) -> None:
    words, profile = OFFERED_QOS[delivery], qos_profile(delivery)
    assert ReliabilityPolicy[words.reliability.upper()] == profile.reliability
    assert DurabilityPolicy[words.durability.upper()] == profile.durability
    assert words.depth == profile.depth


def test_contract_topics_are_fully_qualified() -> None:
    assert contract_topic(CMD_VEL).name == "/cmd_vel"
    assert contract_topic(DIAGNOSTICS).name == "/diagnostics"
    assert contract_topic(CMD_VEL, "/rover_1/cmd_vel").name == "/rover_1/cmd_vel"
    assert len({contract_topic(row).name for row in CONTRACT}) == len(CONTRACT)


MANDATORY = [line.split(":")[0].strip(" -") for line in JAZZY_TEXT.splitlines()[1:] if ":" in line]


@pytest.mark.parametrize("key", sorted(set(MANDATORY)))
def test_every_field_is_mandatory_and_named_when_missing(key: str) -> None:
    text = JAZZY_TEXT.replace(f"{key}:", f"{key}_x:", 1)
    with pytest.raises(BagError, match=f"no field .*{key}") as caught:
        parse_metadata(text, "bag/metadata.yaml")
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith("bag/metadata.yaml: ")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("version: 9", "version: 5", "metadata version 5"),
        ("message_count: 12", "message_count: many", "'many', not an integer"),
        ("reliability: reliable", "reliability: 1", "reliability is '1'"),
        ("    - run_0.mcap", "    run_0.mcap", "not a sequence"),
        ("custom_data: ~", "custom_data: [1]", "not a mapping"),
        ("duration:", "duration: [", "not YAML"),
    ],
)
def test_wrong_fields_are_named(old: str, new: str, said: str) -> None:
    with pytest.raises(BagError, match=said.replace("[", r"\[")):
        parse_metadata(JAZZY_TEXT.replace(old, new, 1))


def test_read_metadata_takes_directory_or_file(tmp_path: Path) -> None:
    file = tmp_path / "metadata.yaml"
    file.write_text(JAZZY_TEXT)
    assert read_metadata(tmp_path) == read_metadata(str(file)) == JAZZY


def test_unreadable_files(tmp_path: Path) -> None:
    with pytest.raises(BagError, match="no such file; give the directory"):
        read_metadata(tmp_path)
    (tmp_path / "metadata.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(BagError, match="not UTF-8"):
        read_metadata(tmp_path)


def test_bad_profiles_are_refused() -> None:
    with pytest.raises(ValueError, match="durability is 'forever'; use one of"):
        QosProfile("keep_last", 5, "reliable", "forever")
    with pytest.raises(ValueError, match="depth is -1"):
        QosProfile("keep_last", -1, "reliable", "volatile")
