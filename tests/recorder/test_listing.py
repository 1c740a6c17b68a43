"""A bag of several files: every reader opens what `metadata.yaml` lists, and all that is whole."""

from __future__ import annotations

import os
import shutil
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace
from rosbags.rosbag2 import Reader

from recorder import listing
from recorder.bag import RawMessage, bag_file_name, evidence_file_name
from recorder.listing import put_listing
from recorder.mcap_file import McapFile
from recorder.reader import Bag
from recorder.recovery import recover
from recorder.writer import BagWriter
from tests.recorder.samples import (
    add_evidence,
    door_messages,
    door_topics,
    strings,
    talk,
)
from tests.recorder.test_recovery import Killed, killed_after

SCORED = door_messages(rounds=10)
CAMERA = [
    RawMessage("/camera", m.type, m.data, m.publish_ns, m.receive_ns) for m in strings(["a", "b"])
]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    folder = tmp_path / "run"
    with BagWriter(folder, door_topics(), {}) as writer:
        writer.put_all(SCORED)
    return folder


@contextmanager
def opened(folder: Path) -> Iterator[int]:
    fd = os.open(folder, os.O_DIRECTORY)
    try:
        yield fd
    finally:
        os.close(fd)


def list_again(folder: Path) -> bool:
    with opened(folder) as fd:
        return put_listing(fd) is not None


def told(folder: Path) -> dict[str, Any]:
    document = yaml.safe_load((folder / "metadata.yaml").read_text())
    information: dict[str, Any] = document["rosbag2_bagfile_information"]
    return information


def read_by_rosbags(folder: Path) -> list[tuple[str, int]]:
    """Topics and log times of a bag, by the reader that tells most about what is wrong."""
    with Reader(folder) as reader:
        assert reader.message_count == sum(c.msgcount for c in reader.connections)
        return sorted((connection.topic, time) for connection, time, _ in reader.messages())


def by_topic(*messages: list[RawMessage]) -> list[tuple[str, int]]:
    return sorted((message.topic, message.receive_ns) for part in messages for message in part)


def test_what_is_scored_comes_first_then_the_evidence_by_its_numbers(folder: Path) -> None:
    for number in (10, 9, 0):
        add_evidence(folder, strings([str(number)], "/camera"), number)
    assert list_again(folder)
    texts = [str(number) for number in (0, 9, 10)]
    expected = [strings([text], "/camera")[0] for text in texts]
    assert list(Bag(folder, evidence=True).messages()) == expected
    assert told(folder)["relative_file_paths"] == [
        bag_file_name("run"),
        *(evidence_file_name("run", number) for number in (0, 9, 10)),
    ]


def test_evidence_is_read_apart_from_what_is_scored(folder: Path) -> None:
    none = Bag(folder, evidence=True)
    assert (list(none.messages()), none.topics()) == ([], ())
    file = add_evidence(folder, CAMERA)
    for listed in (False, True):
        bag = Bag(folder)
        assert (list(bag.messages()), bag.complete) == (SCORED, True)
        assert list(Bag(folder, evidence=True).messages()) == CAMERA
        assert listed or list_again(folder)
    assert list(Bag(file).messages()) == CAMERA
    (folder / "metadata.yaml").unlink()
    assert list(Bag(folder).messages()) == SCORED


@settings(max_examples=25)
@given(
    files=st.lists(
        st.lists(st.tuples(st.sampled_from("abc"), st.integers(0, 2**62)), max_size=20), max_size=4
    )
)
def test_whatever_evidence_holds_the_listing_is_what_is_read(
    files: list[list[tuple[str, int]]], tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = tmp_path_factory.mktemp("bags") / "run"
    with BagWriter(folder, door_topics(), {}) as writer:
        writer.put_all(SCORED[:6])
    expected = list(SCORED[:6])
    for number, content in enumerate(files):
        sent = [replace(CAMERA[0], topic=f"/{name}", receive_ns=time) for name, time in content]
        add_evidence(folder, sent, number)
        expected += sent
    assert list_again(folder)
    times = [message.receive_ns for message in expected]
    information = told(folder)
    listed = {
        entry["topic_metadata"]["name"]: entry["message_count"]
        for entry in information["topics_with_message_count"]
    }
    assert Counter(listed) == Counter(message.topic for message in expected)
    assert [information[key] for key in ("message_count", "starting_time", "duration")] == [
        len(expected),
        {"nanoseconds_since_epoch": min(times)},
        {"nanoseconds": max(times) - min(times)},
    ]
    assert read_by_rosbags(folder) == by_topic(expected)


def unfinished(file: Path) -> None:
    add_evidence(file.parent, CAMERA, 1)
    file.write_bytes(file.read_bytes()[:-20])


def garbage(file: Path) -> None:
    file.write_bytes(os.urandom(1000))


@pytest.mark.parametrize(
    ("place", "name"),
    [
        (unfinished, evidence_file_name("run", 1)),
        (os.mkfifo, evidence_file_name("run", 1)),
        (lambda file: file.symlink_to("run_0.mcap"), evidence_file_name("run", 1)),
        (garbage, evidence_file_name("run", 1)),
        (lambda file: shutil.copy(file.with_name("run_0.mcap"), file), "copy.mcap"),
    ],
    ids=["unfinished", "pipe", "link", "garbage", "a copy of the recording"],
)
def test_what_is_no_whole_evidence_is_left_out(
    folder: Path, place: Callable[[Path], object], name: str
) -> None:
    add_evidence(folder, CAMERA, 0)
    place(folder / name)
    assert list_again(folder)
    files = [bag_file_name("run"), evidence_file_name("run", 0)]
    assert told(folder)["relative_file_paths"] == files
    assert read_by_rosbags(folder) == by_topic(SCORED, CAMERA)


def test_evidence_that_ends_first_is_listed_by_the_recording_when_it_ends(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    with BagWriter(folder, door_topics(), {}) as writer:
        add_evidence(folder, CAMERA)
        before = (folder / "metadata.yaml").read_bytes()
        assert not list_again(folder)
        assert (folder / "metadata.yaml").read_bytes() == before
        writer.put_all(SCORED)
    assert read_by_rosbags(folder) == by_topic(SCORED, CAMERA)


def test_two_that_end_at_once_list_both(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The first is overtaken between its look and its write: what it writes is old by then."""
    add_evidence(folder, CAMERA, 0)
    real = listing.write_metadata
    overtaken: list[bool] = []

    def write(fd: int, information: Any) -> None:  # noqa: ANN401 - it is handed on
        if not overtaken:
            overtaken.append(True)
            add_evidence(folder, CAMERA, 1)
            assert list_again(folder)
        real(fd, information)

    monkeypatch.setattr(listing, "write_metadata", write)
    assert list_again(folder)
    assert len(told(folder)["relative_file_paths"]) == 3


def test_a_kill_at_any_step_leaves_a_listing_that_every_reader_takes(tmp_path: Path) -> None:
    for steps in range(100):
        folder = tmp_path / str(steps) / "run"
        folder.parent.mkdir()
        with BagWriter(folder, door_topics(), {}) as writer:
            writer.put_message(SCORED[0])
        add_evidence(folder, CAMERA)
        try:
            with killed_after(steps):
                list_again(folder)
        except Killed:
            assert read_by_rosbags(folder) in (by_topic([SCORED[0]]), by_topic([SCORED[0]], CAMERA))
            assert list_again(folder)
            assert read_by_rosbags(folder) == by_topic([SCORED[0]], CAMERA)
        else:
            break
    assert 3 < steps < 99


def torn(folder: Path, number: int = 0) -> Path:
    file = add_evidence(folder, CAMERA, number)
    file.write_bytes(file.read_bytes()[:-20])
    return file


def test_recover_repairs_evidence_that_was_cut_off_and_lists_it(folder: Path) -> None:
    whole = add_evidence(folder, CAMERA, 0).read_bytes()
    file = torn(folder, 1)
    recovered = recover(folder)
    assert [(done.file, done.messages) for done in recovered.evidence] == [(file, 2)]
    assert (recovered.torn, recovered.hopeless, recovered.changed) == (None, (), True)
    assert not list(folder.glob("*.torn*"))  # every whole message of it is in the new one
    assert (folder / evidence_file_name("run", 0)).read_bytes() == whole
    assert len(told(folder)["relative_file_paths"]) == 3
    assert read_by_rosbags(folder) == by_topic(SCORED, CAMERA, CAMERA)
    assert recover(folder).evidence == ()
    assert recover(torn(folder, 2)).changed  # by its own name
    assert read_by_rosbags(folder) == by_topic(SCORED, CAMERA, CAMERA, CAMERA)


def test_hopeless_evidence_is_named_and_hinders_nothing(folder: Path) -> None:
    garbage(folder / evidence_file_name("run", 1))
    os.mkfifo(folder / evidence_file_name("run", 2))
    (folder / evidence_file_name("run", 3)).touch()
    torn(folder, 4)
    recording = folder / bag_file_name("run")
    recording.write_bytes(recording.read_bytes()[:-100])
    recovered = recover(folder)
    assert recovered.torn is not None
    assert recovered.messages == len(SCORED)
    assert [done.file.name for done in recovered.evidence] == [evidence_file_name("run", 4)]
    for number, words in enumerate(recovered.hopeless, start=1):
        assert evidence_file_name("run", number) in words
    assert len(recovered.hopeless) == 3
    assert read_by_rosbags(folder) == by_topic(SCORED, CAMERA)


def test_evidence_that_is_still_written_is_not_touched(folder: Path) -> None:
    with opened(folder) as fd:
        file = McapFile(fd, evidence_file_name("run", 0))
        file.start([talk()], {})
        (words,) = recover(folder).hopeless
        assert "is being written" in words
        file.add_message(strings(["late"])[0])
        file.finish()
        file.close()
        assert put_listing(fd) is not None
    assert len(read_by_rosbags(folder)) == len(SCORED) + 1


def test_of_evidence_that_is_damaged_before_its_end_the_old_file_is_kept(folder: Path) -> None:
    long = strings([os.urandom(1_000).hex() for _ in range(2_000)])
    file = add_evidence(folder, long)
    data = bytearray(file.read_bytes())
    data[len(data) // 3] ^= 0xFF  # a disk did that, and more can be read of it by hand
    file.write_bytes(data)
    file.write_bytes(data[:-20])
    (recovered,) = recover(folder).evidence
    assert recovered.torn == file.with_name(f"{file.name}.torn")
    assert recovered.torn.read_bytes() == data[:-20]
    assert 0 < recovered.messages < len(long)


def test_evidence_that_was_removed_is_listed_no_longer(folder: Path) -> None:
    file = add_evidence(folder, CAMERA)
    assert list_again(folder)
    file.unlink()
    assert recover(folder).metadata is not None
    assert read_by_rosbags(folder) == by_topic(SCORED)
