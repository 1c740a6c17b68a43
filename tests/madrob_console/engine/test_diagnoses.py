"""What ROS programs hear of how the console is: the screens' words, with a level."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from madrob_console.engine.shown.diagnoses import diagnoses
from madrob_console.engine.shown.snapshot import Pulse, Snapshot
from madrob_console.testbeds.outside import Diagnosis, Level
from tests.madrob_console.engine.drive import Drive
from tests.madrob_console.engine.faulty_source import FaultyDrive

DOOR = "/madrob/door/angle"


def told(snapshot: Snapshot) -> dict[str, Diagnosis]:
    return {diagnosis.name: diagnosis for diagnosis in diagnoses(snapshot, 50.0)}


@pytest.fixture
def snapshot(tmp_path: Path) -> Snapshot:
    """Of a healthy testbed."""
    drive = Drive(tmp_path)
    drive.wait(3.0)
    snapshot = drive.engine.snapshot()
    drive.engine.close()
    return snapshot


def test_where_all_is_well_everything_is_ok_and_has_its_numbers(snapshot: Snapshot) -> None:
    heard = told(snapshot)
    assert {diagnosis.level for diagnosis in heard.values()} == {Level.OK}
    assert heard["engine"].message == heard["engine"].values["phase"] == "idle"
    assert heard["recorder"].message == "closed"
    assert heard["disk"].message.endswith("needed")  # the pre-start check's words
    door = heard[DOOR]
    assert door.message == "fresh"
    assert float(door.values["rate, Hz"]) == pytest.approx(50, abs=1)
    assert door.values["expected, Hz"] == "50"
    assert heard["/madrob/door/locked"].message == "never seen (optional)"


def test_a_topic_that_falls_silent_is_stale_in_the_words_of_the_screens(tmp_path: Path) -> None:
    drive = FaultyDrive(tmp_path)
    drive.wait(3.0)
    drive.faulty.replace_data(DOOR, [])
    drive.wait(3.0)
    snapshot = drive.engine.snapshot()
    heard = told(snapshot)
    view = next(view for view in snapshot.topics if view.topic == DOOR)
    assert (heard[DOOR].level, heard[DOOR].message) == (Level.STALE, view.problem)
    assert heard["engine"].level is Level.OK  # what the topic says is not said again
    drive.engine.close()


def test_what_is_wrong_with_engine_recorder_and_disk_is_an_error_of_its_own(
    snapshot: Snapshot,
) -> None:
    recorder = replace(snapshot.recorder, state="failed", dropped=3, queued=77)
    faults = ("recorder: disk full", "recorder: 3 messages dropped", "another referee: ada")
    snapshot = replace(snapshot, recorder=recorder, faults=faults, pulse=Pulse(disk=4))
    heard = told(snapshot)
    assert heard["recorder"].level is Level.ERROR
    assert heard["recorder"].message == "disk full; 3 messages dropped"
    assert heard["recorder"].values["queue, bytes"] == "77"
    assert (heard["disk"].level, heard["disk"].message) == (Level.ERROR, "silent for 4 s")
    assert (heard["engine"].level, heard["engine"].message) == (Level.WARN, "another referee: ada")
    hung = told(replace(snapshot, pulse=Pulse(core=3)))["engine"]
    assert hung.level is Level.ERROR
    assert hung.message == "the engine has not moved for 3 s: what you see is old"
    assert hung.values["core silent, s"] == "3"
