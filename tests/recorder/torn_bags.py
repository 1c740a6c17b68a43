"""A recorded bag, and how many whole messages are left of it when it is cut at any byte.

The count comes from what was noted while recording, from the chunk index of the mcap library and
from zstandard: nothing here is asked of the code that reads torn bags.
"""

from __future__ import annotations

import random
import shutil
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path

import pytest
import zstandard
from mcap.reader import SeekingReader
from rosbags.highlevel import AnyReader

from recorder.bag import BagInformation, RawMessage
from recorder.errors import RecorderError
from recorder.recovery import Recovered, recover
from recorder.writer import BagWriter
from tests.recorder.samples import door_messages, door_topics, strings, talk

RUN_RECORD = {"madrob_run": {"setup": '{"team": "Ärger"}'}}
_FRAME_BYTES = 9
_MESSAGE_HEAD_BYTES = _FRAME_BYTES + 2 + 4 + 8 + 8


@dataclass(frozen=True)
class Chunk:
    """A chunk of the file: where its compressed data lie and what they unpack to, byte by byte."""

    start: int
    data_start: int
    end: int
    unpacked: Sequence[int]
    message_ends: Sequence[int]

    def whole_messages(self, cut: int) -> int:
        if cut >= self.end:
            return len(self.message_ends)
        if cut < self.data_start:
            return 0
        return bisect_right(self.message_ends, self.unpacked[cut - self.data_start])


class TornBag:
    """Bytes and messages of a finished bag of three chunks, the last two of two blocks each."""

    def __init__(self, folder: Path) -> None:
        parts = [door_messages(rounds=20), _talk(90, 2500), _talk(70, 2500)]
        with BagWriter(folder, door_topics(), RUN_RECORD, flush_period=1e6) as writer:
            for number, part in enumerate(parts):
                if number == 1:
                    writer.add_topic(talk())
                for message in part:
                    assert writer.put_message(message)
                writer.add_record(f"note {number}", {"ends": "a chunk"})
        self.data = (folder / f"{folder.name}_0.mcap").read_bytes()
        self.messages = [message for part in parts for message in part]
        with (folder / f"{folder.name}_0.mcap").open("rb") as file:
            summary = SeekingReader(file).get_summary()
        assert summary is not None
        self.chunks = []
        for index, part in zip(summary.chunk_indexes, parts, strict=True):
            sizes = [_MESSAGE_HEAD_BYTES + len(message.data) for message in part]
            ends = list(accumulate(sizes, initial=index.uncompressed_size - sum(sizes)))[1:]
            end = index.chunk_start_offset + index.chunk_length
            start = end - index.compressed_size
            table = _unpacked_sizes(self.data[start:end])
            assert table[-1] == index.uncompressed_size
            self.chunks.append(Chunk(index.chunk_start_offset, start, end, table, ends))

    def whole_messages(self, cut: int) -> int:
        """How many messages lie whole in the first `cut` bytes."""
        return sum(chunk.whole_messages(cut) for chunk in self.chunks)

    def last_two_chunks(self) -> range:
        """Every cut that goes through them."""
        return range(self.chunks[-2].start, self.chunks[-1].end)


def _talk(count: int, length: int) -> list[RawMessage]:
    """Long messages that compress well, so that a chunk of several blocks takes few cuts."""
    source = random.Random(count)
    words = ["".join(source.choices("abcdefgh", k=7)) for _ in range(30)]
    sentences = [" ".join(source.choices(words, k=40)) for _ in range(8)]
    texts = [" ".join(source.choices(sentences, k=length // 320)) for _ in range(count)]
    return strings([f"{number} {text}" for number, text in enumerate(texts)])


def _unpacked_sizes(packed: bytes) -> list[int]:
    """To how many bytes the first 0, 1, 2, ... bytes unpack."""
    decompressor = zstandard.ZstdDecompressor().decompressobj()
    sizes = (
        len(decompressor.decompress(packed[place : place + 1])) for place in range(len(packed))
    )
    return list(accumulate(sizes, initial=0))


def place_torn(bag: TornBag, folder: Path, cut: int) -> Path:
    """A bag folder as a kill leaves it; returns its recording."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    recording = folder / f"{folder.name}_0.mcap"
    recording.write_bytes(bag.data[:cut])
    if cut % 2:
        started = BagInformation(recording.name, door_topics(), {}, None, None)
        (folder / "metadata.yaml").write_text(started.metadata_yaml())
    return recording


def check_cut(bag: TornBag, folder: Path, cut: int) -> Recovered:
    """Cut, repair, and read with the readers of others."""
    recording = place_torn(bag, folder, cut)
    recovered = recover(folder)
    count = bag.whole_messages(cut)
    assert recovered.messages == count, cut
    assert recovered.torn is not None, cut
    assert recovered.torn.read_bytes() == bag.data[:cut], cut
    expected = [(m.topic, m.data, m.publish_ns, m.receive_ns) for m in bag.messages[:count]]
    assert by_mcap(recording) == expected, cut
    stored = sorted((m.receive_ns, m.topic, m.data) for m in bag.messages[:count])
    assert by_rosbags(folder) == stored, cut
    return recovered


def by_mcap(recording: Path) -> list[tuple[str, bytes, int, int]]:
    """Topic, bytes, publish and log time by the seeking reader of the mcap library."""
    with recording.open("rb") as file:
        reader = SeekingReader(file, validate_crcs=True)
        return [
            (channel.topic, message.data, message.publish_time, message.log_time)
            for _, channel, message in reader.iter_messages(log_time_order=False)
        ]


def by_rosbags(folder: Path) -> list[tuple[int, str, bytes]]:
    """Log time, topic and bytes by rosbags, sorted."""
    with AnyReader([folder]) as reader:
        return sorted(
            (time, connection.topic, bytes(data)) for connection, time, data in reader.messages()
        )


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def contents(folder: Path) -> dict[str, tuple[int, bytes]]:
    """Every file, with the node it lies in."""
    return {path.name: (path.stat().st_ino, path.read_bytes()) for path in folder.iterdir()}


def refusal(path: Path) -> str:
    with pytest.raises(RecorderError) as caught:
        recover(path)
    text = str(caught.value)
    assert "\n" not in text
    return text


def middle(bag: TornBag) -> int:
    """A cut through the last chunk, behind its first block."""
    return bag.chunks[-1].end - 10
