"""What a disk refuses before, beside and after a run: nothing is lost, nothing blocks the next."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec
import pytest

from madrob_console.archive import score
from madrob_console.archive.unfinished import find_unfinished
from madrob_console.engine.live.result_keeper import RETRY_PERIOD
from madrob_console.errors import MadrobError
from madrob_console.referee.acts import AddNote, Finalise, Start
from madrob_console.referee.journal import Entry, Journal, Origin, read_journal
from madrob_console.referee.on_record import TeamWord
from madrob_console.referee.run import Phase
from madrob_console.testbeds.simulated import Scenario
from scoring.protocol import Outcome
from tests.madrob_console.engine.drive import STEP, Drive
from tests.madrob_console.failing_disk import Fault, Stop, check_on_disk, setup_of, spoiled
from tests.madrob_console.small_disk import disk_image, lock_folder, memory_disk


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
    assert drive.engine.folder is not None
    journal = drive.engine.folder / "journal.jsonl"
    before = read_journal(journal)[0]
    journal.unlink()
    drive.wait(RETRY_PERIOD + STEP)
    assert read_journal(journal)[0][: len(before)] == before
    drive.finish()
    assert drive.engine.scored is not None
    check_on_disk(drive, drive.engine.folder, drive.engine.scored.result)
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
            f"recorder: {results / 'practice'}: Input/output error; choose another results folder"
        )
        again.engine.close()


def test_a_run_folder_that_may_not_be_entered_keeps_no_engine_from_starting() -> None:
    with TemporaryDirectory() as name:
        results = Path(name)
        results.chmod(0o755)
        drive = Drive(results, Scenario.TOUCH_ONLY)
        drive.start(setup_of(Stop.ELAPSED))
        drive.wait(1.0)
        folder = drive.engine.folder
        assert folder is not None
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
