"""A torn bag becomes a bag again, with everything in it that is whole."""

from __future__ import annotations

import errno
import os
import random
import resource
import shutil
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from io import BytesIO
from itertools import count
from pathlib import Path
from typing import Any

import lz4.frame  # type: ignore[import-untyped]
import pytest
import yaml
from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, Message, Schema
from mcap.writer import MCAP0_MAGIC, CompressionType, IndexType

from recorder.bag import BagInformation, RawMessage, Topic
from recorder.errors import RecorderError
from recorder.reader import Bag
from recorder.recorder_stats import RecorderState
from recorder.recovery import Recovered, recover
from recorder.writer import BagWriter
from tests.recorder.samples import all_within, by_library, encoded, mixed, strings, talk
from tests.recorder.torn_bags import (
    TornBag,
    by_mcap,
    check_cut,
    contents,
    middle,
    names,
    place_torn,
    refusal,
)
from tests.watching import until

MESSAGES = strings([f"number {number} " + "x" * 900 for number in range(300)])
TOPIC = Topic("/blob", "test_msgs/msg/Blob", "uint8[] data\n")
RECORDS = {"madrob_run": {"setup": "{}"}}
REPAIRED = ["bag_0.mcap", "bag_0.mcap.torn", "metadata.yaml"]


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


def edges(bag: TornBag) -> set[int]:
    """Where something begins or ends, and a byte to either side."""
    places = {8, len(bag.data) - 1}
    for chunk in bag.chunks:
        sizes = chunk.unpacked
        blocks = [place for place in range(1, len(sizes)) if sizes[place] != sizes[place - 1]]
        places |= {chunk.start, chunk.data_start, chunk.end}
        places |= {chunk.data_start + place for place in blocks}
    near = {place + step for place in places for step in (-1, 0, 1)}
    return {place for place in near if 8 <= place < len(bag.data)}


def test_a_cut_anywhere_costs_only_what_is_behind_it(bag: TornBag, folder: Path) -> None:
    for cut in random.Random(0).sample(sorted(edges(bag)), 20):
        check_cut(bag, folder, cut)
    for cut in random.Random(1).sample(range(8, len(bag.data)), 12):
        check_cut(bag, folder, cut)


@pytest.mark.slow
@pytest.mark.parametrize("part", range(4))
def test_every_cut_costs_only_what_is_behind_it(
    bag: TornBag, folder: Path, part: int, request: pytest.FixtureRequest
) -> None:
    """With `--runs 1000` every byte of the last two chunks, and 1,000 anywhere in the file."""
    runs = request.config.getoption("--runs")
    cuts = list(bag.last_two_chunks())[:: max(1, 1000 // runs)]
    cuts += random.Random(2).choices(range(8, len(bag.data)), k=runs)
    kept = [check_cut(bag, folder, cut).messages for cut in cuts[part::4]]
    print(f"{len(kept)} cuts, {sum(kept)} messages kept, {len(set(kept))} different counts")


def test_a_cut_within_the_first_eight_bytes_leaves_nothing_to_keep(
    bag: TornBag, folder: Path
) -> None:
    for cut in range(8):
        place_torn(bag, folder, cut)
        before = contents(folder)
        assert "is no bag: it " in refusal(folder)
        assert contents(folder) == before


def described(path: Path) -> tuple[dict[int, Schema], dict[int, Channel], dict[str, Any]]:
    """Types, channels and records of a recording, by the mcap library."""
    with path.open("rb") as file:
        reader = SeekingReader(file)
        summary = reader.get_summary()
        records = {record.name: record.metadata for record in reader.iter_metadata()}
    assert summary is not None
    return summary.schemas, summary.channels, records


def test_a_torn_bag_becomes_a_bag_that_says_what_it_lost(bag: TornBag, folder: Path) -> None:
    cut = middle(bag) // 2 * 2 + 1
    recording, listing = place_torn(bag, folder, cut), folder / "metadata.yaml"
    torn = Bag(folder)
    before = list(torn.messages())
    recovered, tail = recover(folder), cut - bag.chunks[-1].start
    kept = recording.with_name("bag_0.mcap.torn")
    words = recovered.cut[0]
    assert recovered == Recovered(recording, len(before), kept, listing, (words,), tail)
    repaired = Bag(folder)
    assert (list(repaired.messages()), repaired.complete) == (before, False)
    assert repaired.problem == torn.problem
    assert words in (torn.problem or "")

    whole = folder.parent / "whole.mcap"
    whole.write_bytes(bag.data)
    *types, records = described(recording)
    *expected_types, expected = described(whole)
    assert types == expected_types
    first = ["madrob_run", "note 0", "note 1"]
    assert list(records) == [*first, "recovery", "rosbag2"]
    assert {name: records[name] for name in first} == {name: expected[name] for name in first}
    times = [message.receive_ns for message in before]
    counts = Counter(message.topic for message in before)
    span = min(times), max(times)
    told = BagInformation("bag_0.mcap", list(repaired.topics()), counts, *span)
    assert yaml.safe_load(listing.read_text()) == yaml.safe_load(told.metadata_yaml())


def test_a_whole_bag_stays_as_it_is(tmp_path: Path) -> None:
    folder, recording = tmp_path / "bag", tmp_path / "bag" / "bag_0.mcap"
    with BagWriter(folder, [talk()], RECORDS) as writer:
        assert writer.put_all(MESSAGES) == len(MESSAGES)
    before = contents(folder)
    unchanged = Recovered(recording, len(MESSAGES), None, None, (), 0)
    assert [recover(folder), recover(recording)] == [unchanged] * 2
    assert not unchanged.changed
    assert contents(folder) == before


@pytest.mark.parametrize(
    "content",
    [
        mixed(MESSAGES[:100]),
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
    assert (tmp_path / "other.mcap").read_bytes() == content
    assert names(tmp_path) == ["metadata.yaml", "other.mcap"]


def test_a_compression_that_is_unknown_here_is_no_damage(tmp_path: Path) -> None:
    path = tmp_path / "other.mcap"
    content = MCAP0_MAGIC + encoded(Chunk("brotli", b"packed", 0, 1, 1, 900))
    path.write_bytes(content)
    with pytest.raises(RecorderError, match=r"compression 'brotli' .* it is left"):
        recover(path)
    assert names(tmp_path) == ["other.mcap"]
    assert path.read_bytes() == content


def test_to_repair_twice_is_harmless_and_what_is_torn_again_is_kept_again(
    bag: TornBag, folder: Path
) -> None:
    recording, count = place_torn(bag, folder, middle(bag)), bag.whole_messages(middle(bag))
    assert recover(folder).changed
    before = contents(folder)
    assert recover(folder) == Recovered(recording, count, None, None, (), 0)
    assert (contents(folder), names(folder)) == (before, REPAIRED)
    again = recording.read_bytes()[:-400]
    recording.write_bytes(again)
    recovered = recover(folder)
    assert (recovered.torn, recovered.messages) == (folder / "bag_0.mcap.torn.2", count)
    torn = [(folder / f"bag_0.mcap.torn{end}").read_bytes() for end in ("", ".2")]
    assert torn == [bag.data[: middle(bag)], again]


@pytest.mark.parametrize("text", [None, "", "rosbag2_bagfile_info", "stale"])
def test_a_whole_recording_gets_the_metadata_yaml_it_lacks(
    bag: TornBag, folder: Path, text: str | None
) -> None:
    recording = place_torn(bag, folder, len(bag.data) // 2 * 2 + (text == "stale"))
    recording.write_bytes(bag.data)
    if text not in {None, "stale"}:
        (folder / "metadata.yaml").write_text(text or "")
    before, count = contents(folder), len(bag.messages)
    told = Recovered(recording, count, None, folder / "metadata.yaml", (), 0)
    assert [recover(folder), recover(folder)] == [told, replace(told, metadata=None)]
    assert contents(folder)["bag_0.mcap"] == before["bag_0.mcap"]
    assert Bag(folder).complete
    if text not in {None, "stale"}:  # somebody may want to see what it was
        assert contents(folder)["metadata.yaml.torn"] == before["metadata.yaml"]


@pytest.mark.parametrize(("word", "other"), [(b"cdr", b"bdr"), (b"/talk", b"/walk")])
def test_a_summary_that_tells_of_other_topics_is_made_anew(
    tmp_path: Path, word: bytes, other: bytes
) -> None:
    path = tmp_path / "damaged.mcap"
    data = by_library(MESSAGES, compression=CompressionType.NONE, enable_crcs=False)
    before, _, after = data.rpartition(word)
    path.write_bytes(before + other + after)
    recovered = recover(path)
    assert recovered.cut == ("its summary tells of other topics",)
    assert list(Bag(path).messages()) == MESSAGES
    assert [topic.name for topic in Bag(path).topics()] == ["/talk"]


def messages_in(size: int, preamble: int) -> int:
    """How many of `MESSAGES` lie whole in so much of their chunk."""
    ends = []
    for message in MESSAGES:
        preamble += 31 + len(message.data)
        ends.append(preamble)
    return sum(end <= size for end in ends)


def one_chunk(compression: CompressionType) -> tuple[bytes, int, int, int]:
    """A file of one chunk, where its data begin, their size unpacked, and that of its channels."""
    data = by_library(MESSAGES, chunk_size=2**30, compression=compression)
    summary = SeekingReader(BytesIO(data)).get_summary()
    assert summary is not None
    (index,) = summary.chunk_indexes
    start = index.chunk_start_offset + index.chunk_length - index.compressed_size
    size = index.uncompressed_size
    return data, start, size, size - sum(31 + len(message.data) for message in MESSAGES)


def repaired_of(folder: Path, data: bytes) -> int:
    """How many messages are left of a file that was torn to this."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    (folder / "torn.mcap").write_bytes(data)
    count = recover(folder / "torn.mcap").messages
    kept = [(m.topic, m.data, m.publish_ns, m.receive_ns) for m in MESSAGES[:count]]
    assert by_mcap(folder / "torn.mcap") == kept
    assert names(folder) == ["metadata.yaml", "torn.mcap", "torn.mcap.torn"]
    return count


def test_the_cut_chunk_is_kept_up_to_the_cut_without_compression(folder: Path) -> None:
    data, start, whole, preamble = one_chunk(CompressionType.NONE)
    for size in (0, preamble, preamble + 40, 5_000, 100_000, whole - 1):
        assert repaired_of(folder, data[: start + size]) == messages_in(size, preamble)


def test_the_cut_chunk_is_kept_up_to_its_last_whole_block_with_lz4(folder: Path) -> None:
    data, start, whole, preamble = one_chunk(CompressionType.LZ4)
    frame = lz4.frame.get_frame_info(data[start:])
    place = start + 7 + 8 * (frame["content_size"] > 0)
    for block in range(1, 5):
        place += 4 + (int.from_bytes(data[place : place + 4], "little") & 0x7FFF_FFFF)
        for near, blocks in ((place - 1, block - 1), (place + 4, block)):
            size = min(blocks * frame["block_size"], whole)
            assert repaired_of(folder, data[:near]) == messages_in(size, preamble)


@pytest.mark.parametrize("zeros", [0, 100_000])
def test_a_cut_chunk_that_cannot_be_compressed_is_kept_up_to_the_cut(
    tmp_path: Path, zeros: int
) -> None:
    with BagWriter(tmp_path / "bag", [TOPIC], RECORDS, flush_period=1e6) as writer:
        for number in range(50):
            writer.put_message(blob(number, 10_000))
    recording = tmp_path / "bag" / "bag_0.mcap"
    with recording.open("rb") as file:
        summary = SeekingReader(file).get_summary()
    assert summary is not None
    (index,) = summary.chunk_indexes
    assert not index.compression
    end = index.chunk_start_offset + index.chunk_length if zeros else 300_000
    cut = min(300_000, end - zeros)
    recording.write_bytes(recording.read_bytes()[:cut] + bytes(end - cut))
    assert recover(tmp_path / "bag").messages == 29  # of 10,035 bytes each


@pytest.mark.parametrize("length", [600, 4500])
def test_sectors_of_zeros_after_a_power_cut_are_not_taken_for_data(
    bag: TornBag, folder: Path, length: int
) -> None:
    chunk = bag.chunks[-1]
    cut = chunk.end - length  # the rest never came to the disk, though the file has its length
    recording = place_torn(bag, folder, cut)
    recording.write_bytes(bag.data[:cut] + bytes(chunk.end - cut + 100))
    assert recover(folder).messages == bag.whole_messages(cut)
    count = bag.whole_messages(cut)
    assert [data for _, data, _, _ in by_mcap(recording)] == [m.data for m in bag.messages[:count]]


@pytest.mark.parametrize("number", [0, 1, 2])
@pytest.mark.parametrize("finished", [True, False])
def test_a_damaged_chunk_is_left_out_and_the_rest_is_kept(
    bag: TornBag, folder: Path, number: int, finished: bool
) -> None:
    damaged = bytearray(bag.data if finished else bag.data[: bag.chunks[-1].end])
    chunk = bag.chunks[number]
    damaged[(chunk.data_start + chunk.end) // 2] ^= 4
    recording = place_torn(bag, folder, 1)
    recording.write_bytes(damaged)
    counts = [len(chunk.message_ends) for chunk in bag.chunks]
    before = sum(counts[:number])
    kept: list[RawMessage] = bag.messages[:before] + bag.messages[before + counts[number] :]
    if number < 2 and not finished:  # the channels of later chunks may have stood in it
        kept = kept[:before] if number else []
    recovered = recover(folder)
    assert by_mcap(recording) == [(m.topic, m.data, m.publish_ns, m.receive_ns) for m in kept]
    assert recovered.cut[0].startswith("a chunk ")
    assert recovered.cut[0].endswith(f"(byte {chunk.start}); it is left out")
    assert "it is left out" in (Bag(folder).problem or "")


def test_of_many_damaged_chunks_three_are_named_and_the_others_counted(tmp_path: Path) -> None:
    data = bytearray(by_library(MESSAGES[:60], chunk_size=1, compression=CompressionType.NONE))
    for number in range(5):
        data[data.index(f"number {number} ".encode())] ^= 1
    (tmp_path / "a.mcap").write_bytes(data)
    recovered = recover(tmp_path / "a.mcap")
    assert (len(recovered.cut), recovered.messages) == (4, 55)
    assert recovered.cut[-1] == "2 more chunks are left out"


def test_a_damaged_summary_is_made_anew(bag: TornBag, folder: Path) -> None:
    recording = place_torn(bag, folder, len(bag.data) // 2 * 2 + 1)
    damaged = bytearray(bag.data)
    damaged[-50] ^= 1  # in the last record before the footer
    recording.write_bytes(damaged)
    recovered, count = recover(folder), len(bag.messages)
    assert (recovered.cut, recovered.messages) == (("the checksum of its summary is wrong",), count)
    assert (len(by_mcap(recording)), Bag(folder).complete) == (count, True)  # none is missing


def test_a_file_among_others_is_repaired_without_a_metadata_yaml(
    bag: TornBag, folder: Path
) -> None:
    recording = place_torn(bag, folder, middle(bag) // 2 * 2)
    (folder / "other.mcap").write_bytes(bag.data)
    assert "holds 2 recordings; repair each of the files, then" in refusal(folder)
    recovered = recover(recording)
    count = bag.whole_messages(middle(bag) // 2 * 2)
    assert (recovered.messages, recovered.metadata) == (count, None)
    assert names(folder) == ["bag_0.mcap", "bag_0.mcap.torn", "other.mcap"]


class Killed(BaseException):
    """The process ends here."""


@contextmanager
def killed_after(steps: int, how: BaseException | None = None) -> Iterator[None]:
    """Let a number of calls that change the disk happen, and none after them.

    Args:
        steps: so many.
        how: what is raised in place of the next; None = the process ends.

    Only those of this thread count: the writer that a test before gave up on may still be at work.
    """
    left, here = [steps], threading.get_ident()

    def guarded(real: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **named: Any) -> Any:  # noqa: ANN401 - it stands for any call
            if threading.get_ident() == here:
                if left[0] == 0:
                    raise how or Killed
                left[0] -= 1
            return real(*arguments, **named)

        return call

    with pytest.MonkeyPatch.context() as patch:
        for name in ("open", "write", "fsync", "fdatasync", "link", "rename", "unlink"):
            patch.setattr(os, name, guarded(getattr(os, name)))
        yield


def no_links(*_: object, **__: object) -> None:
    raise OSError(errno.EPERM, os.strerror(errno.EPERM))


@pytest.mark.parametrize("links", [True, False])
def test_a_kill_at_any_moment_loses_nothing(
    folder: Path, links: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not links:
        monkeypatch.setattr(os, "link", no_links)
    with BagWriter(folder, [talk()], RECORDS, flush_period=1e6) as writer:
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
        if links:
            assert list(Bag(folder).messages()) == MESSAGES[:20]
        assert recover(folder).messages == 20
        assert names(folder) == ["bag_0.mcap", "bag_0.mcap.torn", "metadata.yaml"]
        assert (folder / "bag_0.mcap.torn").read_bytes() == torn
        assert list(Bag(folder).messages()) == MESSAGES[:20]
        assert not recover(folder).changed
    assert 15 < steps < 99


def test_a_full_disk_changes_nothing_and_says_so(bag: TornBag, folder: Path) -> None:
    place_torn(bag, folder, middle(bag))
    before = contents(folder)
    for limit in (0, 100, 5000):
        with small_files(limit):
            assert refusal(folder) == (
                f"cannot repair {folder}: File too large; nothing is lost, "
                "copy it to a disk that takes large files"
            )
        assert contents(folder) == before


def test_a_folder_that_may_not_be_written_is_told_with_the_remedy(bag: TornBag) -> None:
    with tempfile.TemporaryDirectory() as place:  # others can enter it, unlike pytest's
        Path(place).chmod(0o755)
        folder = Path(place) / "bag"
        place_torn(bag, folder, middle(bag))
        folder.chmod(0o555)
        before = contents(folder)
        if os.geteuid() == 0:
            os.seteuid(65534)
        try:
            text = refusal(folder)
        finally:
            os.seteuid(os.getuid())
        assert text == (
            f"cannot repair {folder}: Permission denied; nothing is lost, "
            "copy it to a folder that can be read and written"
        )
        assert contents(folder) == before
        folder.chmod(0o755)


def test_a_bag_that_is_being_recorded_is_refused(folder: Path) -> None:
    with BagWriter(folder, [talk()], RECORDS, flush_period=0):
        text = refusal(folder)
    assert text == "bag_0.mcap is being written; end its recording or repair, then try again"
    assert not recover(folder).changed


def test_a_file_that_grows_meanwhile_is_refused(
    bag: TornBag, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recording = place_torn(bag, folder, middle(bag))
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
    recording = place_torn(bag, folder, middle(bag))
    outside = folder.parent / "outside"
    outside.write_bytes(b"precious")
    for name in ("bag_0.mcap.recovering", "bag_0.mcap.torn", "metadata.yaml.part"):
        (folder / name).symlink_to(outside)
    assert recover(folder).torn == folder / "bag_0.mcap.torn.2"
    recording.rename(folder.parent / "far.mcap")
    recording.symlink_to(folder.parent / "far.mcap")
    assert "give the path of the file itself and not of a link" in refusal(folder)
    assert outside.read_bytes() == b"precious"


def two_types(path: Path) -> None:
    """One name with two types, and no summary."""
    types = ("std_msgs/msg/String", "std_msgs/msg/Bool")
    schemas = [Schema(n, b"string data\n", "ros2msg", name) for n, name in enumerate(types, 1)]
    channels = [Channel(n, "/two", "cdr", {}, n) for n in (1, 2)]
    path.write_bytes(MCAP0_MAGIC + encoded(*schemas, *channels, Message(1, 1, b"x", 1, 0)))


def chart(path: Path) -> None:
    """Data of another kind."""
    path.write_bytes(MCAP0_MAGIC + encoded(Channel(1, "/chart", "json", {}, 0)))


def listing(path: Path, name: str) -> None:
    path.mkdir()
    head = "rosbag2_bagfile_information: {relative_file_paths: "
    (path / "metadata.yaml").write_text(f"{head}['{name}']}}")


def holding(path: Path, make: Callable[[Path], object], name: str) -> None:
    path.mkdir()
    make(path / name)


def sqlite(path: Path) -> None:
    path.write_bytes(b"SQLite format 3\x00")


@pytest.mark.parametrize(
    ("name", "make", "words", "only"),
    [
        ("missing", lambda _: None, "No such file or directory;", None),
        ("missing.mcap", lambda _: None, "check the path", None),
        ("empty.mcap", Path.touch, "is no bag: it is empty; choose a rosbag2 bag folder", None),
        (
            "text.mcap",
            lambda path: path.write_text("hello, I am text"),
            "is no bag: it does not begin like an MCAP file; choose",
            None,
        ),
        ("chart.mcap", chart, "is no bag: /chart holds 'json', not CDR; choose", None),
        ("two.mcap", two_types, "'/two' has two types, which no bag can hold", recover),
        ("folder", Path.mkdir, "is no bag: the folder holds no recording; choose", None),
        ("old.db3", sqlite, "is a sqlite3 bag; make it an mcap bag by `ros2 bag convert`", None),
        (
            "sqlite",
            lambda path: holding(path, sqlite, "sqlite_0.db3"),
            "is a sqlite3 bag; make it an mcap bag by `ros2 bag convert`",
            None,
        ),
        ("gone", lambda path: listing(path, "gone_0.mcap"), "No such file or directory;", None),
        ("up", lambda path: listing(path, ".."), "is not a file; choose", Bag),
        ("notes.txt", Path.touch, "is no bag: its name does not end in .mcap; choose", recover),
        ("deep", lambda path: holding(path, Path.mkdir, "deep_0.mcap"), "is not a file;", recover),
        ("pipe", lambda path: holding(path, os.mkfifo, "metadata.yaml"), "is not a file;", recover),
        ("pipe.mcap", os.mkfifo, "pipe.mcap is not a file; choose", recover),
        (
            "loop.mcap",
            lambda path: path.symlink_to("loop.mcap"),
            "give the path of the file itself and not of a link",
            recover,
        ),
    ],
)
def test_what_is_no_bag_is_refused_in_one_line_with_the_remedy_and_left_alone(
    tmp_path: Path, name: str, make: Callable[[Path], object], words: str, only: object
) -> None:
    make(tmp_path / name)
    before = all_within(tmp_path)
    for act in (Bag, recover):
        if only in (None, act):
            with pytest.raises(RecorderError) as caught:
                act(tmp_path / name)
            assert words in str(caught.value)
            assert str(tmp_path / name) in str(caught.value)
            assert "\n" not in str(caught.value)
    assert all_within(tmp_path) == before


@contextmanager
def small_files(limit: int) -> Iterator[None]:
    """No file may grow beyond so many bytes: a disk that is full."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_a_full_disk_is_reported_and_costs_only_what_it_did_not_take(folder: Path) -> None:
    writer = BagWriter(folder, [TOPIC], RECORDS, flush_period=0.02)
    sent = count()
    with small_files(2_000_000):
        writer.open()

        def failed() -> bool:
            writer.put_message(blob(next(sent), 100_000))
            return writer.stats().state is RecorderState.FAILED

        until(failed)
        assert not writer.put_message(blob(next(sent), 10))
        summary = writer.close()
    assert "File too large; what was written stays readable" in (summary.error or "")
    assert "\n" not in (summary.error or "")
    saved, bag = summary.counts[TOPIC.name], Bag(folder)
    assert (saved + summary.dropped[TOPIC.name], summary.queued_bytes) == (next(sent), 0)
    numbers = [int.from_bytes(message.data[:4]) for message in bag.messages()]
    assert numbers == list(range(len(numbers)))
    assert len(numbers) >= saved > 0
    assert (bag.complete, bag.records) == (False, RECORDS)


def test_a_disk_that_is_full_from_the_start_refuses_and_leaves_nothing(folder: Path) -> None:
    with small_files(100), pytest.raises(RecorderError, match=r"^cannot record to .*: File too la"):
        BagWriter(folder, [TOPIC], RECORDS).open()
    assert not any(folder.parent.iterdir())
