"""Whole run folders, recorded once for all tests of a process; tests copy what they change."""

from __future__ import annotations

import hashlib
import shutil
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from madrob_console.archive.folders import JOURNAL_FILE, RESULT_FILE
from madrob_console.referee.acts import (
    Abort,
    Act,
    AddNote,
    ConfirmPose,
    DeclareTimeout,
    Finalise,
    MarkIncident,
    Reissue,
    Rule,
    SetUp,
    Start,
    Waive,
)
from madrob_console.referee.records import CheckName, IncidentKind, TeamWord
from madrob_console.referee.run import Phase
from madrob_console.testbeds.simulated import Scenario
from recorder.reader import Bag
from recorder.recovery import recover
from scoring.protocol import Step
from tests.madrob_console.engine.drive import Drive, make_setup, signed
from tests.recorder.samples import by_library

_kept: list[TemporaryDirectory[str]] = []

INCIDENT_AT, STOP_AT = 3.0, 5.0
"""Of the run that was appealed, s from its start."""


def new_drive(
    scenario: Scenario = Scenario.NOMINAL, competition: str = "", of: type[Drive] = Drive
) -> Drive:
    """A referee with a results folder that stays as long as the process."""
    _kept.append(TemporaryDirectory())
    return of(Path(_kept[-1].name), scenario, competition=competition)


def _closed(drive: Drive) -> Path:
    drive.engine.close()
    return drive.folder


@cache
def recorded(scenario: Scenario) -> Path:
    """The folder of a finished run of a scenario; it is never to be changed."""
    drive = new_drive(scenario)
    drive.whole_run(make_setup(timeout=20.0 if scenario is Scenario.NOMINAL else 4.0))
    if scenario is Scenario.NOMINAL:  # with everything that a referee can decide
        drive.act(Rule(Step.CROSS, confirmed=False, reason="one foot stayed"))
        drive.act(Finalise(TeamWord.PROTESTED, "Ada"), Reissue("video"))
        drive.act(Rule(Step.CROSS, confirmed=True, reason="video"))
    return _closed(drive)


@cache
def completed(run_number: int = 1, competition: str = "") -> Path:
    """The folder of a nominal run of which nobody has said anything; never to be changed."""
    drive = new_drive(competition=competition)
    drive.whole_run(make_setup(run_number=run_number))
    return _closed(drive)


@cache
def final() -> Path:
    """The folder of a nominal run that its team acknowledged; never to be changed."""
    drive = new_drive()
    drive.whole_run(make_setup())
    drive.act(signed(drive.engine.snapshot()))
    drive.wait(3.0)
    return _closed(drive)


@cache
def ended_after(duration: float, *acts: Act) -> Path:
    """A run that somebody or something ends so long after its start; the countdown is 2 s.

    Its folder is never to be changed.
    """
    drive = new_drive()
    drive.prepare(make_setup())
    drive.act(Start())
    drive.wait(duration)
    if acts:
        drive.act(*acts)
        drive.finish()
    return _closed(drive)


def aborted() -> Path:
    """The folder of a run that the referee aborted 3 s after its start; never to be changed."""
    return ended_after(5.0, Abort("robot on fire"))


@cache
def appealed() -> Path:
    """A run with an incident, a note, a declared timeout, rulings, a protest and a re-issue.

    Its folder is never to be changed.
    """
    drive = new_drive()
    drive.act(SetUp(make_setup()))
    drive.wait(1.5)
    drive.act(Waive(CheckName.HANDLE, "spring is warm"), ConfirmPose(), Start())
    drive.wait_until(lambda: drive.engine.run.phase is Phase.RUNNING)
    drive.wait(INCIDENT_AT)
    drive.act(MarkIncident(IncidentKind.COLLISION, "frame"), AddNote("looks tired"))
    drive.wait(STOP_AT - INCIDENT_AT)
    drive.act(DeclareTimeout("gave up"))
    drive.finish()
    drive.wait(3.0)
    drive.act(Rule(Step.OPEN, confirmed=False, reason="a draught"))
    # the handle was never zeroed: its touch is doubted
    doubts = ("3 values to check: time to handle, passage time, capability level",)
    protested = Finalise(TeamWord.PROTESTED, "R. Eferee", "they saw it differently", doubts)
    drive.act(protested)
    drive.act(Reissue("appeal granted"), Rule(Step.OPEN, confirmed=True, reason="video"))
    drive.act(Finalise(TeamWord.ACKNOWLEDGED, "R. Eferee", undecided=doubts))
    return _closed(drive)


def copy_run(root: Path, run_number: int, scenario: Scenario = Scenario.TOUCH_ONLY) -> Path:
    """A copy of a run in a results folder, with another run number in its folder's name."""
    source = recorded(scenario)
    copy = root / source.name.replace("_run_001_", f"_run_{run_number:03d}_")
    shutil.copytree(source, copy)
    return copy


def note_again(run: Path) -> None:
    """Put the digest of a changed result into its journal, as if it had been written so."""
    path, digest = run / JOURNAL_FILE, hashlib.sha256((run / RESULT_FILE).read_bytes()).hexdigest()
    before, noted, rest = path.read_text().rpartition('"sha256": "')
    path.write_text(f"{before}{noted}{digest}{rest[64:]}")


def list_files(run: Path) -> None:
    """Write what its bag holds into the metadata, as the recorder does."""
    recover(run)


def publish(run: Path, folder: Path) -> None:
    """Put the published files of a run into a folder."""
    folder.mkdir(exist_ok=True)
    for pattern in ("*.csv", "run_info*.yaml", "condition*.yaml"):
        for path in run.glob(pattern):
            shutil.copy(path, folder)


def converted(
    run: Path, to: Path, *, chunk: int = 0, records: bool = True, without: str = "nothing"
) -> Path:
    """The recording of a run, written again to a file by another tool.

    Blocks of `chunk` messages come in reverse order. Metadata records are kept or lost, and
    topics that contain the word `without` are left out.
    """
    bag = Bag(next(run.glob("*_0.mcap")))
    messages = [message for message in bag.messages() if without not in message.topic]
    size = chunk or len(messages)
    starts = range(0, len(messages), size)
    order = (one for start in starts[::-1] for one in messages[start : start + size])
    topics = [topic for topic in bag.topics() if without not in topic.name]
    kept = bag.records if records else {}
    to.write_bytes(by_library(order, topics, kept, chunk_size=100_000 if chunk else 2**20))
    return to
