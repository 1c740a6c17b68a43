"""What is said to be on the disk is there; nothing stays open, half written or lying about."""

from __future__ import annotations

import os
import re
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from recorder.bag import Topic
from recorder.errors import RecorderError
from recorder.reader import Bag
from recorder.recorder_stats import DropReason, RecorderState
from recorder.recovery import recover
from recorder.writer import BagWriter
from tests.recorder.samples import add_evidence, strings, talk
from tests.recorder.torn_bags import contents, refusal
from tests.watching import until

MESSAGES = strings([f"number {number} " + "x" * 900 for number in range(100)])
CAMERA = strings(["a", "b"], "/camera")

Write = Callable[[int, bytes], int]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "bag"


@pytest.fixture
def synced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, int]:
    """Sizes of files and folders, by their last names, when they were last brought to the disk."""
    sizes: dict[str, int] = {}

    def noted(real: Callable[[int], None]) -> Callable[[int], None]:
        def sync(fd: int) -> None:
            real(fd)
            path = Path(f"/proc/self/fd/{fd}").readlink()
            if path.is_relative_to(tmp_path):
                name = re.sub(r"\.(\d+\.part|recovering)$", "", path.name)
                sizes[name] = os.fstat(fd).st_size

        return sync

    for name in ("fsync", "fdatasync"):
        monkeypatch.setattr(os, name, noted(getattr(os, name)))
    return sizes


def recorded(folder: Path, cut: int = 0) -> Path:
    with BagWriter(folder, [talk()], {"madrob_run": {"n": "1"}}) as writer:
        assert writer.put_all(MESSAGES) == len(MESSAGES)
    recording = folder / "bag_0.mcap"
    recording.write_bytes(recording.read_bytes()[: -cut or None])
    return recording


def test_what_is_said_to_be_on_disk_has_been_synced(folder: Path, synced: dict[str, int]) -> None:
    def check(*places: Path) -> None:
        assert {path.name for path in places} <= synced.keys()
        files = {path.name: path.stat().st_size for path in folder.iterdir()}
        assert {name: synced[name] for name in files} == files
        synced.clear()

    now = 0.0
    with BagWriter(folder, [talk()], {}, clock=lambda: now) as writer:
        stats = writer.stats()
        assert stats.file_bytes == (folder / "bag_0.mcap").stat().st_size
        assert stats.seconds_since_sync is not None
        check(folder, folder.parent)
        assert writer.put_all(MESSAGES) == len(MESSAGES)
        now = 0.21
        until(lambda: writer.stats().written == len(MESSAGES))
        assert synced["bag_0.mcap"] == (folder / "bag_0.mcap").stat().st_size
    check(folder)
    recording = folder / "bag_0.mcap"
    recording.write_bytes(recording.read_bytes()[:-100])
    (folder / "metadata.yaml").unlink()
    assert recover(folder).torn is not None
    (folder / "bag_0.mcap.torn").unlink()
    check(folder)
    add_evidence(folder, CAMERA)
    synced.clear()
    (folder / "metadata.yaml").unlink()
    assert recover(folder).changed
    assert synced["metadata.yaml"] == (folder / "metadata.yaml").stat().st_size


def test_no_file_stays_open(folder: Path) -> None:
    def descriptors() -> dict[str, str]:
        fds = Path("/proc/self/fd").iterdir()
        return {fd.name: str(fd.readlink()) for fd in fds if fd.is_symlink()}

    def here() -> list[str]:
        return [path for path in descriptors().values() if path.startswith(str(folder.parent))]

    recording = recorded(folder, cut=100)
    assert here() == []
    assert list(Bag(folder).messages()) == MESSAGES
    recover(folder)
    recover(recording)
    with pytest.raises(RecorderError, match="exists already"):
        BagWriter(folder, [talk()], {}).open()
    recording.write_bytes(b"no recording")
    refusal(folder)
    assert here() == []


def test_a_disk_that_takes_little_at_a_time_gets_all(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real: Write = os.write
    monkeypatch.setattr(os, "write", lambda fd, data: real(fd, data[:100]))
    recorded(folder)
    assert list(Bag(folder).messages()) == MESSAGES
    assert Bag(folder).complete


def test_a_repair_that_reads_back_something_else_changes_nothing(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorded(folder, cut=100)
    before, real = contents(folder), os.write

    def write(fd: int, data: bytes) -> int:
        """The last of a summary becomes another byte on its way to the disk."""
        content = bytearray(data)
        if bytes(data).endswith(b"\x89MCAP0\r\n") and len(data) > 100:
            content[-50] ^= 1
        return real(fd, content)

    with monkeypatch.context() as bad:
        bad.setattr(os, "write", write)
        assert "what was written is not what is read back" in refusal(folder)
    assert contents(folder) == before
    assert recover(folder).messages == len(MESSAGES)


def test_what_a_dead_writer_left_of_the_metadata_goes_and_a_live_one_s_stays(folder: Path) -> None:
    recorded(folder)
    live = folder / f"metadata.yaml.{threading.get_native_id()}.part"
    (folder / "metadata.yaml.999999999.part").touch()
    for part in (live, folder / "metadata.yaml.part", folder / "note.txt"):
        part.touch()
    assert not recover(folder).changed
    assert {path.name for path in folder.iterdir()} == {
        *("bag_0.mcap", "metadata.yaml", live.name, "metadata.yaml.part", "note.txt")
    }


def test_what_comes_before_the_file_is_there_is_written_to_it(folder: Path) -> None:
    writer = BagWriter(folder, [], {})
    writer.start(niceness=19)
    assert writer.add_topic(talk())
    assert writer.put_all(MESSAGES) == len(MESSAGES)
    stats = writer.close()
    assert (stats.state, stats.written) == (RecorderState.FINISHED, len(MESSAGES))
    assert list(Bag(folder).messages()) == MESSAGES


def test_a_folder_that_is_there_is_a_failure_and_what_comes_is_counted(folder: Path) -> None:
    folder.mkdir()
    writer = BagWriter(folder, [talk()], {})
    writer.start(niceness=19)
    writer.put_all(MESSAGES)
    stats = writer.close()
    assert stats.state is RecorderState.FAILED
    assert "exists already" in (stats.error or "")
    assert stats.drop_reasons == {DropReason.FAILED: len(MESSAGES)}
    assert not writer.add_topic(Topic("/late", "std_msgs/msg/Bool", ""))
