"""The handle zero: what is kept of its samples, and when the referee is asked for another."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from madrob_console.archive.check import check_run
from madrob_console.archive.result_reader import read_whole_result
from madrob_console.archive.run_paths import RunPath
from madrob_console.archive.scored import read_recorded_run
from madrob_console.messages.codec import Message
from madrob_console.referee.acts import ConfirmPose, SetUp, Start, Waive, ZeroHandle
from madrob_console.referee.journal import read_journal
from madrob_console.referee.on_record import CheckName
from scoring.rest import HandleRest
from tests.madrob_console.engine.drive import Drive, make_setup
from tests.madrob_console.engine.faulty_source import TIMEOUT, FaultyDrive
from tests.madrob_console.engine.spoilt import Edit

HANDLE = "/madrob/handle/force"


def samples(drive: Drive) -> HandleRest:
    found = drive.engine.run.zero_samples
    assert found is not None
    return found


def asked_for_a_zero(drive: Drive) -> bool:
    return CheckName.HANDLE_ZERO in [check.name for check in drive.engine.snapshot().checks]


def shifted(by: float) -> Edit:
    """The load cell reads more by so much, N."""

    def edit(message: Message) -> None:
        message.wrench.force.x += by

    return edit


def drifting_run(drive: FaultyDrive, by: float, number: int = 1) -> float | None:
    """A run in which the load cell drifts by so much, N, after the start; the drift found."""
    drive.act(SetUp(make_setup(timeout=TIMEOUT, countdown=1.0, run_number=number)))
    drive.wait(2.1)
    drive.act(ZeroHandle(), ConfirmPose())
    drive.begin()
    drive.wait(2.0)
    drive.faulty.fake(HANDLE, shifted(by))
    rest = drive.result().rest
    assert rest is not None
    return rest.drift


def test_the_samples_behind_the_zero_stand_in_state_journal_bag_and_result(tmp_path: Path) -> None:
    drive = Drive(tmp_path)
    drive.whole_run(make_setup())
    kept, folder = samples(drive), drive.folder
    assert kept.mean == drive.engine.run.handle_zero == pytest.approx(5.9, abs=0.05)
    assert kept.number == 50
    assert kept.deviation == pytest.approx(0.05, rel=0.4)
    assert kept.span == pytest.approx(0.22, rel=0.5)
    assert kept.end - kept.begin == pytest.approx(0.98, abs=0.03)
    (line,) = (e for e in read_journal(folder / "journal.jsonl")[0] if e.what == ZeroHandle.name)
    told = {name: getattr(kept, name) for name in kept.__slots__}
    assert line.details == {"samples": told}
    stored = read_whole_result(str(folder))
    assert (stored["handle_zero"], stored["zero_samples"]) == (kept.mean, told)
    (folder / "journal.jsonl").unlink()
    assert read_recorded_run(folder).run.zero_samples == kept
    assert any("zero the handle: 5.9" in log.text for log in drive.engine.log.lines)
    drive.engine.close()


def test_a_zero_of_before_the_set_up_has_its_samples_in_the_result(tmp_path: Path) -> None:
    drive = Drive(tmp_path)
    drive.wait(1.5)
    drive.act(ZeroHandle())
    kept = samples(drive)
    drive.act(SetUp(make_setup()))
    drive.wait(1.5)
    drive.act(ConfirmPose(), Start())
    drive.finish()
    drive.engine.close()
    assert json.loads((drive.folder / "result.json").read_text())["zero_samples"]["end"] == kept.end
    assert check_run(RunPath(drive.folder)).found == ()


def test_a_handle_that_drifted_is_to_be_zeroed_before_the_next_run(tmp_path: Path) -> None:
    drive = FaultyDrive(tmp_path)
    assert drifting_run(drive, -1.3) == pytest.approx(-1.3, abs=0.1)
    drive.faulty.heal(HANDLE)  # nobody sees it any more
    drive.act(SetUp(make_setup(run_number=2, timeout=TIMEOUT, countdown=1.0)))
    drive.wait(2.1)
    assert drive.check(CheckName.HANDLE).startswith("ok")
    said = drive.check(CheckName.HANDLE_ZERO)
    assert said.startswith("failed: at rest after the last run the force was -1.")
    assert said.endswith(" N off: zero it again, F7")
    drive.act(ConfirmPose())
    assert (drive.engine.perform(Start()) or "").startswith("handle zero: at rest after the last")
    drive.act(ZeroHandle())
    assert not asked_for_a_zero(drive)
    drive.act(Start())
    drive.engine.close()


def test_a_drift_can_be_waived_for_one_run(tmp_path: Path) -> None:
    drive = FaultyDrive(tmp_path)
    drifting_run(drive, 1.3)
    drive.faulty.heal(HANDLE)
    drive.act(SetUp(make_setup(run_number=2, timeout=TIMEOUT, countdown=1.0)))
    drive.wait(2.1)
    drive.act(Waive(CheckName.HANDLE_ZERO, "the cable was pulled"), ConfirmPose())
    drive.begin()
    result = drive.result()
    assert "check waived: handle zero: the cable was pulled" in result.quality.remarks
    drive.act(SetUp(make_setup(run_number=3)))
    assert not asked_for_a_zero(drive)  # that run found the zero right
    drive.engine.close()


def test_a_drift_below_half_the_threshold_asks_for_nothing(tmp_path: Path) -> None:
    drive = FaultyDrive(tmp_path)
    assert drifting_run(drive, 0.7) == pytest.approx(0.7, abs=0.1)
    drive.act(SetUp(make_setup(run_number=2)))
    assert not asked_for_a_zero(drive)
    drive.engine.close()


def test_an_earlier_run_that_is_opened_asks_for_no_zero(tmp_path: Path) -> None:
    first = FaultyDrive(tmp_path)
    drifting_run(first, 1.3)
    folder = first.folder
    first.engine.close()
    drive = Drive(tmp_path)
    assert drive.open(folder) is None
    drive.act(SetUp(make_setup(run_number=2)))
    assert not asked_for_a_zero(drive)
    drive.engine.close()


def test_a_zero_of_an_unsteady_force_stands_in_the_way_of_a_start(tmp_path: Path) -> None:
    drive = FaultyDrive(tmp_path)
    drive.act(SetUp(make_setup()))
    drive.wait(1.5)
    drive.faulty.fake(HANDLE, shifted(1.2))
    drive.wait(0.5)
    drive.act(ZeroHandle())
    said = drive.check(CheckName.HANDLE_ZERO)
    assert said.startswith("failed: samples span 1.")
    assert said.endswith(" N, steady up to 0.98 N: zero it again, F7")
    drive.faulty.fake(HANDLE, shifted(14.0))
    drive.wait(0.5)
    refused = drive.engine.perform(ZeroHandle())
    assert refused == "the handle force is not steady: let go of it, wait a second"
    drive.wait(1.0)
    drive.act(ZeroHandle())
    assert not asked_for_a_zero(drive)
    drive.engine.close()


def test_there_is_no_zero_of_a_few_samples(tmp_path: Path) -> None:
    drive = Drive(tmp_path)
    drive.act(SetUp(make_setup()))
    drive.wait_until(lambda: drive.engine.snapshot().handle.force is not None)
    assert drive.engine.snapshot().refusals[ZeroHandle.name] == "no fresh handle force"
    drive.wait(0.5)
    assert ZeroHandle.name not in drive.engine.snapshot().refusals
    drive.engine.close()
