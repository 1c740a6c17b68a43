"""A run says everywhere which one it is of all runs, and on which testbed (protocol section 2)."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any
from uuid import UUID

import pytest
import yaml

from madrob_console.archive.check import check_run
from madrob_console.archive.digests import (
    IDENTITY_RECORD,
    identity_record,
    kept_run_id,
    run_id_at,
)
from madrob_console.archive.grades import Grade
from madrob_console.archive.history import History
from madrob_console.archive.repair import recover_recording, repair
from madrob_console.archive.run_filter import matches
from madrob_console.archive.run_paths import RunPath
from madrob_console.archive.run_record import RECORD_NAME
from madrob_console.archive.scored import read_recorded_run, score_run
from madrob_console.referee.acts import Correct, SetUp
from recorder.reader import read_bag
from recorder.recovery import recover
from tests.madrob_console.engine.drive import PULL, Drive, make_setup
from tests.madrob_console.recorded_runs import completed

OLDER = Path(__file__).parents[1] / "whole/version_0_1_0/results"


@pytest.fixture(scope="module")
def run() -> Path:
    return completed()


def stored(folder: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((folder / "result.json").read_text())
    return content


def test_identity_and_testbed_stand_in_journal_recording_result_and_run_info(run: Path) -> None:
    result = stored(run)
    told = {"run_id": result["run_id"], "testbed": "Hall A"}
    assert UUID(told["run_id"]).version == 7
    first = json.loads((run / "journal.jsonl").read_text().partition("\n")[0])
    recorded = json.loads(read_bag(run).records[RECORD_NAME]["run"])
    info = yaml.safe_load(next(run.glob("run_info_*.yaml")).read_text())
    for content in (
        result,
        result["setup"],
        first["details"]["setup"],
        recorded["setup"],
        info["settings"],
    ):
        assert {key: content[key] for key in told} == told
    (listed,) = History(run.parent.parent).refresh()
    assert {"run_id": listed.run_id, "testbed": listed.testbed} == told
    assert matches(listed, "testbed:hall")
    assert not matches(listed, "testbed:b")


def test_each_set_up_has_an_identity_of_its_own_whatever_a_screen_sends(tmp_path: Path) -> None:
    drive, found = Drive(tmp_path), []
    for _ in range(2):
        drive.act(SetUp(make_setup()))
        setup = drive.engine.run.setup
        assert setup is not None
        assert setup == replace(make_setup(), practice=True)
        found.append(setup.run_id)
        drive.act(SetUp(setup))
        assert drive.engine.run.setup is not None
        found.append(drive.engine.run.setup.run_id)
    drive.engine.close()
    assert len(set(found)) == 4


def test_a_corrected_run_is_still_the_same_run(run: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(run, tmp_path / "practice" / run.name)
    drive = Drive(tmp_path)
    assert drive.open(folder) is None
    drive.act(Correct(5, PULL, "the wrong team", "Ghent"))
    drive.wait(1.0)
    drive.engine.close()
    before, after = stored(run), stored(folder)
    assert (before["subject"], after["subject"]) == (3, 5)
    assert after["run_id"] == before["run_id"]
    assert check_run(RunPath(folder)).grade is Grade.SAME


@pytest.mark.parametrize("name", [path.name for path in sorted(OLDER.iterdir())])
def test_an_older_run_has_the_identity_of_its_recording_wherever_it_lies(
    name: str, tmp_path: Path
) -> None:
    moved = shutil.copytree(OLDER / name, tmp_path / "elsewhere" / "renamed")
    assert UUID(run_id_at(moved)).version == 5
    assert run_id_at(moved) == run_id_at(OLDER / name) == run_id_at(next(moved.glob("*.mcap")))
    assert run_id_at(moved) == run_id_at(next(moved.glob("*.mcap")))
    assert read_recorded_run(moved).record.setup.run_id == ""


def test_the_history_knows_the_identity_of_older_runs_also_without_digests(
    tmp_path: Path,
) -> None:
    results = shutil.copytree(OLDER, tmp_path / "results")
    expected = {path.name: run_id_at(path) for path in OLDER.iterdir()}
    for path in results.glob("*/result.json"):
        result = json.loads(path.read_text())
        del result["files"]
        path.write_text(json.dumps(result))
    for root in (shutil.copytree(OLDER, tmp_path / "with digests"), results):
        found = {run.folder: run for run in History(root).refresh() if run.outcome is not None}
        assert len(found) > 3
        assert {name: run.run_id for name, run in found.items()} == {
            name: expected[name] for name in found
        }
        assert {run.testbed for run in found.values()} == {""}


@pytest.fixture
def torn(tmp_path: Path) -> Path:
    """An older run whose recording was damaged after its result was written."""
    finished = next(path for path in sorted(OLDER.iterdir()) if (path / "result.json").exists())
    folder = shutil.copytree(finished, tmp_path / finished.name)
    recording = next(folder.glob("*.mcap"))
    recording.write_bytes(recording.read_bytes()[:-1000])
    return folder


def identities(folder: Path) -> set[str]:
    """As all who ask for it find it."""
    (scored,) = score_run(RunPath(folder), (None,))
    (alone,) = score_run(RunPath(next(folder.glob("*.mcap"))), (None,))
    told = [run.run_id for run in History(folder.parent).refresh() if run.outcome is not None]
    return {scored.label.run_id, alone.label.run_id, *told}


@pytest.mark.parametrize("named", ["folder", "file"])
def test_an_older_run_is_the_same_run_after_its_recording_was_repaired(
    torn: Path, named: str
) -> None:
    (before,) = History(torn.parent).refresh()
    recover_recording(torn if named == "folder" else next(torn.glob("*.mcap")))
    assert identities(torn) == {before.run_id}
    next(torn.glob("*_event.csv")).unlink()
    assert repair(torn) is not None
    assert stored(torn)["run_id"] == before.run_id
    assert identities(torn) == {before.run_id}


def test_an_older_run_without_a_result_is_the_same_run_however_often_it_is_repaired(
    torn: Path,
) -> None:
    (torn / "result.json").unlink()
    before = run_id_at(torn)
    for _ in range(2):
        recover_recording(torn)
        assert identities(torn) == {before}
        recording = next(torn.glob("*.mcap"))
        recording.write_bytes(recording.read_bytes()[:-1000])


def test_a_result_that_claims_an_identity_that_is_none_tells_a_repair_nothing(torn: Path) -> None:
    before = run_id_at(torn)
    (torn / "result.json").write_text(json.dumps(stored(torn) | {"run_id": "not-a-uuid"}))
    recover_recording(torn)
    assert kept_run_id(torn) == before != ""


def test_a_repair_keeps_an_identity_in_its_usual_form(torn: Path) -> None:
    told = "0190b0d0-0000-7000-8000-00000000000a"
    (torn / "result.json").write_text(json.dumps(stored(torn) | {"run_id": told.upper()}))
    recover_recording(torn)
    assert read_bag(torn).records[IDENTITY_RECORD] == {"run_id": told}


def test_no_repair_adds_to_the_identity_of_a_run_that_has_one(run: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(run, tmp_path / run.name)
    recording = next(folder.glob("*.mcap"))
    recording.write_bytes(recording.read_bytes()[:-1000])
    recover_recording(folder)
    assert IDENTITY_RECORD not in read_bag(folder).records


def test_a_recording_that_claims_an_identity_that_is_none_has_that_of_its_digest(
    torn: Path,
) -> None:
    recover(torn, lambda: identity_record("x" * 1000))
    assert kept_run_id(torn) == ""
    assert UUID(run_id_at(torn)).version == 5
