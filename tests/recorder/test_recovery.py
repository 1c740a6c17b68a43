"""A torn bag becomes a bag again, with everything in it that is whole."""

from __future__ import annotations

import os
import random
import resource
import shutil
from collections.abc import Callable
from io import BytesIO
from itertools import accumulate
from pathlib import Path

import pytest
from mcap.records import Channel, Chunk, Message, Schema
from mcap.writer import MCAP0_MAGIC, CompressionType

from recorder import RecorderError
from recorder.bag import Batch, RawMessage, Topic
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
    written,
)

MESSAGES = door_messages(rounds=90)
PARTS = [MESSAGES[:150], MESSAGES[150:350], MESSAGES[350:]]
TALK = strings(["a" * 900] * 40)
RUN_RECORD = {"madrob_run": {"setup": '{"team": "Ärger"}'}}
REPAIRED = ["bag_0.mcap", "bag_0.mcap.torn", "metadata.yaml"]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A recording of three chunks; each cut of it is longer than its records."""
    path = tmp_path_factory.mktemp("whole") / "bag_0.mcap"
    batches = [Batch([*door_topics()], records=RUN_RECORD)]
    batches += [Batch(messages=part) for part in PARTS]
    written(path, batches)
    return path.read_bytes()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "bag"


def place(folder: Path, content: bytes) -> Path:
    """Make a bag folder as a kill leaves it, and return its recording."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    (folder / "bag_0.mcap").write_bytes(content)
    return folder / "bag_0.mcap"


def chunk_ends(content: bytes) -> list[int]:
    indexes = by_mcap(BytesIO(content))[0].chunk_indexes
    return [index.chunk_start_offset + index.chunk_length for index in indexes]


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def refusal(path: Path) -> str:
    with pytest.raises(RecorderError) as caught:
        recover(path)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_a_cut_anywhere_costs_only_what_is_behind_it(whole: bytes, folder: Path) -> None:
    """Every whole chunk is kept, and readers of others read what is left."""
    ends = chunk_ends(whole)
    edges = [edge + step for edge in ends for step in (-1, 0, 1)]
    for cut in (8, *edges, *random.Random(0).sample(range(9, len(whole)), 15)):
        recording = place(folder, whole[:cut])
        before = list(Bag(folder).messages())
        least = sum(len(part) for part, end in zip(PARTS, ends, strict=True) if end <= cut)

        recovered = recover(folder)

        assert before == MESSAGES[: len(before)]
        assert recovered.messages == len(before) >= least
        assert recovered.torn is not None
        assert recovered.torn.read_bytes() == whole[:cut]
        assert raw_by_mcap(recording) == before
        assert by_rosbags(folder) == in_order(before)


def test_whole_messages_of_the_cut_chunk_are_kept(tmp_path: Path) -> None:
    data = by_library(TALK, chunk_size=2**30, compression=CompressionType.NONE)
    (index,) = by_mcap(BytesIO(data))[0].chunk_indexes
    sizes = [31 + len(message.data) for message in TALK]
    end = index.chunk_start_offset + index.chunk_length
    ends = list(accumulate(sizes, initial=end - sum(sizes)))
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(data[: ends[7] + 40])
    assert recover(torn).messages == 7
    assert raw_by_mcap(torn) == TALK[:7]


@pytest.mark.parametrize("length", [600, 4500])
def test_sectors_of_zeros_after_a_power_cut_are_not_taken_for_data(
    tmp_path: Path, length: int
) -> None:
    """The rest never came to the disk, though the file has its length."""
    data = by_library(TALK, compression=CompressionType.NONE)
    cut = chunk_ends(data)[0] - length
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(data[:cut] + bytes(length + 100))
    kept = len(TALK) - 1 - length // 1000
    assert (recover(torn).messages, raw_by_mcap(torn)) == (kept, TALK[:kept])


def test_a_torn_bag_says_what_it_lost_and_keeps_its_records(whole: bytes, folder: Path) -> None:
    recording = place(folder, whole[: chunk_ends(whole)[1] + 100])
    problem = Bag(folder).problem
    recovered = recover(folder)
    repaired = Bag(folder)
    kept = (folder / "bag_0.mcap.torn", folder / "metadata.yaml")
    assert recovered == Recovered(recording, recovered.messages, *kept, recovered.cut)
    assert "it is torn at byte" in recovered.cut[0]
    assert recovered.cut[0] in (repaired.problem or "")
    assert problem is not None
    assert repaired.records["madrob_run"] == RUN_RECORD["madrob_run"]
    assert repaired.topics() == door_topics()


def test_a_record_behind_a_damaged_chunk_is_kept(folder: Path) -> None:
    data = by_library(TALK, records=RUN_RECORD, chunk_size=4000)
    head = chunk_ends(data)[-2]
    place(folder, data[:head] + bytes(16) + data[head + 16 :])
    assert Bag(folder).records["madrob_run"] == RUN_RECORD["madrob_run"]
    recover(folder)
    assert Bag(folder).records["madrob_run"] == RUN_RECORD["madrob_run"]


def test_to_repair_twice_is_harmless_and_what_is_torn_again_is_kept_again(
    whole: bytes, folder: Path
) -> None:
    recording = place(folder, whole[:-100])
    assert recover(folder).changed
    before = contents(folder)
    assert recover(folder) == Recovered(recording, len(MESSAGES), None, None, ())
    assert (contents(folder), names(folder)) == (before, REPAIRED)
    again = recording.read_bytes()[:-400]
    recording.write_bytes(again)
    assert recover(folder).torn == folder / "bag_0.mcap.torn.2"
    torn = [(folder / f"bag_0.mcap.torn{end}").read_bytes() for end in ("", ".2")]
    assert torn == [whole[:-100], again]


@pytest.mark.parametrize("text", [None, "", "rosbag2_bagfile_information: {}"])
def test_a_whole_recording_gets_the_metadata_yaml_it_lacks(
    whole: bytes, folder: Path, text: str | None
) -> None:
    recording = place(folder, whole)
    if text is not None:
        (folder / "metadata.yaml").write_text(text)
    listing = folder / "metadata.yaml"
    assert recover(folder) == Recovered(recording, len(MESSAGES), None, listing, ())
    after = contents(folder)
    assert recording.read_bytes() == whole
    assert not recover(folder).changed
    assert not recover(recording).changed
    assert contents(folder) == after
    assert Bag(folder).complete


@pytest.mark.parametrize("number", [0, 1, 2])
def test_a_damaged_chunk_is_left_out_and_the_rest_is_kept(
    whole: bytes, folder: Path, number: int
) -> None:
    damaged = bytearray(whole)
    damaged[chunk_ends(whole)[number] - 50] ^= 4
    recording = place(folder, bytes(damaged))
    kept = [message for n, part in enumerate(PARTS) if n != number for message in part]
    recovered = recover(folder)
    assert raw_by_mcap(recording) == kept
    assert recovered.cut[0].startswith("a chunk has a wrong size or checksum (byte ")
    assert recovered.cut[0] in (Bag(folder).problem or "")


@pytest.mark.parametrize("more", [bytes(600), b"garbage"])
def test_what_stands_behind_the_end_is_cut_off(whole: bytes, folder: Path, more: bytes) -> None:
    """Others look for the summary at the end of the file."""
    recording = place(folder, whole + more)
    recovered = recover(folder)
    assert recovered.cut[0].startswith(f"its end mark is at byte {len(whole)} of ")
    assert raw_by_mcap(recording) == MESSAGES


def test_a_large_file_takes_little_memory(folder: Path) -> None:
    topic = Topic("/blob", "test_msgs/msg/Blob", "uint8[] data\n")
    with BagWriter(folder, [topic], {}) as writer:
        for number in range(100):
            data = os.urandom(500_000)
            writer.put_message(RawMessage(topic.name, topic.type, data, number, number))
    recording = folder / "bag_0.mcap"
    os.truncate(recording, recording.stat().st_size - 100)
    with little_memory(25_000_000):
        assert recover(folder).messages == 100


def test_a_file_among_others_is_repaired_without_a_metadata_yaml(
    whole: bytes, folder: Path
) -> None:
    recording = place(folder, whole[:-100])
    (folder / "other.mcap").write_bytes(whole)
    assert "holds 2 recordings; repair each of the files, then" in refusal(folder)
    recovered = recover(recording)
    assert (recovered.messages, recovered.metadata) == (len(MESSAGES), None)
    assert names(folder) == ["bag_0.mcap", "bag_0.mcap.torn", "other.mcap"]


def test_a_kill_at_any_moment_loses_nothing(whole: bytes, folder: Path) -> None:
    torn = whole[:-100]
    for steps in range(100):
        place(folder, torn)
        try:
            with killed_after(steps):
                recover(folder)
        except Killed:
            pass
        else:
            break
        assert any(content == torn for _, content in contents(folder).values())
        assert list(Bag(folder).messages()) == MESSAGES
        assert recover(folder).messages == len(MESSAGES)
        assert names(folder) == REPAIRED
        assert (folder / "bag_0.mcap.torn").read_bytes() == torn
    assert 10 < steps < 99


@pytest.mark.parametrize("limit", [0, 100, 1500])
def test_a_full_disk_changes_nothing_and_says_so(whole: bytes, folder: Path, limit: int) -> None:
    place(folder, whole[:-100])
    before = contents(folder)
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
        ("chart.mcap", CHART, "is no bag: '/chart' holds 'json', not CDR; choose", None),
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
            "a chunk has the unknown compression 'brotli' (byte 8); it is left out, and nothing",
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
