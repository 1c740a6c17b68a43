"""What is recorded is read back identically, here and by the readers of others."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from recorder.bag import MAX_NS, Topic
from recorder.message import RawMessage
from recorder.reader import read_bag
from recorder.writer import BagWriter
from tests.recorder.samples import door_messages, door_topics, strings, talk

SETUP = {"setup": json.dumps({"subject": 1, "team": "Größe"})}

READ_WITH_MCAP_CORE = """
const { McapIndexedReader } = require("@mcap/core");
const { loadDecompressHandlers } = require("@mcap/support");
const bytes = require("fs").readFileSync(process.argv[1]);
const readable = {
  size: async () => BigInt(bytes.length),
  read: async (offset, size) => bytes.subarray(Number(offset), Number(offset + size)),
};
(async () => {
  const decompressHandlers = await loadDecompressHandlers();
  const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers });
  const messages = [];
  for await (const m of reader.readMessages({ validateCrcs: true })) {
    messages.push([
      reader.channelsById.get(m.channelId).topic, Buffer.from(m.data).toString("hex"),
      String(m.publishTime), String(m.logTime),
    ]);
  }
  console.log(JSON.stringify(messages));
})();
"""


@pytest.fixture(scope="module")
def recorded() -> list[RawMessage]:
    return door_messages(rounds=50)


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory, recorded: list[RawMessage]) -> Path:
    folder = tmp_path_factory.mktemp("bags") / "subject_001"
    with BagWriter(folder, door_topics(), {"madrob_run": SETUP}) as writer:
        assert all(writer.put(message) for message in recorded)
    return folder


def by_time(messages: list[RawMessage]) -> list[RawMessage]:
    return sorted(messages, key=lambda message: message.receive_ns)


def test_a_bag_reads_back_as_it_was_recorded(bag: Path, recorded: list[RawMessage]) -> None:
    read = read_bag(bag)
    assert list(read.messages()) == recorded
    assert read.topics() == door_topics()
    assert read.records["madrob_run"] == SETUP
    assert read.complete
    assert read.problem is None


def test_the_file_alone_reads_like_the_folder(bag: Path, recorded: list[RawMessage]) -> None:
    read = read_bag(bag / "subject_001_0.mcap")
    assert list(read.messages()) == recorded
    assert read.complete


def test_messages_can_be_read_twice(bag: Path) -> None:
    read = read_bag(bag)
    assert list(read.messages()) == list(read.messages())


def test_rosbags_reads_the_same(bag: Path, recorded: list[RawMessage]) -> None:
    with AnyReader([bag]) as reader:
        read = [(c.topic, c.msgtype, bytes(data), t) for c, t, data in reader.messages()]
        angle = next(c for c in reader.connections if c.topic == "/madrob/door/angle")
        *_, (_, _, data) = reader.messages([angle])
        assert reader.deserialize(data, angle.msgtype).position.tolist() == [0.49]  # type: ignore[attr-defined]
    assert read == [(m.topic, m.type, m.data, m.receive_ns) for m in by_time(recorded)]


def test_mcap_ros2_decodes_it_by_the_schemas_of_the_file(
    bag: Path, recorded: list[RawMessage]
) -> None:
    decoded: dict[str, Any] = {}
    raw = []
    with (bag / "subject_001_0.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for schema, channel, message, value in reader.iter_decoded_messages():
            assert schema is not None
            raw.append(
                RawMessage(
                    channel.topic,
                    schema.name,
                    message.data,
                    message.publish_time,
                    message.log_time,
                )
            )
            decoded[channel.topic] = value
    assert raw == by_time(recorded)
    assert list(decoded["/madrob/door/angle"].position) == [0.49]
    assert decoded["/madrob/handle/force"].wrench.force.x == 49.0
    assert list(decoded["/madrob/passage/cw_left"].ranges)[:3] == [1.0, 2.0, float("inf")]
    assert decoded["/madrob/door/locked"].data is False
    assert decoded["/madrob/referee/event"].data == "event 49"
    assert decoded["/madrob/referee/start_pose"].pose.position.y == 49.0
    assert decoded["/madrob/referee/start_pose"].header.frame_id == "madrob_door"


@pytest.mark.machine
def test_mcap_core_of_foxglove_reads_the_same(bag: Path, recorded: list[RawMessage]) -> None:
    node = shutil.which("node")
    if node is None:
        pytest.skip("node is not installed")
    script = [node, "-e", READ_WITH_MCAP_CORE, str(bag / "subject_001_0.mcap")]
    done = subprocess.run(script, capture_output=True, text=True, env=os.environ, check=False)
    if "MODULE_NOT_FOUND" in done.stderr:
        pytest.skip("@mcap/core and @mcap/support are not where node looks (NODE_PATH)")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == [
        [m.topic, m.data.hex(), str(m.publish_ns), str(m.receive_ns)] for m in by_time(recorded)
    ]


TIMES = st.integers(min_value=0, max_value=MAX_NS - 1)
TOPICS = tuple(Topic(f"/t{number}", "test_msgs/msg/Blob", "uint8[] data\n") for number in range(3))
MESSAGES = st.builds(
    RawMessage,
    topic=st.sampled_from([topic.name for topic in TOPICS]),
    type=st.just("test_msgs/msg/Blob"),
    data=st.binary(max_size=300),
    publish_ns=TIMES,
    receive_ns=TIMES,
)


@settings(max_examples=25)
@given(st.lists(MESSAGES, max_size=40), st.integers(min_value=512, max_value=20_000))
def test_any_bytes_and_times_survive_in_their_order(
    messages: list[RawMessage], queue_bytes: int
) -> None:
    with tempfile.TemporaryDirectory() as parent:
        folder = Path(parent) / "bag"
        writer = BagWriter(folder, TOPICS, {}, queue_bytes=queue_bytes, block_when_full=True)
        writer.open()
        fits = [writer.put(message) for message in messages]
        summary = writer.close()
        kept = [message for message, fit in zip(messages, fits, strict=True) if fit]
        read = read_bag(folder)
        assert list(read.messages()) == kept
        assert read.complete
        assert sum(summary.counts.values()) == len(kept)
        assert all(
            fit or len(m.data) + 256 > queue_bytes for m, fit in zip(messages, fits, strict=True)
        )
        if kept:
            assert summary.start_ns == min(message.receive_ns for message in kept)
            assert summary.end_ns == max(message.receive_ns for message in kept)


def test_a_topic_that_appears_while_recording_is_recorded(tmp_path: Path) -> None:
    late = strings(["late"], name="/late")
    early = strings(["early"])
    with BagWriter(tmp_path / "bag", [talk()], {}) as writer:
        writer.put(early[0])
        assert writer.add_topic(Topic("/late", talk().type, talk().definition))
        assert writer.put(late[0])
    read = read_bag(tmp_path / "bag")
    assert list(read.messages()) == early + late
    assert [topic.name for topic in read.topics()] == ["/talk", "/late"]
    with AnyReader([tmp_path / "bag"]) as reader:
        assert [c.topic for c, _, _ in reader.messages()] == ["/talk", "/late"]


def test_a_record_added_while_recording_is_kept_and_the_last_of_a_name_counts(
    tmp_path: Path,
) -> None:
    with BagWriter(tmp_path / "bag", [talk()], {"madrob_run": {"n": "1"}}) as writer:
        writer.put(strings(["a"])[0])
        assert writer.add_record("madrob_run", {"n": "2"})
        assert writer.add_record("note", {"text": "a stray byte \udcff, as a terminal may send"})
    read = read_bag(tmp_path / "bag")
    assert read.complete
    assert read.records["madrob_run"] == {"n": "2"}
    assert read.records["note"] == {"text": "a stray byte \\udcff, as a terminal may send"}


def test_an_empty_bag_is_complete_and_knows_its_topics(tmp_path: Path) -> None:
    BagWriter(tmp_path / "bag", door_topics(), {"madrob_run": SETUP}).__enter__().close()
    read = read_bag(tmp_path / "bag")
    assert list(read.messages()) == []
    assert read.complete
    assert read.topics() == door_topics()
    with AnyReader([tmp_path / "bag"]) as reader:
        assert reader.message_count == 0
        assert len(reader.connections) == len(door_topics())
