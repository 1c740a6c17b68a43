"""A repair that is killed, finds no room or meets something else than a bag: nothing is lost."""

from __future__ import annotations

import errno
import os
import resource
import shutil
import signal
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from mcap.writer import Writer

from recorder.reader import read_bag
from recorder.recovery import recover
from recorder.writer import BagWriter
from tests.recorder.samples import strings, talk
from tests.recorder.test_crash import numbers, victim
from tests.recorder.torn_bags import TornBag, contents, middle, names, place_torn, refusal
from tests.recorder.victim import RECORDS
from tests.watching import until

MESSAGES = strings([f"number {number} " + "x" * 900 for number in range(300)])


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> TornBag:
    return TornBag(tmp_path_factory.mktemp("whole") / "bag")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "bag"


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
            writer.put(message)
        writer.add_record("note", {"ends": "a chunk"})
        writer.put(MESSAGES[20])
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
            writer.put(message)
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
