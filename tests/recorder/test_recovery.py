"""A torn bag becomes a bag again, with everything in it that is whole."""

from __future__ import annotations

import errno
import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import lz4.frame  # type: ignore[import-untyped]
import pytest
import yaml
from mcap.reader import SeekingReader
from mcap.records import Channel, Schema
from mcap.writer import CompressionType, Writer

from recorder.bag import RawMessage
from recorder.reader import read_bag
from recorder.recovery import recover
from recorder.writer import BagWriter
from tests.recorder.samples import strings, talk
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
from tests.recorder.victim import RECORDS, TOPIC, blob
from tests.watching import until

MESSAGES = strings([f"number {number} " + "x" * 900 for number in range(300)])
REPAIRED = ["bag_0.mcap", "bag_0.mcap.torn", "metadata.yaml"]


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


def test_types_channels_qos_and_records_are_kept(bag: TornBag, folder: Path) -> None:
    recording = place_torn(bag, folder, middle(bag))
    recover(folder)

    def described(path: Path) -> tuple[dict[int, Schema], dict[int, Channel], list[Any]]:
        with path.open("rb") as file:
            reader = SeekingReader(file)
            summary = reader.get_summary()
            assert summary is not None
            records = [(record.name, record.metadata) for record in reader.iter_metadata()]
        return summary.schemas, summary.channels, records

    whole = folder.parent / "whole.mcap"
    whole.write_bytes(bag.data)
    schemas, channels, records = described(recording)
    expected_schemas, expected_channels, expected_records = described(whole)
    assert schemas == expected_schemas
    assert channels == expected_channels
    assert records[:3] == expected_records[:3]  # `note 2` lies behind the cut
    assert [name for name, _ in records] == [
        "madrob_run",
        "note 0",
        "note 1",
        "recovery",
        "rosbag2",
    ]


def test_metadata_yaml_tells_of_the_repaired_recording(bag: TornBag, folder: Path) -> None:
    place_torn(bag, folder, middle(bag))
    recovered = recover(folder)
    assert recovered.metadata == folder / "metadata.yaml"
    document = yaml.safe_load((folder / "metadata.yaml").read_text())
    information = document["rosbag2_bagfile_information"]
    times = [message.receive_ns for message in bag.messages[: recovered.messages]]
    assert information["message_count"] == recovered.messages
    assert information["starting_time"] == {"nanoseconds_since_epoch": min(times)}
    assert information["duration"] == {"nanoseconds": max(times) - min(times)}
    assert information["relative_file_paths"] == ["bag_0.mcap"]


def test_what_was_lost_stays_told_in_the_same_words(bag: TornBag, folder: Path) -> None:
    place_torn(bag, folder, middle(bag) // 2 * 2 + 1)
    torn = read_bag(folder)
    before = list(torn.messages())
    assert torn.problem is not None
    recovered = recover(folder)
    repaired = read_bag(folder)
    assert list(repaired.messages()) == before
    assert repaired.problem == torn.problem
    assert not repaired.complete
    assert len(recovered.cut) == 1
    assert recovered.cut[0] in torn.problem
    assert recovered.tail_bytes == len(bag.data[: middle(bag) // 2 * 2 + 1]) - bag.chunks[-1].start


def test_a_whole_bag_stays_as_it_is(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", [talk()], RECORDS) as writer:
        for message in MESSAGES:
            writer.put_message(message)
    before = contents(tmp_path / "bag")
    for path in (tmp_path / "bag", tmp_path / "bag" / "bag_0.mcap"):
        recovered = recover(path)
        assert not recovered.changed
        assert recovered.messages == len(MESSAGES)
        assert (recovered.cut, recovered.tail_bytes) == ((), 0)
    assert contents(tmp_path / "bag") == before


def test_to_repair_twice_is_harmless(bag: TornBag, folder: Path) -> None:
    place_torn(bag, folder, middle(bag))
    first = recover(folder)
    assert first.changed
    before = contents(folder)
    second = recover(folder)
    assert not second.changed
    assert second.messages == first.messages
    assert contents(folder) == before
    assert names(folder) == REPAIRED


def test_a_bag_torn_again_is_repaired_again_and_every_old_file_is_kept(
    bag: TornBag, folder: Path
) -> None:
    recording = place_torn(bag, folder, middle(bag))
    recover(folder)
    again = recording.read_bytes()[:-400]
    recording.write_bytes(again)
    recovered = recover(folder)
    assert recovered.torn == folder / "bag_0.mcap.torn.2"
    assert recovered.torn.read_bytes() == again
    assert (folder / "bag_0.mcap.torn").read_bytes() == bag.data[: middle(bag)]
    assert recovered.messages == bag.whole_messages(middle(bag))


@pytest.mark.parametrize("text", [None, "", "rosbag2_bagfile_info", "stale"])
def test_a_whole_recording_gets_the_metadata_yaml_it_lacks(
    bag: TornBag, folder: Path, text: str | None
) -> None:
    recording = place_torn(bag, folder, len(bag.data) // 2 * 2 + (text == "stale"))
    recording.write_bytes(bag.data)
    if text not in {None, "stale"}:
        (folder / "metadata.yaml").write_text(text or "")
    before = contents(folder)
    recovered = recover(folder)
    assert recovered.torn is None
    assert recovered.metadata == folder / "metadata.yaml"
    assert recovered.messages == len(bag.messages)
    assert contents(folder)["bag_0.mcap"] == before["bag_0.mcap"]
    assert read_bag(folder).complete
    assert not recover(folder).changed
    if text not in {None, "stale"}:  # somebody may want to see what it was
        assert contents(folder)["metadata.yaml.torn"] == before["metadata.yaml"]


def by_mcap_library(path: Path, compression: CompressionType, *, crcs: bool = True) -> None:
    """One chunk of `MESSAGES`, as another recorder may write it."""
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=2**30, compression=compression, enable_crcs=crcs)
        writer.start(profile="ros2")
        schema = writer.register_schema(talk().type, "ros2msg", talk().definition.encode())
        channel = writer.register_channel("/talk", "cdr", schema)
        for message in MESSAGES:
            writer.add_message(channel, message.receive_ns, message.data, message.publish_ns)
        writer.finish()  # type: ignore[no-untyped-call]


@pytest.mark.parametrize(("word", "other"), [(b"cdr", b"bdr"), (b"/talk", b"/walk")])
def test_a_summary_that_tells_of_other_topics_is_made_anew(
    tmp_path: Path, word: bytes, other: bytes
) -> None:
    path = tmp_path / "damaged.mcap"
    by_mcap_library(path, CompressionType.NONE, crcs=False)
    before, _, after = path.read_bytes().rpartition(word)
    path.write_bytes(before + other + after)
    recovered = recover(path)
    assert recovered.cut == ("its summary tells of other topics",)
    assert list(read_bag(path).messages()) == MESSAGES
    assert [topic.name for topic in read_bag(path).topics()] == ["/talk"]


def messages_in(size: int, preamble: int) -> int:
    """How many of `MESSAGES` lie whole in so much of their chunk."""
    ends = []
    for message in MESSAGES:
        preamble += 31 + len(message.data)
        ends.append(preamble)
    return sum(end <= size for end in ends)


def test_the_cut_chunk_is_kept_up_to_the_cut_without_compression(tmp_path: Path) -> None:
    whole, torn = tmp_path / "whole.mcap", tmp_path / "torn" / "torn.mcap"
    by_mcap_library(whole, CompressionType.NONE)
    data = whole.read_bytes()
    with whole.open("rb") as file:
        summary = SeekingReader(file).get_summary()
    assert summary is not None
    (index,) = summary.chunk_indexes
    end = index.chunk_start_offset + index.chunk_length
    start = end - index.compressed_size
    preamble = index.uncompressed_size - sum(31 + len(message.data) for message in MESSAGES)
    for size in (0, preamble, preamble + 40, 5_000, 100_000, index.uncompressed_size - 1):
        shutil.rmtree(torn.parent, ignore_errors=True)
        torn.parent.mkdir()
        torn.write_bytes(data[: start + size])
        count = messages_in(size, preamble)
        assert recover(torn).messages == count
        assert by_mcap(torn) == [
            (m.topic, m.data, m.publish_ns, m.receive_ns) for m in MESSAGES[:count]
        ]
        assert names(torn.parent) == ["metadata.yaml", "torn.mcap", "torn.mcap.torn"]


def test_the_cut_chunk_is_kept_up_to_its_last_whole_block_with_lz4(tmp_path: Path) -> None:
    whole, torn = tmp_path / "whole.mcap", tmp_path / "torn" / "torn.mcap"
    by_mcap_library(whole, CompressionType.LZ4)
    data = whole.read_bytes()
    with whole.open("rb") as file:
        summary = SeekingReader(file).get_summary()
    assert summary is not None
    (index,) = summary.chunk_indexes
    start = index.chunk_start_offset + index.chunk_length - index.compressed_size
    preamble = index.uncompressed_size - sum(31 + len(message.data) for message in MESSAGES)
    frame = lz4.frame.get_frame_info(data[start : start + index.compressed_size])
    place = start + 7 + 8 * (frame["content_size"] > 0)
    torn.parent.mkdir()
    for block in range(1, 5):
        place += 4 + (int.from_bytes(data[place : place + 4], "little") & 0x7FFF_FFFF)
        for near, blocks in ((place - 1, block - 1), (place + 4, block)):
            for name in names(torn.parent):
                (torn.parent / name).unlink()
            torn.write_bytes(data[:near])
            size = min(blocks * frame["block_size"], index.uncompressed_size)
            assert recover(torn).messages == messages_in(size, preamble)


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


@pytest.mark.parametrize("length", [600, 5000])
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
    assert "it is left out" in (read_bag(folder).problem or "")


def test_a_damaged_summary_is_made_anew(bag: TornBag, folder: Path) -> None:
    recording = place_torn(bag, folder, len(bag.data) // 2 * 2 + 1)
    damaged = bytearray(bag.data)
    damaged[-50] ^= 1  # in the last record before the footer
    recording.write_bytes(damaged)
    recovered = recover(folder)
    assert recovered.cut == ("the checksum of its summary is wrong",)
    assert len(by_mcap(recording)) == recovered.messages == len(bag.messages)
    assert read_bag(folder).complete  # no message is missing


def test_a_file_among_others_is_repaired_without_a_metadata_yaml(
    bag: TornBag, folder: Path
) -> None:
    recording = place_torn(bag, folder, middle(bag) // 2 * 2)
    (folder / "other.mcap").write_bytes(bag.data)
    assert "holds 2 recordings; repair each of the files, then" in refusal(folder)
    recovered = recover(recording)
    assert recovered.messages == bag.whole_messages(middle(bag) // 2 * 2)
    assert recovered.metadata is None
    assert names(folder) == ["bag_0.mcap", "bag_0.mcap.torn", "other.mcap"]


@pytest.mark.machine
def test_a_killed_recording_is_repaired_at_once(folder: Path) -> None:
    with victim("until-killed", folder) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == '"recording"\n'
        until(lambda: len(list(read_bag(folder).messages())) > 100)
        process.send_signal(signal.SIGKILL)
    before = list(read_bag(folder).messages())
    recovered = recover(folder)
    assert recovered.messages == len(before) > 100
    repaired = list(read_bag(folder).messages())
    assert repaired == before
    assert numbers(repaired) == list(range(len(repaired)))


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
            assert list(read_bag(folder).messages()) == MESSAGES[:20]
        assert recover(folder).messages == 20
        assert names(folder) == ["bag_0.mcap", "bag_0.mcap.torn", "metadata.yaml"]
        assert (folder / "bag_0.mcap.torn").read_bytes() == torn
        assert list(read_bag(folder).messages()) == MESSAGES[:20]
        assert not recover(folder).changed
    assert 15 < steps < 99


def test_a_full_disk_changes_nothing_and_says_so(bag: TornBag, folder: Path) -> None:
    place_torn(bag, folder, middle(bag))
    before = contents(folder)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        for limit in (0, 100, 5000):
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, hard))
            assert refusal(folder) == (
                f"cannot repair {folder}: File too large; nothing is lost, "
                "copy it to a disk that takes large files"
            )
            assert contents(folder) == before
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert recover(folder).changed


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
    with BagWriter(folder, [talk()], RECORDS, flush_period=0) as writer:
        for message in MESSAGES:
            writer.put_message(message)
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


def test_one_name_with_two_types_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "two.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2")
        for name in ("std_msgs/msg/String", "std_msgs/msg/Bool"):
            schema = writer.register_schema(name, "ros2msg", b"string data\n")
            writer.add_message(writer.register_channel("/two", "cdr", schema), 1, b"x", 1)
        writer.finish()  # type: ignore[no-untyped-call]
    path.write_bytes(path.read_bytes()[:-20])
    before = contents(tmp_path)
    assert "'/two' has two types, which no bag can hold" in refusal(path)
    assert contents(tmp_path) == before


def test_what_is_no_bag_is_refused_in_one_line_and_left_alone(tmp_path: Path) -> None:
    (tmp_path / "text.mcap").write_text("hello, I am text")
    (tmp_path / "empty.mcap").write_bytes(b"")
    (tmp_path / "notes.txt").write_text("hello")
    (tmp_path / "old.db3").write_bytes(b"SQLite format 3\x00")
    (tmp_path / "folder").mkdir()
    (tmp_path / "sqlite").mkdir()
    (tmp_path / "sqlite" / "sqlite_0.db3").write_bytes(b"SQLite format 3\x00")
    (tmp_path / "gone").mkdir()
    (tmp_path / "gone" / "metadata.yaml").write_text(
        "rosbag2_bagfile_information: {relative_file_paths: [gone_0.mcap]}"
    )
    (tmp_path / "deep").mkdir()
    (tmp_path / "deep" / "deep_0.mcap").mkdir()
    (tmp_path / "loop.mcap").symlink_to("loop.mcap")
    (tmp_path / "pipe").mkdir()
    os.mkfifo(tmp_path / "pipe" / "metadata.yaml")
    os.mkfifo(tmp_path / "pipe.mcap")
    for name, words in {
        "missing": "No such file or directory; nothing is lost, check the path",
        "missing.mcap": "No such file or directory; nothing is lost, check the path",
        "text.mcap": "is no bag: it does not begin like an MCAP file; choose",
        "empty.mcap": "is no bag: it is empty; choose a rosbag2 bag folder",
        "notes.txt": "is no bag: its name does not end in .mcap; choose",
        "old.db3": "is a sqlite3 bag; make it an mcap bag by `ros2 bag convert`",
        "folder": "is no bag: the folder holds no recording; choose",
        "sqlite": "is a sqlite3 bag; make it an mcap bag by `ros2 bag convert`",
        "gone": "No such file or directory; nothing is lost, check the path",
        "deep": "is not a file; choose",
        "pipe": "metadata.yaml is not a file; choose",
        "pipe.mcap": "pipe.mcap is not a file; choose",
        "loop.mcap": "give the path of the file itself and not of a link",
    }.items():
        text = refusal(tmp_path / name)
        assert words in text
        assert str(tmp_path / name) in text
    assert not list(tmp_path.rglob("*.torn"))
    assert not list(tmp_path.rglob("*.recovering"))


ROOT = Path(__file__).parents[2]


def victim(how: str, folder: Path, limit: int = 0) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "tests.recorder.victim", how, str(folder), str(limit)],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        text=True,
    )


def report_of(process: subprocess.Popen[str]) -> dict[str, Any]:
    with process:
        output, _ = process.communicate(timeout=60)
    assert process.returncode == 0
    report: dict[str, Any] = json.loads(output)
    return report


def numbers(messages: list[RawMessage]) -> list[int]:
    return [int.from_bytes(message.data[:4]) for message in messages]


@pytest.mark.machine
@pytest.mark.parametrize("seconds", [0.7, 1.13])
def test_a_killed_recording_loses_less_than_half_a_second(tmp_path: Path, seconds: float) -> None:
    with victim("until-killed", tmp_path / "bag") as process:
        assert process.stdout is not None
        assert process.stdout.readline() == '"recording"\n'
        time.sleep(seconds)
        killed_ns = time.time_ns()
        process.send_signal(signal.SIGKILL)
    bag = read_bag(tmp_path / "bag")
    messages = list(bag.messages())
    assert numbers(messages) == list(range(len(messages)))
    assert killed_ns - messages[-1].receive_ns < 500_000_000
    assert not bag.complete
    assert bag.records == {"madrob_run": {"setup": "{}"}}
    assert [topic.definition for topic in bag.topics()] == ["uint8[] data\n"]
    assert (tmp_path / "bag" / "metadata.yaml").is_file()


@pytest.mark.machine
def test_a_full_disk_is_reported_and_costs_only_what_it_did_not_take(tmp_path: Path) -> None:
    report = report_of(victim("on-a-small-disk", tmp_path / "bag", limit=2_000_000))
    assert report["state"] == "failed"
    assert "File too large; what was written stays readable" in report["error"]
    assert "\n" not in report["error"]
    assert report["accepted_after"] == [False, False, False]
    assert report["saved"] + report["dropped"] == report["handed_in"]
    assert report["queued"] == 0
    bag = read_bag(tmp_path / "bag")
    messages = list(bag.messages())
    assert numbers(messages) == list(range(len(messages)))
    assert len(messages) >= report["saved"] > 0
    assert not bag.complete
    assert bag.records == {"madrob_run": {"setup": "{}"}}


@pytest.mark.machine
def test_a_disk_that_is_full_from_the_start_refuses_and_leaves_nothing(tmp_path: Path) -> None:
    report = report_of(victim("on-a-small-disk", tmp_path / "bag", limit=100))
    assert report["refused"].startswith(f"cannot record to {tmp_path / 'bag'}: File too large; ")
    assert not any(tmp_path.iterdir())


@pytest.mark.machine
def test_a_folder_that_may_not_be_written_is_refused_with_the_remedy(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    report = report_of(victim("without-rights", tmp_path / "bag"))
    tmp_path.chmod(0o700)
    assert report["refused"] == (
        f"cannot record to {tmp_path / 'bag'}: Permission denied; "
        "choose a folder that exists and can be written, on a disk with room"
    )
