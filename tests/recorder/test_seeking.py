from __future__ import annotations

import os
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType, IndexType, Writer

from recorder.bag import evidence_file_name
from recorder.errors import RecorderError
from recorder.message import RawMessage
from recorder.reader import read_bag
from recorder.seeking import Seeker
from tests.recorder.samples import START_NS, add_evidence, door_messages, door_topics, strings, talk

ROUNDS = 40
ANGLE = "/madrob/door/angle"


def _write(
    path: Path,
    messages: list[RawMessage],
    *,
    compression: CompressionType = CompressionType.ZSTD,
    indexes: IndexType = IndexType.ALL,
    chunk_size: int = 2000,
) -> Path:
    """A recording as other programs write it."""
    with path.open("wb") as file:
        writer = Writer(file, chunk_size, compression, index_types=indexes)
        writer.start("ros2")
        channels = {}
        for known in (*door_topics(), talk()):
            schema = writer.register_schema(known.type, "ros2msg", known.definition.encode())
            channels[known.name] = writer.register_channel(known.name, "cdr", schema)
        for number, one in enumerate(messages):
            writer.add_message(
                channels[one.topic], one.receive_ns, one.data, one.publish_ns, number
            )
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def _all(seeker: Seeker, name: str) -> list[RawMessage]:
    found = seeker.between(name, 0, 2**63)
    return [seeker.message(one, 1_000_000) for one in found]


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("indexes", [IndexType.ALL, IndexType.CHUNK, IndexType.NONE])
def test_every_message_is_found_by_its_time_whoever_wrote_the_file(
    tmp_path: Path, compression: CompressionType, indexes: IndexType
) -> None:
    messages = door_messages(ROUNDS)
    path = _write(tmp_path / "a.mcap", messages, compression=compression, indexes=indexes)
    with Seeker(path) as seeker:
        assert {topic.name for topic in seeker.topics()} == {m.topic for m in messages}
        for topic in seeker.topics():
            expected = [one for one in messages if one.topic == topic.name]
            assert _all(seeker, topic.name) == expected
            middle = expected[len(expected) // 2].receive_ns
            (found,) = seeker.between(topic.name, middle, middle)
            assert seeker.message(found, 1_000_000) in expected
            assert seeker.head(found, 12) == seeker.message(found, 1_000_000).data[:12]


def test_looking_for_one_message_reads_a_small_part_of_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    messages = strings(["x" * 20_000] * 500)
    path = _write(
        tmp_path / "a.mcap", messages, compression=CompressionType.NONE, chunk_size=100_000
    )
    read: list[int] = []
    pread = os.pread

    def counted(number: int, size: int, offset: int) -> bytes:
        data = pread(number, size, offset)
        read.append(len(data))
        return data

    monkeypatch.setattr(os, "pread", counted)
    with Seeker(path) as seeker:
        at = messages[250].receive_ns
        (found,) = seeker.between("/talk", at, at)
        assert seeker.message(found, 100_000) == messages[250]
    assert sum(read) < 2 * 20_000


def test_evidence_is_looked_for_apart_from_what_is_scored(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    _write(folder / "run_0.mcap", door_messages(3))
    add_evidence(folder, strings(["one", "two"]))
    add_evidence(folder, strings(["three"]), number=1)
    with Seeker(folder, evidence=True) as seeker:
        assert [topic.name for topic in seeker.topics()] == ["/talk"]
        assert len(_all(seeker, "/talk")) == 3
        assert seeker.problems == []
    with Seeker(folder) as seeker:
        assert len(_all(seeker, ANGLE)) == 3


def test_a_bag_without_evidence_has_no_topics(tmp_path: Path) -> None:
    with Seeker(tmp_path, evidence=True) as seeker:
        assert seeker.topics() == ()
        assert seeker.between("/talk", 0, 2**63) == []


def test_what_cannot_be_read_is_named(tmp_path: Path) -> None:
    with pytest.raises(RecorderError, match="holds no recording"):
        Seeker(tmp_path)
    (tmp_path / evidence_file_name("run", 0)).write_bytes(b"no recording")
    add_evidence(tmp_path, strings(["there"]), number=1)
    with Seeker(tmp_path, evidence=True) as seeker:
        assert "does not begin like an MCAP file" in seeker.problems[0]
        assert len(_all(seeker, "/talk")) == 1


def test_a_message_larger_than_the_limit_is_refused_before_memory_is_taken(tmp_path: Path) -> None:
    path = _write(tmp_path / "a.mcap", strings(["x" * 5000]))
    with Seeker(path) as seeker:
        (found,) = seeker.between("/talk", 0, 2**63)
        with pytest.raises(RecorderError, match="/talk: it has more than 0 MB"):
            seeker.message(found, 4000)


def test_a_spread_covers_the_whole_recording(tmp_path: Path) -> None:
    messages = door_messages(400)
    path = _write(tmp_path / "a.mcap", messages)
    with Seeker(path) as seeker:
        found = [one.log_ns for one in seeker.spread(ANGLE, 10)]
    length = 400 * 20_000_000
    assert found == sorted(found)
    assert found[0] < START_NS + length / 5
    assert found[-1] > START_NS + length * 4 / 5
    assert max(b - a for a, b in pairwise(found)) < length / 5


@given(cut=st.floats(0, 1), indexes=st.sampled_from([IndexType.ALL, IndexType.NONE]))
@settings(max_examples=60, deadline=None)
def test_a_torn_file_gives_what_was_whole(
    tmp_path_factory: pytest.TempPathFactory, cut: float, indexes: IndexType
) -> None:
    path = tmp_path_factory.mktemp("torn") / "a.mcap"
    data = _write(path, door_messages(ROUNDS), indexes=indexes).read_bytes()
    path.write_bytes(data[: int(cut * len(data))])
    with Seeker(path) as seeker:
        found = {topic.name: _all(seeker, topic.name) for topic in seeker.topics()}
    try:
        there = list(read_bag(path).messages())
    except RecorderError:
        there = []
    known = {(one.topic, one.receive_ns) for messages in found.values() for one in messages}
    whole = [(one.topic, one.receive_ns) for one in there]
    assert known <= set(whole)
    most_in_a_chunk = 2 * 2000 // 50
    assert len(known) >= len(whole) - most_in_a_chunk


@given(place=st.floats(0, 1), value=st.binary(min_size=1, max_size=9))
@settings(max_examples=150, deadline=None)
def test_a_damaged_file_never_ends_in_another_error(
    tmp_path_factory: pytest.TempPathFactory, place: float, value: bytes
) -> None:
    path = tmp_path_factory.mktemp("damaged") / "a.mcap"
    data = bytearray(_write(path, door_messages(10)).read_bytes())
    at = int(place * (len(data) - 1))
    data[at : at + len(value)] = value
    path.write_bytes(data)
    with Seeker(path) as seeker:
        for topic in seeker.topics():
            seeker.spread(topic.name, 5)
            for found in seeker.between(topic.name, 0, 2**63):
                try:
                    seeker.head(found, 12)
                    seeker.message(found, 10_000)
                except RecorderError:
                    continue
