"""A disk that fills, turns read-only, vanishes or loses files ends no run and loses no result."""

from __future__ import annotations

import os
import random
import re
import shutil
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec
import pytest

from madrob_console.archive import score
from madrob_console.archive.check import Grade, check_run
from madrob_console.archive.result_reader import read_result
from madrob_console.archive.run_paths import RunPath
from madrob_console.archive.scored import score_opened
from madrob_console.archive.unfinished_runs import find_unfinished
from madrob_console.engine.core.engine_core import RETRY_PERIOD
from madrob_console.messages.mapping import DEFAULT_MAPPINGS
from madrob_console.referee.acts import Abort, AddNote, DeclareTimeout, Finalise, Start
from madrob_console.referee.flags import Flag, FlagKind, FlagWeight
from madrob_console.referee.journal import read_journal
from madrob_console.referee.rebuild import Change, rebuild
from madrob_console.referee.records import TeamWord
from madrob_console.referee.run import Phase
from madrob_console.referee.run_setup import RunSetup
from madrob_console.testbeds.simulated import Scenario
from recorder import RecorderError
from recorder.bag import RawMessage
from recorder.reader import Bag
from recorder.writer import BagFile
from scoring.indicator_table import IndicatorName
from scoring.protocol import EventName, Outcome
from scoring.quality import Quality
from scoring.result import Result
from tests.madrob_console.engine.drive import STEP, Drive, make_setup
from tests.madrob_console.recorded_runs import recorded
from tests.madrob_console.small_disk import SmallDisk, disk_image, lock_folder, memory_disk
from tests.slowly import slow_but_for
from tests.watching import until

NAMED_WITHIN = 2.0  # s; of the engine's steps, whose waiting for the disk's thread does not count
NOT_RECORDED = r"(?P<topic>\S+): (?P<count>\d+) messages are not in the recording"
SCORED = {mapping.topic for mapping in DEFAULT_MAPPINGS}


class Stop(StrEnum):
    COMPLETED = "completed"
    ELAPSED = "timeout elapsed"
    DECLARED = "timeout declared"
    ABORTED = "aborted"


@dataclass(frozen=True, slots=True)
class Fault:
    """What a disk does, and how it is put right; where that cannot be, the bag is gone.

    Attributes:
        words: by which it is named.
        bag_is_whole: open files can still be written.
    """

    words: str
    spoil: Callable[[SmallDisk, Drive], object]
    mend: Callable[[SmallDisk, Drive], object] | None
    disk: Callable[[Path], AbstractContextManager[SmallDisk]]
    bag_is_whole: bool = False


STAYS, LOST = "; what comes waits in memory", "the file was deleted; what was written is lost"
FAULTS = {
    "disk full": Fault(
        f"No space left on device{STAYS}",
        lambda disk, _: disk.fill(),
        lambda disk, _: disk.make_room(),
        memory_disk,
    ),
    "disk turned read-only": Fault(
        f"Read-only file system{STAYS}",
        lambda disk, _: disk.turn_read_only(),
        lambda disk, _: disk.come_back(),
        disk_image,
    ),
    "disk pulled out": Fault(
        f"Input/output error{STAYS}",
        lambda disk, _: disk.pull_out(),
        lambda disk, _: disk.come_back(),
        disk_image,
    ),
    "results folder deleted": Fault(
        LOST, lambda _, drive: shutil.rmtree(drive.engine.config.results), None, memory_disk
    ),
    "run folder deleted": Fault(
        LOST, lambda _, drive: shutil.rmtree(drive.folder), None, memory_disk
    ),
    "run folder made read-only": Fault(
        "cannot be written: make it yours",
        lambda _, drive: lock_folder(drive.folder, locked=True),
        lambda _, drive: lock_folder(drive.folder, locked=False),
        disk_image,
        bag_is_whole=True,
    ),
}


class Recorded(Drive):
    """Keeps what the recorder is handed, and counts when it has brought all to the disk."""

    def __init__(self, results: Path, stop: Stop) -> None:
        super().__init__(results, scenario_of(stop))
        self.taken: list[RawMessage] = []
        self.syncs = 0
        take = self.source.take_messages

        def kept(timeout: float) -> list[RawMessage]:
            messages = take(timeout)
            self.taken += messages
            return messages

        self.source.take_messages = kept  # type: ignore[method-assign]

    @property
    def faults(self) -> str:
        return " | ".join(self.engine.snapshot().faults)

    @property
    def result(self) -> Result:
        assert self.engine.scored is not None
        return self.engine.scored.result

    def of_the_run(self) -> list[RawMessage]:
        """The messages that came since its countdown."""
        began = self.engine.run.countdown_began
        assert began is not None
        return [message for message in self.taken if message.receive_ns / 1e9 > began]

    def wait_for_sync(self) -> None:
        """Until everything handed in is on the disk."""
        newest = max(message.receive_ns for message in self.taken)
        until(lambda: any(m.receive_ns >= newest for m in Bag(self.folder).messages()))
        # It is in the file; the sync that brings it to the disk is the second to end from now.
        before = self.syncs
        until(lambda: self.syncs >= before + 2)


def scenario_of(stop: Stop) -> Scenario:
    return Scenario.NOMINAL if stop is Stop.COMPLETED else Scenario.TOUCH_ONLY


def setup_of(stop: Stop, run_number: int = 1) -> RunSetup:
    timeout = 60.0 if stop is Stop.COMPLETED else 9.0
    return make_setup(run_number=run_number, timeout=timeout)


@cache
def undisturbed(stop: Stop) -> Result:
    """The same run on a good disk, to the end that its scenario has."""
    with TemporaryDirectory() as folder:
        drive = Recorded(Path(folder), stop)
        drive.whole_run(setup_of(stop))
        drive.engine.close()
    return drive.result


@contextmanager
def on_a_disk(fault: Fault, stop: Stop, folder: Path) -> Iterator[tuple[SmallDisk, Recorded]]:
    with fault.disk(folder) as disk, pytest.MonkeyPatch.context() as patch:
        drive = Recorded(disk.folder / "results", stop)
        sync = BagFile.sync

        def counted(file: BagFile) -> None:
            sync(file)
            drive.syncs += 1

        patch.setattr(BagFile, "sync", counted)
        yield disk, drive
        drive.engine.close()


def go_through(fault: Fault, stop: Stop, moment: float, folder: Path) -> None:
    """A run whose disk fails `moment` s after its start, checked at every stage."""
    with on_a_disk(fault, stop, folder) as (disk, drive):
        drive.start(setup_of(stop))
        drive.wait(moment)
        safe = Counter(message.topic for message in drive.of_the_run())
        drive.wait_for_sync()
        assert drive.faults == ""
        fault.spoil(disk, drive)
        named = drive.engine.now() + NAMED_WITHIN
        while fault.words not in drive.faults:
            assert drive.engine.now() < named, f"not named: {drive.faults}"
            drive.engine.step(STEP)
            time.sleep(STEP)
        match stop:
            case Stop.DECLARED:
                drive.act(DeclareTimeout("gave up"))
            case Stop.ABORTED:
                drive.act(Abort("enough"))
        drive.finish()
        check_live(drive, stop)
        if fault.mend is not None:  # a result is shown, and on disk as soon as that is possible
            assert drive.engine.refused.startswith("the result is NOT on disk: ")
            assert drive.engine.refused in drive.faults
            fault.mend(disk, drive)
            drive.wait(RETRY_PERIOD + STEP)
            written = msgspec.json.decode((drive.folder / "result.json").read_bytes())
            assert written["files_left_out"] == []  # what could not be read can be now
        check_on_disk(drive)
        check_flag(drive, fault)
        check_bag(drive, fault, safe)
        check_scored_again(drive, fault)
        assert drive.engine.next_run_number(3, 1, practice=True).result() == 2
        drive.whole_run(setup_of(stop, 2))
        assert drive.result.quality.lost == ()
        assert drive.faults == ""
        assert Bag(drive.folder).complete


def check_live(drive: Recorded, stop: Stop) -> None:
    """Events, steps and outcome are those of a run on a good disk."""
    result, good = drive.result, undisturbed(stop)
    assert any("recording to the bag failed: " in r for r in result.quality.lost)
    if stop in (Stop.COMPLETED, Stop.ELAPSED):
        assert replace(result, quality=Quality()) == replace(good, quality=Quality())
        return
    seen = [event for event in result.events if event.event is not EventName.BENCHMARK_STOP]
    assert seen == [event for event in good.events if event.event is not EventName.BENCHMARK_STOP]
    assert len(seen) == 2
    assert drive.engine.run.outcome is (
        Outcome.ABORTED if stop is Stop.ABORTED else Outcome.TIMEOUT
    )
    assert result.stop == drive.engine.run.stop


def check_on_disk(drive: Recorded) -> None:
    """The result and every line of the journal, once, are in the run's folder."""
    result = drive.result
    assert drive.engine.refused == ""
    document = msgspec.json.decode((drive.folder / "result.json").read_bytes())
    assert document["outcome"] == result.outcome
    assert document["quality"]["lost"] == list(result.quality.lost)
    entries, torn = read_journal(drive.folder / "journal.jsonl")
    what = [entry.what for entry in entries if entry.what != Change.UNRECORDED]
    assert len(entries) - len(what) == (drive.engine.run.unrecorded > 0)
    assert what[:4] == ["set up", "zero the handle", "confirm the start pose", "start"]
    assert what[-2:] in (["run stops", "result written"], ["abort", "result written"])
    assert len(torn) <= 1
    assert len({entry.to_json() for entry in entries}) == len(entries)
    assert rebuild(entries, drive.engine.run.handle_zero).outcome is result.outcome


def check_flag(drive: Recorded, fault: Fault) -> None:
    """A recording that lacks scored messages is a flag, which outlives a spoilt `result.json`."""
    told = (re.fullmatch(NOT_RECORDED, r) for r in drive.result.quality.lost)
    lacking = sum(int(one["count"]) for one in told if one and one["topic"] in SCORED)
    assert fault.bag_is_whole or lacking > 100
    words = f"the recording lacks {lacking} messages: the result cannot be made again from it"
    flag = Flag(FlagKind.RECORDING, words, FlagWeight.CAUTION)
    flagged = [one for one in drive.engine.snapshot().flags if one.kind is FlagKind.RECORDING]
    assert flagged == [flag] * (lacking > 0)
    assert (flag in read_result(str(drive.folder)).flags) is (lacking > 0)
    if lacking and fault.mend is not None:  # else no bag to score again
        path = drive.folder / "result.json"
        kept = path.read_bytes()
        path.write_bytes(b"{")
        assert flag in score_opened(drive.folder).flags
        path.write_bytes(kept)


def check_bag(drive: Recorded, fault: Fault, safe: Counter[str]) -> None:
    """What had come before the fault is there, in order and without a hole."""
    if fault.mend is None:
        with pytest.raises(RecorderError):
            Bag(drive.folder)
        return
    recorded = list(Bag(drive.folder).messages())
    for topic, count in safe.items():
        kept = [message for message in recorded if message.topic == topic]
        handed_in = [message for message in drive.of_the_run() if message.topic == topic]
        assert len(kept) >= count > 100
        assert kept == handed_in[: len(kept)]


def check_scored_again(drive: Recorded, fault: Fault) -> None:
    """`madrob score` reads what is left: a bag that ends early, or the result's tables alone."""
    live, again = drive.result, next(score(drive.folder)).result
    if fault.mend is None:
        assert again.events == live.events
    else:
        assert (again.outcome, again.outcome_reason) == (live.outcome, live.outcome_reason)
        assert again.stop == live.stop
    if (fault.mend is None or fault.bag_is_whole) and live.outcome is Outcome.COMPLETED:
        values = {name: i.value for name, i in live.indicators.items()}
        again_values = {name: i.value for name, i in again.indicators.items()}
        if again.ruleset != live.ruleset:  # the tables alone have the level of 2020, of four events
            del values[IndicatorName.CAPABILITY_LEVEL]
            assert again_values.pop(IndicatorName.CAPABILITY_LEVEL) == 4
        assert again_values == pytest.approx(values, rel=1e-3)


@pytest.mark.needs("mkfs.ext4")
@pytest.mark.parametrize("stop", slow_but_for(Stop, Stop.COMPLETED, Stop.ABORTED))
@pytest.mark.parametrize("fault", slow_but_for(FAULTS, "disk full", "run folder deleted"))
def test_a_failing_disk_is_named_and_ends_no_run(
    fault: str, stop: Stop, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    """At a moment by chance; with `--runs 200` at ten of them."""
    rng = random.Random(f"{fault} {stop}")
    for number in range(max(1, request.config.getoption("--runs") // 20)):
        latest = 12.0 if stop is Stop.COMPLETED else 6.0
        go_through(FAULTS[fault], stop, rng.uniform(2.5, latest), tmp_path / f"disk{number}")


NAMED: dict[str, Callable[[Path, Path], object]] = {
    "nothing": lambda _folder, _other: None,
    "a link to another run": lambda folder, other: folder.symlink_to(other),
    "another folder": lambda folder, other: shutil.copytree(other, folder),
}
"""What has the name of a run's folder after that was renamed."""


@pytest.mark.parametrize("named", NAMED)
def test_a_run_stays_in_the_folder_where_it_began(named: str, tmp_path: Path) -> None:
    other = shutil.copytree(recorded(Scenario.TOUCH_ONLY), tmp_path / "other")
    files = contents(other)
    drive = Recorded(tmp_path, Stop.ELAPSED)
    drive.start(setup_of(Stop.ELAPSED, 2))
    folder, away = drive.folder, tmp_path / os.fsdecode(b"away\xe9 (deleted)")
    words = f"rename {tmp_path}/away? (deleted) back to {folder.name}: that is the folder in use"
    for moment in ("in the run", "before the signature"):
        folder.rename(away)
        NAMED[named](folder, other)
        drive.wait(NAMED_WITHIN)
        assert words.replace("?", "\N{REPLACEMENT CHARACTER}") in drive.faults
        if moment == "in the run":
            drive.finish()
            drive.act(AddNote("somebody tidies up"))
        drive.wait(NAMED_WITHIN)
        refused = drive.engine.perform(Finalise(TeamWord.ABSENT, "Ada"))
        assert refused is not None
        assert "back to" in refused
        assert contents(other) == files
        if folder.is_symlink():
            folder.unlink()
        elif folder.exists():
            assert contents(folder) == files
            shutil.rmtree(folder)
        away.rename(folder)
        drive.wait(NAMED_WITHIN)
        assert drive.faults == ""
    drive.act(Finalise(TeamWord.ABSENT, "Ada"))
    result = read_result(str(folder))
    assert (result.files_left_out, result.closure is None) == ((), False)
    assert result.notes[0].text == "somebody tidies up"
    assert not check_run(RunPath(folder)).differences_of(Grade.DIFFERS)
    drive.engine.close()


def contents(folder: Path) -> dict[str, bytes]:
    names = (path for path in folder.iterdir() if not path.name.startswith("."))
    return {path.name: path.read_bytes() for path in names}


def test_a_result_that_waits_keeps_no_later_run_from_its_signature_and_is_written(
    tmp_path: Path,
) -> None:
    drive = Recorded(tmp_path, Stop.ELAPSED)
    drive.start(setup_of(Stop.ELAPSED))
    blocked = drive.folder / "result.json"
    blocked.mkdir()
    drive.finish()
    drive.act(AddNote("look at the disk"))
    assert "NOT on disk" in drive.engine.refused
    assert drive.engine.snapshot().refusals["finalise"] == drive.engine.refused
    drive.whole_run(setup_of(Stop.ELAPSED, 2))
    assert drive.engine.refused == ""
    assert "run 1 of subject 3: the result is NOT on disk" in drive.faults
    drive.act(Finalise(TeamWord.ABSENT, "Ada"))
    assert drive.engine.run.phase is Phase.FINAL
    blocked.rmdir()
    drive.wait(RETRY_PERIOD + STEP)
    assert drive.faults == ""
    document = msgspec.json.decode(blocked.read_bytes())
    assert (document["outcome"], document["notes"][0]["text"]) == ("timeout", "look at the disk")
    what = [entry.what for entry in read_journal(blocked.with_name("journal.jsonl"))[0]]
    assert what[-3:] == ["run stops", "note", "result written"]
    drive.engine.close()


def test_a_start_that_a_full_disk_refuses_leaves_the_engine_ready(tmp_path: Path) -> None:
    refusals = []
    with memory_disk(tmp_path / "disk") as disk:
        drive = Recorded(disk.folder / "results", Stop.ELAPSED)
        for free_blocks in range(8):
            number = drive.engine.next_run_number(3, 1, practice=True).result()
            drive.prepare(setup_of(Stop.ELAPSED, number))
            disk.fill(free_blocks)
            if (refused := drive.engine.perform(Start())) is None:
                drive.finish()  # the disk ends no run, even when it takes nothing of it
                assert drive.engine.run.outcome is Outcome.TIMEOUT
            else:
                refusals.append(refused)
                assert drive.engine.run.phase is Phase.READY
            disk.make_room()
        number = drive.engine.next_run_number(3, 1, practice=True).result()
        drive.whole_run(setup_of(Stop.ELAPSED, number))
        assert drive.faults == ""
        drive.engine.close()
        assert find_unfinished(drive.engine.config.results) == ()
    assert len(refusals) >= 3
    assert all("No space left on device" in words and "\n" not in words for words in refusals)
