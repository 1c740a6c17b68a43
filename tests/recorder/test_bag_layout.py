"""The facts that make a folder a rosbag2 bag, for every reader there is."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import SeekingReader
from mcap.summary import Summary
from rosbags.rosbag2 import Reader

from recorder.bag import BagInformation, Durability, Qos, Reliability, parse_qos, qos_text
from recorder.reader import read_bag
from recorder.writer import BagWriter
from tests.recorder.samples import BEST_EFFORT, LATCHED, door_messages, door_topics

NEVER = {"sec": 9223372036, "nsec": 854775807}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bags") / "run"
    with BagWriter(folder, door_topics(), {"madrob_run": {"setup": "{}"}}) as writer:
        for message in door_messages(rounds=10):
            writer.put(message)
    return folder


@pytest.fixture(scope="module")
def summary(folder: Path) -> Summary:
    with (folder / "run_0.mcap").open("rb") as file:
        summary = SeekingReader(file, validate_crcs=True).get_summary()
    assert summary is not None
    return summary


@pytest.fixture
def information(folder: Path) -> dict[str, Any]:
    document = yaml.safe_load((folder / "metadata.yaml").read_text())
    assert list(document) == ["rosbag2_bagfile_information"]
    information: dict[str, Any] = document["rosbag2_bagfile_information"]
    return information


def test_metadata_yaml_has_every_key_of_version_9(information: dict[str, Any]) -> None:
    times = [message.receive_ns for message in door_messages(rounds=10)]
    span = {
        "duration": {"nanoseconds": max(times) - min(times)},
        "starting_time": {"nanoseconds_since_epoch": min(times)},
        "message_count": 60,
    }
    topics = information.pop("topics_with_message_count")
    assert information == {
        "version": 9,
        "storage_identifier": "mcap",
        **span,
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": ["run_0.mcap"],
        "files": [{"path": "run_0.mcap", **span}],
        "custom_data": None,
        "ros_distro": "jazzy",
    }
    assert [topic["message_count"] for topic in topics] == [10] * 6
    assert topics[0]["topic_metadata"] == {
        "name": "/madrob/door/angle",
        "type": "sensor_msgs/msg/JointState",
        "serialization_format": "cdr",
        "offered_qos_profiles": [
            {
                "history": "unknown",
                "depth": 0,
                "reliability": "best_effort",
                "durability": "volatile",
                "deadline": NEVER,
                "lifespan": NEVER,
                "liveliness": "automatic",
                "liveliness_lease_duration": NEVER,
                "avoid_ros_namespace_conventions": False,
            }
        ],
        "type_description_hash": door_topics()[0].type_hash,
    }


def test_a_folder_whose_name_is_no_text_can_be_recorded_to(tmp_path: Path) -> None:
    folder = tmp_path / os.fsdecode(b"run \xff")
    with BagWriter(folder, door_topics(), {}) as writer:
        assert all(writer.put(message) for message in door_messages(rounds=1))
    assert writer.close().error is None
    assert len(list(read_bag(folder).messages())) == 6


def test_metadata_yaml_uses_no_anchors(folder: Path) -> None:
    text = (folder / "metadata.yaml").read_text()
    assert "&" not in text
    assert "*" not in text


def test_channels_say_the_same_as_metadata_yaml(folder: Path, summary: Summary) -> None:
    document = yaml.safe_load((folder / "metadata.yaml").read_text())
    in_yaml = {
        topic["topic_metadata"]["name"]: topic["topic_metadata"]
        for topic in document["rosbag2_bagfile_information"]["topics_with_message_count"]
    }
    assert len(summary.channels) == len(in_yaml) == 6
    for channel in summary.channels.values():
        there = in_yaml[channel.topic]
        schema = summary.schemas[channel.schema_id]
        assert channel.message_encoding == "cdr"
        assert schema.name == there["type"]
        assert channel.metadata["topic_type_hash"] == there["type_description_hash"]
        assert (
            yaml.safe_load(channel.metadata["offered_qos_profiles"])
            == there["offered_qos_profiles"]
        )


def test_schemas_hold_their_dependencies_as_rosbag2_writes_them(summary: Summary) -> None:
    schemas = {schema.name: schema for schema in summary.schemas.values()}
    assert set(summary.schemas) == set(range(1, 7))
    assert {schema.encoding for schema in schemas.values()} == {"ros2msg"}
    text = schemas["geometry_msgs/msg/WrenchStamped"].data.decode()
    separator = "=" * 80 + "\nMSG: "
    assert {part.split("\n")[0] for part in text.split(separator)[1:]} >= {
        "geometry_msgs/Wrench",
        "geometry_msgs/Vector3",
        "std_msgs/Header",
        "builtin_interfaces/Time",
    }


def test_the_file_has_index_statistics_and_checksums(folder: Path, summary: Summary) -> None:
    assert summary.statistics is not None
    assert summary.statistics.message_count == 60
    assert summary.statistics.channel_count == 6
    assert summary.statistics.metadata_count == 2
    assert {index.compression for index in summary.chunk_indexes} == {"zstd"}
    assert all(index.message_index_offsets for index in summary.chunk_indexes)
    with (folder / "run_0.mcap").open("rb") as file:
        reader = SeekingReader(file, validate_crcs=True)
        assert len(list(reader.iter_messages())) == 60
        header = reader.get_header()
    assert header.profile == "ros2"
    assert header.library.startswith("madrob recorder")


def test_the_record_rosbag2_repeats_metadata_yaml(
    folder: Path, information: dict[str, Any]
) -> None:
    with (folder / "run_0.mcap").open("rb") as file:
        records = {record.name: record.metadata for record in SeekingReader(file).iter_metadata()}
    assert set(records) == {"madrob_run", "rosbag2"}
    again = yaml.safe_load(records["rosbag2"]["serialized_metadata"])
    again.pop("topics_with_message_count")
    information.pop("topics_with_message_count")
    assert again == information


def test_rosbags_finds_the_qos_of_every_topic(folder: Path) -> None:
    with Reader(folder) as reader:
        assert reader.ros_distro == "jazzy"
        assert reader.message_count == 60
        found = {
            connection.topic: connection.ext.offered_qos_profiles[0]  # type: ignore[union-attr]
            for connection in reader.connections
        }
    assert found["/madrob/door/angle"].reliability.name == "BEST_EFFORT"
    assert found["/madrob/referee/event"].reliability.name == "RELIABLE"
    assert found["/madrob/referee/start_pose"].durability.name == "TRANSIENT_LOCAL"


def test_an_empty_bag_starts_at_the_end_of_time() -> None:
    text = BagInformation("a_0.mcap", door_topics(), {}, None, None).metadata_yaml()
    information = yaml.safe_load(text)["rosbag2_bagfile_information"]
    assert information["starting_time"] == {"nanoseconds_since_epoch": 2**63 - 1}
    assert information["duration"] == {"nanoseconds": 0}
    assert information["message_count"] == 0
    assert len(information["topics_with_message_count"]) == 6


@pytest.mark.parametrize("qos", [Qos(), BEST_EFFORT, LATCHED])
def test_qos_survives_its_text(qos: Qos) -> None:
    assert parse_qos(qos_text(qos)) == qos


@pytest.mark.parametrize(
    ("text", "qos"),
    [
        (
            "- reliability: 2\n  durability: 1\n",
            Qos(Reliability.BEST_EFFORT, Durability.TRANSIENT_LOCAL),
        ),
        ("- reliability: 1\n  durability: 2\n", Qos()),
        ("[{reliability: reliable}, {reliability: best_effort}]", BEST_EFFORT),
        ("[{durability: transient_local}, {durability: volatile}]", Qos()),
        ("", Qos()),
        ("[", Qos()),
        ("a: b", Qos()),
        ("[1, 2]", Qos()),
        ("[" * 600, Qos()),
        ('!!int ""', Qos()),
        ("!!timestamp x", Qos()),
    ],
)
def test_qos_of_older_recordings_and_of_several_publishers(text: str, qos: Qos) -> None:
    assert parse_qos(text) == qos


@given(st.text())
def test_no_qos_text_can_break_the_reader(text: str) -> None:
    assert isinstance(parse_qos(text), Qos)
