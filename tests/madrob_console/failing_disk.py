"""A run whose disk fails in its middle."""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from enum import StrEnum
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec
import pytest

from madrob_console.referee.acts import Abort, DeclareTimeout
from madrob_console.referee.journal import read_journal
from madrob_console.referee.rebuild import Change, rebuild
from madrob_console.referee.records import RunSetup
from madrob_console.testbeds.simulated import Scenario
from recorder.bag import RawMessage
from recorder.mcap_writer import McapFile
from recorder.reader import read_bag
from scoring.result import Result
from tests.madrob_console.engine.drive import STEP, Drive, make_setup
from tests.madrob_console.small_disk import SmallDisk, disk_image, lock_folder, memory_disk
from tests.watching import until

NAMED_WITHIN = 2.0


class Fault(StrEnum):
    FULL = "disk full"
    READ_ONLY = "disk turned read-only"
    PULLED_OUT = "disk pulled out"
    RESULTS_DELETED = "results folder deleted"
    RUN_DELETED = "run folder deleted"
    RUN_LOCKED = "run folder made read-only"


class Stop(StrEnum):
    COMPLETED = "completed"
    ELAPSED = "timeout elapsed"
    DECLARED = "timeout declared"
    ABORTED = "aborted"


DELETED = (Fault.RESULTS_DELETED, Fault.RUN_DELETED)
WORDS = {
    Fault.FULL: "No space left on device; what was written stays readable",
    Fault.READ_ONLY: "Read-only file system; what was written stays readable",
    Fault.PULLED_OUT: "Input/output error; what was written stays readable",
    Fault.RESULTS_DELETED: "the file was deleted; what was written is lost",
    Fault.RUN_DELETED: "the file was deleted; what was written is lost",
    Fault.RUN_LOCKED: "cannot be written: the result would not be on disk",
}


class Syncs:
    """Counts the times that the recorder has brought everything to the disk."""

    def __init__(self) -> None:
        self.ended = 0

    @contextmanager
    def counted(self) -> Iterator[None]:
        sync = McapFile.sync

        def count(file: McapFile) -> None:
            sync(file)
            self.ended += 1

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(McapFile, "sync", count)
            yield


class Machine:
    """An engine whose results lie on a small disk."""

    def __init__(self, fault: Fault, disk: SmallDisk, stop: Stop, syncs: Syncs) -> None:
        self.fault = fault
        self.disk = disk
        self.syncs = syncs
        self.drive = Recorded(disk.folder / "results", scenario_of(stop))

    @property
    def folder(self) -> Path:
        assert self.drive.engine.folder is not None
        return self.drive.engine.folder

    def spoil(self) -> None:
        match self.fault:
            case Fault.FULL:
                self.disk.fill()
            case Fault.READ_ONLY:
                self.disk.turn_read_only()
            case Fault.PULLED_OUT:
                self.disk.pull_out()
            case Fault.RESULTS_DELETED:
                shutil.rmtree(self.drive.engine.config.results)
            case Fault.RUN_DELETED:
                shutil.rmtree(self.folder)
            case Fault.RUN_LOCKED:
                lock_folder(self.folder, locked=True)

    def mend(self) -> None:
        match self.fault:
            case Fault.FULL:
                self.disk.make_room()
            case Fault.READ_ONLY | Fault.PULLED_OUT:
                self.disk.come_back()
            case Fault.RUN_LOCKED:
                lock_folder(self.folder, locked=False)

    def named_after(self) -> float:
        """Let the run go on in real time until the fault is named; how long that took, s."""
        began = time.monotonic()
        while WORDS[self.fault] not in self.words:
            self.drive.engine.step(STEP)
            time.sleep(STEP)
            assert time.monotonic() - began < NAMED_WITHIN, (
                f"{self.fault} was not named: {self.words}"
            )
        return time.monotonic() - began

    def wait_for_sync(self) -> None:
        """Until everything handed in is on the disk."""
        newest = max(message.receive_ns for message in self.drive.taken)
        until(lambda: any(m.receive_ns >= newest for m in read_bag(self.folder).messages()))
        # It is in the file; the sync that brings it to the disk is the second to end from now.
        before = self.syncs.ended
        until(lambda: self.syncs.ended >= before + 2)

    @property
    def words(self) -> str:
        return " | ".join(self.drive.engine.snapshot().faults)

    def in_run(self, message: RawMessage) -> bool:
        """Whether a message came while the run was recorded."""
        began = self.drive.engine.run.countdown_began
        assert began is not None
        return message.receive_ns / 1e9 > began

    def stop(self, how: Stop) -> None:
        match how:
            case Stop.DECLARED:
                self.drive.act(DeclareTimeout("gave up"))
            case Stop.ABORTED:
                self.drive.act(Abort("enough"))
        self.drive.finish()


class Recorded(Drive):
    """Keeps what the recorder is handed."""

    def __init__(self, results: Path, scenario: Scenario) -> None:
        super().__init__(results, scenario)
        self.taken: list[RawMessage] = []
        take = self.source.take_messages

        def kept(timeout: float) -> list[RawMessage]:
            messages = take(timeout)
            self.taken += messages
            return messages

        self.source.take_messages = kept  # type: ignore[method-assign]


def scenario_of(stop: Stop) -> Scenario:
    return Scenario.NOMINAL if stop is Stop.COMPLETED else Scenario.TOUCH_ONLY


def setup_of(stop: Stop, run_number: int = 1) -> RunSetup:
    timeout = 60.0 if stop is Stop.COMPLETED else 9.0
    return make_setup(run_number=run_number, timeout=timeout)


@contextmanager
def spoiled(fault: Fault, folder: Path, stop: Stop) -> Iterator[Machine]:
    with ExitStack() as stack:
        kind = memory_disk if fault in (Fault.FULL, *DELETED) else disk_image
        syncs = Syncs()
        stack.enter_context(syncs.counted())
        machine = Machine(fault, stack.enter_context(kind(folder)), stop, syncs)
        try:
            yield machine
        finally:
            machine.drive.engine.close()


@cache
def undisturbed(stop: Stop) -> Result:
    """The same run on a good disk, to the end that its scenario has."""
    with TemporaryDirectory() as folder:
        drive = Drive(Path(folder), scenario_of(stop))
        drive.whole_run(setup_of(stop))
        drive.engine.close()
    assert drive.engine.scored is not None
    return drive.engine.scored.result


def check_on_disk(drive: Drive, folder: Path, result: Result) -> None:
    """The result and every line of the journal, once, are in the run's folder."""
    assert drive.engine.refused == ""
    document = msgspec.json.decode((folder / "result.json").read_bytes())
    assert document["outcome"] == result.outcome
    assert document["quality"]["remarks"] == list(result.quality.remarks)
    entries, torn = read_journal(folder / "journal.jsonl")
    lacks = Change.UNRECORDED
    assert sum(entry.what == lacks for entry in entries) == (drive.engine.run.unrecorded > 0)
    what = [entry.what for entry in entries if entry.what != lacks]
    assert what[:4] == ["set up", "zero the handle", "confirm the start pose", "start"]
    assert what[-2:] in (["run stops", "result written"], ["abort", "result written"])
    assert len(torn) <= 1
    assert len({entry.to_json() for entry in entries}) == len(entries)
    assert rebuild(entries, drive.engine.run.handle_zero).outcome is result.outcome
