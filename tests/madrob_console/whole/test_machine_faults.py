"""A disk that fills, turns read-only, vanishes or loses files ends no run and loses no result."""

from __future__ import annotations

import os
import random
import re
import shutil
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import islice, product
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec
import pytest

from madrob_console.archive import score
from madrob_console.archive.result_reader import read_result
from madrob_console.archive.run_journal import find_unfinished
from madrob_console.archive.scored import score_opened
from madrob_console.common.errors import MadrobError
from madrob_console.engine.result_writer import RETRY_PERIOD
from madrob_console.messages.codec import DEFAULT_MAPPINGS
from madrob_console.referee.acts import AddNote, Finalise, Start
from madrob_console.referee.flags import Flag, FlagKind, FlagWeight
from madrob_console.referee.journal import Entry, Journal, Origin, read_journal
from madrob_console.referee.records import TeamWord
from madrob_console.referee.run import Phase
from madrob_console.testbeds.simulated import Scenario
from recorder.bag import RawMessage
from recorder.errors import RecorderError
from recorder.reader import read_bag
from scoring.protocol import EventName, Outcome
from scoring.quality import Quality
from tests.madrob_console.engine.drive import STEP, Drive
from tests.madrob_console.failing_disk import (
    DELETED,
    NAMED_WITHIN,
    Fault,
    Machine,
    Stop,
    check_on_disk,
    setup_of,
    spoiled,
    undisturbed,
)
from tests.madrob_console.small_disk import disk_image, lock_folder, memory_disk
from tests.slowly import slow_but_for

FAULT_AT = 5.0
NOT_RECORDED = r"(?P<topic>\S+): (?P<count>\d+) messages are not in the recording"
SCORED = {mapping.topic for mapping in DEFAULT_MAPPINGS}


@dataclass(frozen=True)
class Told:
    """What became of a run."""

    named_after: float
    words: str


def go_through(machine: Machine, stop: Stop, moment: float) -> Told:
    """A run whose disk fails `moment` s after its start, checked at every stage."""
    drive = machine.drive
    drive.start(setup_of(stop))
    drive.wait(moment)
    safe = Counter(message.topic for message in drive.taken if machine.in_run(message))
    machine.wait_for_sync()
    assert drive.engine.snapshot().faults == ()
    machine.spoil()
    named_after, words = machine.named_after(), machine.words
    machine.stop(stop)
    check_live(drive, stop)
    check_result(machine)
    check_bag(machine, safe)
    check_scored_again(machine)
    check_next_run(machine, stop)
    return Told(named_after, words)


def check_live(drive: Drive, stop: Stop) -> None:
    """Events, steps and outcome are those of a run on a good disk."""
    scored, good = drive.engine.scored, undisturbed(stop)
    assert scored is not None
    result = scored.result
    if stop in (Stop.COMPLETED, Stop.ELAPSED):
        assert replace(result, quality=Quality()) == replace(good, quality=Quality())
        return
    seen = [event for event in result.events if event.event is not EventName.BENCHMARK_STOP]
    assert seen == [event for event in good.events if event.event is not EventName.BENCHMARK_STOP]
    assert len(seen) == 2
    outcome = Outcome.ABORTED if stop is Stop.ABORTED else Outcome.TIMEOUT
    assert (drive.engine.run.outcome, result.stop) == (outcome, drive.engine.run.stop)


def check_result(machine: Machine) -> None:
    """It is shown, and on disk as soon as that is possible."""
    engine, refused = machine.drive.engine, machine.fault not in DELETED
    shown = engine.snapshot()
    assert shown.result is not None
    assert any("recording to the bag failed: " in r for r in shown.result.quality.remarks)
    if refused:
        assert engine.refused.startswith(f"the result is NOT on disk: {machine.folder}")
        assert engine.refused in shown.faults
        machine.mend()
        machine.drive.wait(RETRY_PERIOD + STEP)
        written = msgspec.json.decode((machine.folder / "result.json").read_bytes())
        assert written["files_left_out"] == []  # what could not be read can be now
    check_on_disk(machine.drive, machine.folder, shown.result)
    check_flag(machine)


def check_flag(machine: Machine) -> None:
    """A recording that lacks scored messages is a flag, which outlives a spoilt `result.json`."""
    scored, shown = machine.drive.engine.scored, machine.drive.engine.snapshot()
    assert scored is not None
    told = (re.fullmatch(NOT_RECORDED, remark) for remark in scored.result.quality.remarks)
    lacking = sum(int(one["count"]) for one in told if one and one["topic"] in SCORED)
    flagged = [flag for flag in shown.flags if flag.kind is FlagKind.RECORDING]
    assert (machine.fault is Fault.RUN_LOCKED) or lacking > 100
    assert bool(flagged) is (lacking > 0)
    if not flagged:
        return
    words = f"the recording lacks {lacking} messages: the result cannot be made again from it"
    assert flagged == [Flag(FlagKind.RECORDING, words, FlagWeight.CAUTION)]
    assert flagged[0] in read_result(str(machine.folder)).known_flags
    if machine.fault not in DELETED:  # no bag to score again
        kept = (machine.folder / "result.json").read_bytes()
        (machine.folder / "result.json").write_bytes(b"{")
        assert flagged[0] in score_opened(machine.folder).flags
        (machine.folder / "result.json").write_bytes(kept)


def check_bag(machine: Machine, safe: Counter[str]) -> None:
    """What had come before the fault is there, in order and without a hole."""
    if machine.fault in DELETED:
        with pytest.raises(RecorderError):
            read_bag(machine.folder)
        return
    recorded: dict[str, list[RawMessage]] = {}
    for message in read_bag(machine.folder).messages():
        recorded.setdefault(message.topic, []).append(message)
    for topic, count in safe.items():
        handed_in = [m for m in machine.drive.taken if m.topic == topic and machine.in_run(m)]
        assert len(recorded[topic]) >= count > 100
        assert recorded[topic] == handed_in[: len(recorded[topic])]


def check_scored_again(machine: Machine) -> None:
    """`madrob score` reads what is left: a bag that ends early, or the result's tables alone."""
    scored = machine.drive.engine.scored
    assert scored is not None
    live, again = scored.result, next(score(machine.folder)).result
    if machine.fault in DELETED:
        assert again.events == live.events
    else:
        assert (again.outcome, again.outcome_reason) == (live.outcome, live.outcome_reason)
        assert again.stop == live.stop
    if machine.fault in (*DELETED, Fault.RUN_LOCKED) and live.outcome is Outcome.COMPLETED:
        values = {name: i.value for name, i in live.indicators.items()}
        assert {name: i.value for name, i in again.indicators.items()} == pytest.approx(
            values, rel=1e-3
        )


def check_next_run(machine: Machine, stop: Stop) -> None:
    drive = machine.drive
    number = drive.engine.next_run_number(3, 1, practice=True).result()
    assert number == 2
    drive.whole_run(setup_of(stop, number))
    assert drive.engine.scored is not None
    assert drive.engine.scored.result.quality.remarks == ()
    assert drive.engine.snapshot().faults == ()
    assert read_bag(machine.folder).complete


@pytest.mark.needs("mkfs.ext4")
@pytest.mark.parametrize("fault", slow_but_for(Fault, Fault.FULL, Fault.RUN_DELETED))
def test_a_failing_disk_is_named_and_ends_no_run(fault: Fault, tmp_path: Path) -> None:
    with spoiled(fault, tmp_path / "disk", Stop.COMPLETED) as machine:
        go_through(machine, Stop.COMPLETED, FAULT_AT)


@pytest.mark.needs("mkfs.ext4")
@pytest.mark.parametrize(
    "stop", slow_but_for([Stop.ELAPSED, Stop.DECLARED, Stop.ABORTED], Stop.ABORTED)
)
@pytest.mark.parametrize("fault", slow_but_for([Fault.FULL, Fault.READ_ONLY], Fault.FULL))
def test_timeout_and_abort_need_no_disk(fault: Fault, stop: Stop, tmp_path: Path) -> None:
    with spoiled(fault, tmp_path / "disk", stop) as machine:
        go_through(machine, stop, FAULT_AT)


@pytest.mark.needs("mkfs.ext4")
@pytest.mark.slow
@pytest.mark.parametrize("fault", list(Fault))
def test_a_disk_that_fails_at_any_moment_loses_no_run(
    fault: Fault, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    count, rng = max(4, request.config.getoption("--runs") // 4), random.Random(fault)
    told = []
    for number, stop in islice(product(range(count), Stop), count):
        with spoiled(fault, tmp_path / f"disk{number}{stop.name}", stop) as machine:
            latest = 12.0 if stop is Stop.COMPLETED else 6.0
            told.append(go_through(machine, stop, rng.uniform(2.5, latest)))
    worst = max(one.named_after for one in told)
    words = told[-1].words.replace(str(tmp_path), "")
    print(f"\n{fault}: {count} tries, 0 runs lost, named after {worst:.2f} s at most: {words}")
    assert worst <= NAMED_WITHIN


@pytest.mark.needs("mkfs.ext4")
@pytest.mark.slow
def test_a_result_that_waits_is_written_while_later_runs_are_made(tmp_path: Path) -> None:
    with spoiled(Fault.RUN_LOCKED, tmp_path / "disk", Stop.ELAPSED) as machine:
        drive = machine.drive
        drive.start(setup_of(Stop.ELAPSED))
        first = machine.folder
        machine.spoil()
        drive.finish()
        drive.act(AddNote("look at the disk"))
        result = drive.engine.scored.result  # type: ignore[union-attr]
        drive.start(setup_of(Stop.ELAPSED, 2))
        waiting = [fault for fault in drive.engine.snapshot().faults if str(first) in fault]
        assert waiting[0].startswith("run 1 of subject 3: the result is NOT on disk")
        lock_folder(first, locked=False)
        drive.finish()
        drive.wait(RETRY_PERIOD + STEP)
        assert drive.engine.snapshot().faults == ()
        second = drive.engine.scored.result  # type: ignore[union-attr]
        check_on_disk(drive, machine.folder, second)
        document = msgspec.json.decode((first / "result.json").read_bytes())
        assert document["outcome"] == result.outcome
        assert document["notes"][0]["text"] == "look at the disk"
        what = [entry.what for entry in read_journal(first / "journal.jsonl")[0]]
        assert what[-3:] == ["run stops", "note", "result written"]


def test_a_run_that_is_not_on_disk_keeps_no_later_one_from_its_signature(tmp_path: Path) -> None:
    drive = Drive(tmp_path, Scenario.TOUCH_ONLY)
    drive.start(setup_of(Stop.ELAPSED))
    blocked = drive.folder / "result.json"
    blocked.mkdir()
    drive.finish()
    assert "NOT on disk" in drive.engine.refused
    assert drive.engine.snapshot().refusals["finalise"] == drive.engine.refused
    drive.whole_run(setup_of(Stop.ELAPSED, 2))
    assert drive.engine.refused == ""
    assert len(drive.engine.waiting) == 1
    drive.act(Finalise(TeamWord.ABSENT, "Ada"))
    assert drive.engine.run.phase is Phase.FINAL
    blocked.rmdir()
    drive.wait(RETRY_PERIOD + STEP)
    assert not drive.engine.waiting
    assert blocked.is_file()
    drive.engine.close()


def test_a_start_that_a_full_disk_refuses_leaves_the_engine_ready(tmp_path: Path) -> None:
    refusals = 0
    with memory_disk(tmp_path / "disk") as disk:
        drive = Drive(disk.folder / "results", Scenario.TOUCH_ONLY)
        for free_blocks in range(8):
            number = drive.engine.next_run_number(3, 1, practice=True).result()
            drive.prepare(setup_of(Stop.ELAPSED, number))
            disk.fill(free_blocks)
            refused = drive.engine.perform(Start())
            if refused is None:
                drive.finish()  # the disk ends no run, even when it takes nothing of it
                assert drive.engine.run.outcome is Outcome.TIMEOUT
            else:
                refusals += 1
                assert "\n" not in refused
                assert "No space left on device" in refused
                assert drive.engine.run.phase is Phase.READY
            disk.make_room()
        drive.whole_run(
            setup_of(Stop.ELAPSED, drive.engine.next_run_number(3, 1, practice=True).result())
        )
        assert drive.engine.snapshot().faults == ()
        drive.engine.close()
        assert find_unfinished(drive.engine.config.results) == ()
    assert refusals >= 3


def test_a_deleted_journal_is_written_anew_with_every_line(tmp_path: Path) -> None:
    drive = Drive(tmp_path, Scenario.TOUCH_ONLY)
    drive.start(setup_of(Stop.ELAPSED))
    drive.wait(1.0)
    journal = drive.folder / "journal.jsonl"
    before = read_journal(journal)[0]
    journal.unlink()
    drive.wait(RETRY_PERIOD + STEP)
    assert read_journal(journal)[0][: len(before)] == before
    drive.finish()
    assert drive.engine.scored is not None
    check_on_disk(drive, drive.folder, drive.engine.scored.result)
    drive.engine.close()


def test_lines_that_waited_for_room_are_written_once(tmp_path: Path) -> None:
    lines = [Entry(float(n), Origin.SYSTEM, f"line {n}", reason="x" * 150) for n in range(60)]
    with memory_disk(tmp_path / "disk") as disk:
        path, journal = disk.folder / "journal.jsonl", Journal()
        journal.open(path)
        disk.fill()
        waiting: list[Entry] = []
        for line in lines:
            waiting.append(line)
            del waiting[: journal.append(waiting)]
        for free_blocks in (1, 2, 60):
            disk.make_room()
            disk.fill(free_blocks)
            del waiting[: journal.append(waiting)]
        assert journal.refused is None
        journal.close()
        assert list(read_journal(path)[0]) == lines


@pytest.mark.needs("mkfs.ext4")
def test_a_disk_that_was_pulled_out_before_the_start_refuses_it_in_one_line(
    tmp_path: Path,
) -> None:
    with disk_image(tmp_path / "disk") as disk:
        results = disk.folder / "results"
        drive = Drive(results, Scenario.TOUCH_ONLY)
        drive.whole_run(setup_of(Stop.ELAPSED))
        drive.engine.close()
        disk.pull_out()
        again = Drive(results, Scenario.TOUCH_ONLY)
        again.prepare(setup_of(Stop.ELAPSED, 2))
        refused = again.engine.perform(Start())
        assert refused == (
            f"{results / 'practice'}: Input/output error; choose another results folder"
        )
        again.engine.close()


def test_a_run_folder_that_may_not_be_entered_keeps_no_engine_from_starting() -> None:
    with TemporaryDirectory() as name:
        results = Path(name)
        results.chmod(0o755)
        drive = Drive(results, Scenario.TOUCH_ONLY)
        drive.start(setup_of(Stop.ELAPSED))
        drive.wait(1.0)
        folder = drive.folder
        with copied(folder, "20231114_000000"):  # an unfinished run beside it
            drive.engine.close()
            folder.chmod(0o000)
            with as_nobody():
                found = find_unfinished(results)
                with pytest.raises(MadrobError, match="Permission denied"):
                    next(score(folder))
            folder.chmod(0o700)
        assert [run.folder[-15:] for run in found] == ["20231114_000000"]


@contextmanager
def copied(folder: Path, stamp: str) -> Iterator[None]:
    copy = folder.with_name(f"{folder.name[:-15]}{stamp}")
    shutil.copytree(folder, copy)
    copy.chmod(0o755)
    yield


@contextmanager
def as_nobody() -> Iterator[None]:
    """Without the rights of root, which may enter every folder."""
    user = os.geteuid()
    if user == 0:
        os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(user)
