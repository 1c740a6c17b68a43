"""A torn bag becomes a bag again, with everything in it that is whole."""

from __future__ import annotations

import os
import random
import resource
import shutil
import time
from bisect import bisect_right
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from io import BytesIO
from itertools import accumulate
from pathlib import Path

import lz4.frame  # type: ignore[import-untyped]
import pytest
import yaml
import zstandard
from mcap.records import Channel, Chunk, Message, Schema
from mcap.writer import MCAP0_MAGIC, CompressionType, IndexType
from msgspec.structs import replace as replaced

from recorder import RecorderError
from recorder.bag import BagInformation, RawMessage, Topic
from recorder.reader import Bag
from recorder.recovery import Recovered, recover
from recorder.writer import BagWriter
from tests.recorder.samples import (
    Killed,
    all_within,
    by_library,
    by_mcap,
    by_rosbags,
    contents,
    door_messages,
    door_topics,
    encoded,
    in_order,
    killed_after,
    limited,
    little_memory,
    raw_by_mcap,
    strings,
    talk,
)

MESSAGES = strings([f"number {number} " + "x" * 900 for number in range(300)])
TOPIC = Topic("/blob", "test_msgs/msg/Blob", "uint8[] data\n")
RUN_RECORD = {"madrob_run": {"setup": '{"team": "Ärger"}'}}
REPAIRED = ["bag_0.mcap", "bag_0.mcap.torn", "metadata.yaml"]


class TornBag:
    """A finished bag of three chunks, the last two of two blocks each, and what a cut leaves of it.

    What is left comes from what was noted while recording, from the chunk index of the mcap library
    and from zstandard: nothing here is asked of the code that reads torn bags.
    """

    def __init__(self, folder: Path) -> None:
        topics = {topic.name: topic for topic in door_topics()[::4]}  # few are soon parsed
        door = [message for message in door_messages(rounds=60) if message.topic in topics]
        parts = [door, _talk(90, 2500), _talk(70, 2500)]
        with BagWriter(folder, [*topics.values()], RUN_RECORD, flush_period=1e6) as writer:
            for number, part in enumerate(parts):
                if number == 1:
                    writer.add_topic(talk())
                assert writer.put_all(part) == len(part)
                writer.add_record(f"note {number}", {"ends": "a chunk"})
        self.data = (folder / "bag_0.mcap").read_bytes()
        self.messages = [message for part in parts for message in part]
        self.counts = [len(part) for part in parts]
        self.chunks: list[range] = []
        """The compressed data of each."""
        self.whole: list[int] = [0]
        """How many messages lie whole in the first 0, 1, 2, ... bytes."""
        indexes = by_mcap(BytesIO(self.data))[0].chunk_indexes
        self.starts = [index.chunk_start_offset for index in indexes]
        for index, part in zip(indexes, parts, strict=True):
            sizes, before = [31 + len(message.data) for message in part], self.whole[-1]
            ends = list(accumulate(sizes, initial=index.uncompressed_size - sum(sizes)))[1:]
            end = index.chunk_start_offset + index.chunk_length
            self.chunks.append(range(end - index.compressed_size, end))
            self.whole += [before] * (self.chunks[-1].start + 1 - len(self.whole))
            unpacker, unpacked = zstandard.ZstdDecompressor().decompressobj(), 0
            for place in self.chunks[-1]:
                unpacked += len(unpacker.decompress(self.data[place : place + 1]))
                self.whole.append(before + bisect_right(ends, unpacked))
            assert self.whole[-1] == before + len(part)
        self.whole += [self.whole[-1]] * (len(self.data) - len(self.whole))
        self.middle = end - 10
        """A cut through the last chunk, behind its first block."""

    def placed(self, folder: Path, cut: int, data: bytes | bytearray | None = None) -> Path:
        """A bag folder as a kill leaves it, with other data where they are named; its recording."""
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        recording = folder / f"{folder.name}_0.mcap"
        recording.write_bytes(self.data[:cut] if data is None else data)
        if cut % 2:
            started = BagInformation(recording.name, door_topics()[::4], {}, None, None)
            (folder / "metadata.yaml").write_text(started.metadata_yaml())
        return recording

    def check_cut(self, folder: Path, cut: int) -> int:
        """Cut, repair, and read with the readers of others."""
        recording, expected = self.placed(folder, cut), self.messages[: self.whole[cut]]
        recovered = recover(folder)
        assert recovered.messages == len(expected), cut
        assert recovered.torn is not None, cut
        assert recovered.torn.read_bytes() == self.data[:cut], cut
        assert raw_by_mcap(recording) == expected, cut
        assert by_rosbags(folder) == in_order(expected), cut
        return recovered.messages


def _talk(count: int, length: int) -> list[RawMessage]:
    """Long messages that compress well, so that a chunk of several blocks takes few cuts."""
    source = random.Random(count)
    words = ["".join(source.choices("abcdefgh", k=7)) for _ in range(30)]
    sentences = [" ".join(source.choices(words, k=40)) for _ in range(8)]
    texts = [" ".join(source.choices(sentences, k=length // 320)) for _ in range(count)]
    return strings([f"{number} {text}" for number, text in enumerate(texts)])


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def refusal(path: Path) -> str:
    with pytest.raises(RecorderError) as caught:
        recover(path)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def blob(number: int, size: int) -> RawMessage:
    """A message with its number in front, of bytes that cannot be compressed."""
    now = time.time_ns()
    return RawMessage(TOPIC.name, TOPIC.type, number.to_bytes(4) + os.urandom(size), now, now)


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> TornBag:
    return TornBag(tmp_path_factory.mktemp("whole") / "bag")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "bag"


def test_a_cut_anywhere_costs_only_what_is_behind_it(bag: TornBag, folder: Path) -> None:
    """Where a chunk or a block begins or ends, and a byte to either side; and elsewhere."""
    blocks = [cut for cut in range(1, len(bag.data)) if bag.whole[cut] != bag.whole[cut - 1]]
    edges = [8, len(bag.data) - 1, *bag.starts, *blocks]
    edges += [edge for chunk in bag.chunks for edge in (chunk.start, chunk.stop)]
    near = {place + step for place in edges for step in (-1, 0, 1)} & {*range(8, len(bag.data))}
    cuts = random.Random(0).sample(sorted(near), 20)
    for cut in (*cuts, *random.Random(1).sample(range(8, len(bag.data)), 12)):
        bag.check_cut(folder, cut)


def test_a_cut_within_the_first_eight_bytes_leaves_nothing_to_keep(
    bag: TornBag, folder: Path
) -> None:
    for cut in range(8):
        bag.placed(folder, cut)
        before = contents(folder)
        assert "is no bag: it " in refusal(folder)
        assert contents(folder) == before


def test_a_torn_bag_becomes_a_bag_that_says_what_it_lost(bag: TornBag, folder: Path) -> None:
    cut = bag.middle // 2 * 2 + 1
    recording, listing = bag.placed(folder, cut), folder / "metadata.yaml"
    torn = Bag(folder)
    before = list(torn.messages())
    recovered, tail = recover(folder), cut - bag.starts[-1]
    kept, (words,) = recording.with_name("bag_0.mcap.torn"), recovered.cut
    assert recovered == Recovered(recording, len(before), kept, listing, (words,), tail)
    repaired = Bag(folder)
    assert (list(repaired.messages()), repaired.complete) == (before, False)
    assert repaired.problem == torn.problem
    assert words in (torn.problem or "")
    with recording.open("rb") as file:
        found, whole = by_mcap(file)[0], by_mcap(BytesIO(bag.data))[0]
    assert (found.schemas, found.channels) == (whole.schemas, whole.channels)
    expected = {**RUN_RECORD, **{f"note {number}": {"ends": "a chunk"} for number in (0, 1)}}
    assert [index.name for index in found.metadata_indexes] == [*expected, "recovery", "rosbag2"]
    assert expected.items() <= repaired.records.items()
    times = [message.receive_ns for message in before]
    counts = Counter(message.topic for message in before)
    told = BagInformation("bag_0.mcap", list(repaired.topics()), counts, min(times), max(times))
    assert yaml.safe_load(listing.read_text()) == yaml.safe_load(told.metadata_yaml())


@pytest.mark.parametrize(
    "content",
    [
        *(
            by_library(MESSAGES[:100], **options)
            for options in (
                {"use_statistics": False},
                {"repeat_channels": False, "repeat_schemas": False},
                {"repeat_schemas": False},
                {"index_types": IndexType.NONE},
                {"use_chunking": False, "enable_crcs": False},
            )
        ),
    ],
)
def test_what_a_valid_file_may_hold_is_no_damage(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "other.mcap").write_bytes(content)
    recovered = recover(tmp_path / "other.mcap")
    assert (recovered.cut, recovered.torn, recovered.messages) == ((), None, 100)
    read = Bag(tmp_path / "other.mcap")
    assert [replaced(message, sequence=0) for message in read.messages()] == MESSAGES[:100]
    assert read.complete
    assert (tmp_path / "other.mcap").read_bytes() == content
    assert names(tmp_path) == ["metadata.yaml", "other.mcap"]


def test_a_large_file_takes_little_memory(folder: Path) -> None:
    with BagWriter(folder, [TOPIC], {}) as writer:
        writer.put_all([blob(number, 500_000) for number in range(100)])
    recording = folder / "bag_0.mcap"
    os.truncate(recording, recording.stat().st_size - 100)
    with little_memory(25_000_000):
        assert recover(folder).messages == 100


def test_to_repair_twice_is_harmless_and_what_is_torn_again_is_kept_again(
    bag: TornBag, folder: Path
) -> None:
    recording, count = bag.placed(folder, bag.middle), bag.whole[bag.middle]
    assert recover(folder).changed
    before = contents(folder)
    assert recover(folder) == Recovered(recording, count, None, None, (), 0)
    assert (contents(folder), names(folder)) == (before, REPAIRED)
    again = recording.read_bytes()[:-400]
    recording.write_bytes(again)
    recovered = recover(folder)
    assert (recovered.torn, recovered.messages) == (folder / "bag_0.mcap.torn.2", count)
    torn = [(folder / f"bag_0.mcap.torn{end}").read_bytes() for end in ("", ".2")]
    assert torn == [bag.data[: bag.middle], again]


@pytest.mark.parametrize(
    "text", [None, "", "rosbag2_bagfile_info", "rosbag2_bagfile_information: {}", "stale"]
)
def test_a_whole_recording_gets_the_metadata_yaml_it_lacks(
    bag: TornBag, folder: Path, text: str | None
) -> None:
    recording = bag.placed(folder, text == "stale", bag.data)
    if text not in {None, "stale"}:
        (folder / "metadata.yaml").write_text(text or "")
    before, count = contents(folder), len(bag.messages)
    told = Recovered(recording, count, None, folder / "metadata.yaml", (), 0)
    assert recover(folder) == told
    after, unchanged = contents(folder), replace(told, metadata=None)
    assert after["bag_0.mcap"] == before["bag_0.mcap"]
    assert [recover(folder), recover(recording)] == [unchanged] * 2  # a whole bag stays as it is
    assert (contents(folder), unchanged.changed) == (after, False)
    assert Bag(folder).complete
    if text not in {None, "stale"}:  # somebody may want to see what it was
        assert contents(folder)["metadata.yaml.torn"] == before["metadata.yaml"]


@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.LZ4])
def test_the_cut_chunk_is_kept_up_to_the_cut_or_the_last_whole_block(
    tmp_path: Path, compression: CompressionType
) -> None:
    data = by_library(MESSAGES, chunk_size=2**30, compression=compression)
    (index,) = by_mcap(BytesIO(data))[0].chunk_indexes
    start = index.chunk_start_offset + index.chunk_length - index.compressed_size
    sizes, whole = [31 + len(message.data) for message in MESSAGES], index.uncompressed_size
    ends = list(accumulate(sizes, initial=whole - sum(sizes)))
    cuts = {size: size for size in (0, ends[0], ends[0] + 40, 5_000, 100_000, whole - 1)}
    if compression is CompressionType.LZ4:
        cuts, frame = {}, lz4.frame.get_frame_info(data[start:])
        place = 7 + 8 * (frame["content_size"] > 0)
        for block in range(1, 5):
            head = data[start + place : start + place + 4]
            place += 4 + (int.from_bytes(head, "little") & 0x7FFF_FFFF)
            cuts[place - 1], cuts[place + 4] = (n * frame["block_size"] for n in (block - 1, block))
    torn = tmp_path / "torn.mcap"
    for cut, size in cuts.items():
        torn.write_bytes(data[: start + cut])
        kept = MESSAGES[: sum(end <= min(size, whole) for end in ends[1:])]
        assert (recover(torn).messages, raw_by_mcap(torn)) == (len(kept), kept), cut


@pytest.mark.parametrize("length", [600, 4500])
def test_sectors_of_zeros_after_a_power_cut_are_not_taken_for_data(
    bag: TornBag, folder: Path, length: int
) -> None:
    """The rest never came to the disk, though the file has its length."""
    cut = bag.chunks[-1].stop - length
    recording = bag.placed(folder, cut, bag.data[:cut] + bytes(length + 100))
    kept = bag.messages[: bag.whole[cut]]
    assert (recover(folder).messages, raw_by_mcap(recording)) == (len(kept), kept)


@pytest.mark.parametrize("number", [0, 1, 2])
@pytest.mark.parametrize("finished", [True, False])
def test_a_damaged_chunk_is_left_out_and_the_rest_is_kept(
    bag: TornBag, folder: Path, number: int, finished: bool
) -> None:
    damaged, chunk = bytearray(bag.data), bag.chunks[number]
    damaged[(chunk.start + chunk.stop) // 2] ^= 4
    recording = bag.placed(folder, 1, damaged if finished else damaged[: bag.chunks[-1].stop])
    before = sum(bag.counts[:number])
    kept = bag.messages[:before] + bag.messages[before + bag.counts[number] :]
    if number < 2 and not finished:  # the channels of later chunks may have stood in it
        kept = kept[:before] if number else []
    recovered = recover(folder)
    assert raw_by_mcap(recording) == kept
    assert recovered.cut[0].startswith("a chunk ")
    assert recovered.cut[0].endswith(f"(byte {bag.starts[number]}); it is left out")
    assert "it is left out" in (Bag(folder).problem or "")


def test_what_is_left_of_a_damaged_bag_has_one_order(tmp_path: Path) -> None:
    """The index says that chunks are out of order; those that are left are not."""
    data = bytearray(
        by_library(MESSAGES[:20][::-1], chunk_size=10_000, compression=CompressionType.NONE)
    )
    data[data.index(b"number 3 ")] ^= 1
    (tmp_path / "a.mcap").write_bytes(data)
    before = list(Bag(tmp_path / "a.mcap").messages())
    assert recover(tmp_path / "a.mcap").messages == len(before)
    assert list(Bag(tmp_path / "a.mcap").messages()) == before


def test_a_chunk_that_claims_more_than_its_record_is_told(tmp_path: Path) -> None:
    data = bytearray(by_library(MESSAGES[:20]))
    (index,) = by_mcap(BytesIO(data))[0].chunk_indexes
    claim = index.chunk_start_offset + index.chunk_length - index.compressed_size - 8
    assert int.from_bytes(data[claim : claim + 8], "little") == index.compressed_size
    data[claim + 3] ^= 1
    (tmp_path / "a.mcap").write_bytes(data)
    (words,) = recover(tmp_path / "a.mcap").cut
    assert "a chunk has a damaged record" in words


def test_of_many_damaged_chunks_three_are_named_and_the_others_counted(tmp_path: Path) -> None:
    data = bytearray(by_library(MESSAGES[:60], chunk_size=1, compression=CompressionType.NONE))
    for number in range(5):
        data[data.index(f"number {number} ".encode())] ^= 1
    (tmp_path / "a.mcap").write_bytes(data)
    recovered = recover(tmp_path / "a.mcap")
    assert (len(recovered.cut), recovered.messages) == (4, 55)
    assert recovered.cut[-1] == "2 more chunks are left out"


def test_a_file_among_others_is_repaired_without_a_metadata_yaml(
    bag: TornBag, folder: Path
) -> None:
    recording = bag.placed(folder, bag.middle // 2 * 2)
    (folder / "other.mcap").write_bytes(bag.data)
    assert "holds 2 recordings; repair each of the files, then" in refusal(folder)
    recovered = recover(recording)
    count = bag.whole[bag.middle // 2 * 2]
    assert (recovered.messages, recovered.metadata) == (count, None)
    assert names(folder) == ["bag_0.mcap", "bag_0.mcap.torn", "other.mcap"]


def test_a_kill_at_any_moment_loses_nothing(
    folder: Path,
) -> None:
    with BagWriter(folder, [talk()], RUN_RECORD, flush_period=1e6) as writer:
        for message in MESSAGES[:20]:
            writer.put_message(message)
        writer.add_record("note", {"ends": "a chunk"})
        writer.put_message(MESSAGES[20])
    torn = (folder / "bag_0.mcap").read_bytes().partition(b"note")[0]
    for steps in range(100):
        shutil.rmtree(folder)
        folder.mkdir()
        (folder / "bag_0.mcap").write_bytes(torn)
        try:
            with killed_after(steps):
                recover(folder)
        except Killed:
            pass
        else:
            break
        assert any(content == torn for _, content in contents(folder).values())
        assert list(Bag(folder).messages()) == MESSAGES[:20]
        assert recover(folder).messages == 20
        assert names(folder) == ["bag_0.mcap", "bag_0.mcap.torn", "metadata.yaml"]
        assert (folder / "bag_0.mcap.torn").read_bytes() == torn
        assert list(Bag(folder).messages()) == MESSAGES[:20]
        assert not recover(folder).changed
    assert 15 < steps < 99


def test_a_full_disk_changes_nothing_and_says_so(bag: TornBag, folder: Path) -> None:
    bag.placed(folder, bag.middle)
    before = contents(folder)
    for limit in (0, 100, 5000):
        with limited(resource.RLIMIT_FSIZE, limit):
            assert refusal(folder) == (
                f"cannot repair {folder}: File too large; nothing is lost, "
                "check the path, and whether its disk has room and can be written"
            )
        assert contents(folder) == before


def test_a_bag_that_is_being_recorded_is_refused(folder: Path) -> None:
    with BagWriter(folder, [talk()], RUN_RECORD, flush_period=0):
        text = refusal(folder)
    assert text == "bag_0.mcap is being written; end its recording or repair, then try again"
    assert not recover(folder).changed


def test_a_file_that_grows_meanwhile_is_refused(
    bag: TornBag, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recording = bag.placed(folder, bag.middle)
    real = os.fdatasync

    def grow(fd: int) -> None:
        real(fd)
        with recording.open("ab") as file:
            file.write(b"more")

    monkeypatch.setattr(os, "fdatasync", grow)
    assert "is being written" in refusal(folder)
    assert "bag_0.mcap.torn" not in names(folder)
    assert "bag_0.mcap.recovering" not in names(folder)


def test_no_link_is_followed_out_of_the_folder(bag: TornBag, folder: Path) -> None:
    recording = bag.placed(folder, bag.middle)
    outside = folder.parent / "outside"
    outside.write_bytes(b"precious")
    for name in ("bag_0.mcap.recovering", "bag_0.mcap.torn", "metadata.yaml.part"):
        (folder / name).symlink_to(outside)
    assert recover(folder).torn == folder / "bag_0.mcap.torn.2"
    recording.rename(folder.parent / "far.mcap")
    recording.symlink_to(folder.parent / "far.mcap")
    assert "Too many levels of symbolic links" in refusal(folder)
    assert outside.read_bytes() == b"precious"


Make = bytes | Callable[[Path], object]
"""What a file holds, or how it is made."""
STRING, BOOL = (
    Schema(number, b"string data\n", "ros2msg", f"std_msgs/msg/{name}")
    for number, name in enumerate(("String", "Bool"), 1)
)
TWO = [Channel(number, "/two", "cdr", {}, number) for number in (1, 2)]
TWO_TYPES = MCAP0_MAGIC + encoded(STRING, BOOL, *TWO, Message(1, 1, b"x", 1, 0))
CHART = MCAP0_MAGIC + encoded(Channel(1, "/chart", "json", {}, 0))
BROTLI = MCAP0_MAGIC + encoded(Chunk("brotli", b"packed", 0, 1, 1, 900))
SQLITE = b"SQLite format 3\x00"


def put(path: Path, make: Make) -> None:
    if isinstance(make, bytes):
        path.write_bytes(make)
    else:
        make(path)


def listing(path: Path, name: str) -> None:
    path.mkdir()
    head = "rosbag2_bagfile_information: {relative_file_paths: "
    (path / "metadata.yaml").write_text(f"{head}['{name}']}}")


def holding(path: Path, make: Make, name: str) -> None:
    path.mkdir()
    put(path / name, make)


@pytest.mark.parametrize(
    ("name", "make", "words", "only"),
    [
        ("missing", lambda _: None, "No such file or directory;", None),
        ("missing.mcap", lambda _: None, "check the path", None),
        ("empty.mcap", b"", "is no bag: it is empty; choose a rosbag2 bag folder", None),
        (
            "text.mcap",
            b"hello, I am text",
            "is no bag: it does not begin like an MCAP file; choose",
            None,
        ),
        ("chart.mcap", CHART, "is no bag: /chart holds 'json', not CDR; choose", None),
        ("two.mcap", TWO_TYPES, "'/two' has two types, which no bag can hold", recover),
        ("folder", Path.mkdir, "is no bag: the folder holds no recording; choose", None),
        ("old.db3", SQLITE, "is a sqlite3 bag; make it an mcap bag by `ros2 bag convert`", None),
        (
            "sqlite",
            lambda path: holding(path, SQLITE, "sqlite_0.db3"),
            "is a sqlite3 bag; make it an mcap bag by `ros2 bag convert`",
            None,
        ),
        ("gone", lambda path: listing(path, "gone_0.mcap"), "No such file or directory;", None),
        ("up", lambda path: listing(path, ".."), "is not a file; choose", Bag),
        ("notes.txt", b"", "is no bag: its name does not end in .mcap; choose", recover),
        ("deep", lambda path: holding(path, Path.mkdir, "deep_0.mcap"), "is not a file;", recover),
        ("pipe", lambda path: holding(path, os.mkfifo, "metadata.yaml"), "is not a file;", recover),
        ("pipe.mcap", os.mkfifo, "pipe.mcap is not a file; choose", recover),
        (
            "other.mcap",
            BROTLI,
            "a chunk has the unknown compression 'brotli' (byte 8); it is left as it is",
            recover,
        ),
        (
            "loop.mcap",
            lambda path: path.symlink_to("loop.mcap"),
            "Too many levels of symbolic links",
            recover,
        ),
    ],
)
def test_what_is_no_bag_is_refused_in_one_line_with_the_remedy_and_left_alone(
    tmp_path: Path, name: str, make: Make, words: str, only: object
) -> None:
    put(tmp_path / name, make)
    before = all_within(tmp_path)
    for act in (Bag, recover):
        if only in (None, act):
            with pytest.raises(RecorderError) as caught:
                act(tmp_path / name)
            assert words in str(caught.value)
            assert str(tmp_path / name) in str(caught.value)
            assert "\n" not in str(caught.value)
    assert all_within(tmp_path) == before
