"""A bag of several files: every reader opens what `metadata.yaml` lists, and all that is whole."""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Callable
from io import FileIO
from pathlib import Path
from typing import Any

import pytest
import yaml

from recorder import evidence
from recorder.bag import RawMessage, Topic, bag_file_name, evidence_file_name
from recorder.evidence import FurtherFile, put_listing
from recorder.reader import Bag
from recorder.recovery import recover
from recorder.writer import BagWriter, RecorderState
from tests.recorder.samples import (
    Killed,
    add_evidence,
    by_rosbags,
    door_messages,
    door_topics,
    in_order,
    killed_after,
    opened,
    strings,
    talk,
)

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


def list_again(folder: Path) -> None:
    with opened(folder) as fd:
        put_listing(fd)


def told(folder: Path) -> dict[str, Any]:
    document = yaml.safe_load((folder / "metadata.yaml").read_text())
    information: dict[str, Any] = document["rosbag2_bagfile_information"]
    return information


def test_what_is_scored_comes_first_then_the_evidence_by_its_numbers(folder: Path) -> None:
    for number in (10, 9, 0):
        add_evidence(folder, strings([str(number)], "/camera"), number)
    list_again(folder)
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
    for _listed in (False, True):
        bag = Bag(folder)
        assert (list(bag.messages()), bag.complete) == (SCORED, True)
        assert list(Bag(folder, evidence=True).messages()) == CAMERA
        list_again(folder)
    assert list(Bag(file).messages()) == CAMERA
    (folder / "metadata.yaml").unlink()
    assert list(Bag(folder).messages()) == SCORED


def garbage(file: Path) -> None:
    file.write_bytes(os.urandom(1000))


def torn(file: Path) -> None:
    add_evidence(file.parent, CAMERA, int(file.stem[-1]))
    os.truncate(file, file.stat().st_size - 20)


@pytest.mark.parametrize(
    ("place", "name"),
    [
        (torn, evidence_file_name("run", 1)),
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
    list_again(folder)
    files = [bag_file_name("run"), evidence_file_name("run", 0)]
    assert told(folder)["relative_file_paths"] == files
    assert by_rosbags(folder) == in_order(SCORED, CAMERA)


def test_evidence_that_ends_first_is_listed_by_the_recording_when_it_ends(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    with BagWriter(folder, door_topics(), {}) as writer:
        add_evidence(folder, CAMERA)
        before = (folder / "metadata.yaml").read_bytes()
        list_again(folder)
        assert (folder / "metadata.yaml").read_bytes() == before
        writer.put_all(SCORED)
    assert by_rosbags(folder) == in_order(SCORED, CAMERA)


def test_two_that_end_at_once_list_both(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The first is overtaken between its look and its write: what it writes is old by then."""
    add_evidence(folder, CAMERA, 0)
    real = evidence.write_metadata
    overtaken: list[bool] = []

    def write(fd: int, information: Any) -> None:  # noqa: ANN401 - it is handed on
        if not overtaken:
            overtaken.append(True)
            add_evidence(folder, CAMERA, 1)
            list_again(folder)
        real(fd, information)

    monkeypatch.setattr(evidence, "write_metadata", write)
    list_again(folder)
    assert len(told(folder)["relative_file_paths"]) == 3


def test_a_kill_at_any_step_leaves_a_listing_that_every_reader_takes(tmp_path: Path) -> None:
    messages = strings(["few topics", "soon parsed"])
    scored, both = in_order(messages), in_order(messages, CAMERA)
    for steps in range(100):
        folder = tmp_path / str(steps) / "run"
        folder.parent.mkdir()
        with BagWriter(folder, [talk()], {}) as writer:
            writer.put_all(messages)
        add_evidence(folder, CAMERA)
        try:
            with killed_after(steps):
                list_again(folder)
            break
        except Killed:
            assert by_rosbags(folder) in (scored, both)
            list_again(folder)
            assert by_rosbags(folder) == both
    assert 3 < steps < 99


def test_hopeless_evidence_is_named_and_hinders_nothing(folder: Path) -> None:
    files = [folder / evidence_file_name("run", number) for number in range(1, 5)]
    garbage(files[0])
    os.mkfifo(files[1])
    files[2].touch()
    torn(files[3])
    recording = folder / bag_file_name("run")
    os.truncate(recording, recording.stat().st_size - 100)
    recovered = recover(folder)
    assert recovered.torn is not None
    assert recovered.messages == len(SCORED)
    assert [done.file for done in recovered.evidence] == files[3:]
    assert [file.name in words for file, words in zip(files, recovered.hopeless)] == [True] * 3  # noqa: B905
    assert by_rosbags(folder) == in_order(SCORED, CAMERA)


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


class BadSector(FileIO):
    """A file of which the disk reads no more than a part."""

    def readinto(self, buffer: Any, /) -> int:  # noqa: ANN401 - any buffer
        if self.tell() >= 8192:
            raise OSError(errno.EIO, "Input/output error")
        return super().readinto(memoryview(buffer)[: 8192 - self.tell()])


FRAMES = [
    RawMessage("/camera", "sensor_msgs/msg/Image", os.urandom(500_000), number, number)
    for number in range(1, 21)
]
CAMERA_TOPIC = Topic("/camera", "sensor_msgs/msg/Image", "uint8[] data\n")


def recorded(folder: Path, refusal: Callable[[int, int], str | None]) -> BagWriter:
    return BagWriter(FurtherFile(folder, 0, refusal), [CAMERA_TOPIC], {})


@pytest.mark.parametrize("there", [False, True])
def test_what_comes_before_the_file_is_there_is_written_to_it_or_counted(
    tmp_path: Path, *, there: bool
) -> None:
    folder = tmp_path / "bag"
    writer = BagWriter(folder, [], {})
    if there:
        folder.mkdir()
    writer.start(niceness=19)
    assert writer.add_topic(talk()) or there
    writer.put_all(strings(["a", "b"]))
    stats = writer.close()
    if there:
        assert "exists already" in (stats.error or "")
        assert (stats.state, stats.lost) == (RecorderState.FAILED, {"/talk": 2})
    else:
        assert (stats.state, stats.recorded) == (RecorderState.FINISHED, {"/talk": 2})
        assert len(list(Bag(folder).messages())) == 2
