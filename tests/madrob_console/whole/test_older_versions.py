"""What version 0.1.0 wrote is read, judged and shown as it was: runs, settings, teams.

The runs were recorded by that version on its simulated testbed, the referee's acts among them.
Nothing in `version_0_1_0` is ever made anew.
"""

from __future__ import annotations

import json
import shutil
import tomllib
import zipfile
from pathlib import Path
from typing import Any

import jsonschema
import msgspec
import pytest

from madrob_console.archive import score
from madrob_console.archive.check import check_run
from madrob_console.archive.grades import Grade
from madrob_console.archive.history import History, RunSummary
from madrob_console.archive.result_document import ResultDocument, result_schema
from madrob_console.archive.run_paths import RunPath
from madrob_console.archive.unfinished import find_unfinished
from madrob_console.cli.main import main
from madrob_console.config import load_settings
from madrob_console.referee.acts import Finalise
from madrob_console.referee.on_record import TeamWord
from tests.madrob_console.engine.drive import Drive

OLDER = Path(__file__).parent / "version_0_1_0"

RULED = "subject_001_cond_001_run_001_20251121_045002"
"""Everything that a referee can say, and a second issue, which is final."""
INTERRUPTED = "subject_001_cond_001_run_002_20251121_052002"
CUT_OFF = "subject_001_cond_001_run_003_20251121_053002"
"""No result, no end of the bag."""
TIMEOUT = "subject_002_cond_001_run_001_20251121_050002"
"""With a waived check; final."""
ABORTED = "subject_002_cond_001_run_002_20251121_051005"
"""With an accepted false start."""
EUROBENCH = "subject_003_cond_015_run_001_20251121_054003"
"""Completed, by the rules `eurobench-2020`, with a latch sensor."""

EXIT_CODES = {RULED: 0, INTERRUPTED: 5, TIMEOUT: 3, ABORTED: 4, EUROBENCH: 0}
"""What `madrob run` ends with; all of them have a result."""

RESULTS = sorted(path.relative_to(OLDER) for path in OLDER.glob("results/*/result*.json"))


@pytest.fixture
def older(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A home folder as that version left it."""
    home = shutil.copytree(OLDER, tmp_path / "home")
    monkeypatch.setenv("HOME", str(home))
    monkeypatch.setenv("XDG_CONFIG_HOME", str(home / "config"))
    return home


def stored(path: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads(path.read_text())
    return content


def listed(older: Path) -> dict[str, RunSummary]:
    return {run.folder: run for run in History(older / "results").refresh()}


def test_there_is_a_result_of_every_kind() -> None:
    assert {path.parent.name for path in RESULTS} == set(EXIT_CODES)
    assert [path.name for path in RESULTS].count("result_issue_1.json") == 1


@pytest.mark.parametrize("path", RESULTS, ids=str)
def test_nothing_that_a_result_says_is_lost_or_another_when_it_is_read(path: Path) -> None:
    data = (OLDER / path).read_bytes()
    again = msgspec.json.encode(msgspec.json.decode(data, type=ResultDocument))
    _within(json.loads(data), json.loads(again))
    jsonschema.validate(json.loads(data), result_schema())


@pytest.mark.parametrize("name", EXIT_CODES)
def test_a_recording_still_gives_the_stored_result(older: Path, name: str) -> None:
    checked = check_run(RunPath(older / "results" / name))
    assert checked.of(Grade.DIFFERS) == ()  # other libraries, other last digits
    assert checked.stored_by is None


def test_a_run_that_was_cut_off_is_still_scored_and_found(older: Path) -> None:
    (scored,) = score(older / "results" / CUT_OFF)
    assert scored.result.outcome == "interrupted"
    assert any(signal.samples for signal in scored.result.quality.signals)
    (found,) = find_unfinished(older / "results")
    assert (found.folder, found.subject, found.team) == (CUT_OFF, 1, "Delft")


def test_the_history_says_of_each_run_what_its_result_says(older: Path) -> None:
    for _ in range(2):  # the second time from the index
        runs = listed(older)
        assert runs.keys() == {*EXIT_CODES, CUT_OFF}
        for name in EXIT_CODES:
            run, result = runs[name], stored(older / "results" / name / "result.json")
            values = {key: part["value"] for key, part in result["indicators"].items()}
            assert run.problem is None
            assert run.values == {key: v for key, v in values.items() if v is not None}
            assert (run.outcome, run.started) == (result["outcome"], result["start"])
            assert (run.subject, run.team) == (result["subject"], result["team"])
            assert (run.condition, run.ruleset) == (result["condition_number"], result["ruleset"])
            assert (run.issue, run.source) == (result["issue"], result["source"])
            assert run.final == (result["closure"] is not None)
        assert (runs[RULED].issue, runs[RULED].team_word) == (2, "acknowledged")
        assert runs[ABORTED].reason == "the door fell off"
        simulated = "SIMULATED: not an official result"
        flags = {name: {flag.words for flag in run.flags} for name, run in runs.items()}
        assert flags == {
            RULED: {simulated, "steps 1, 2, 3, 4, 5, 6 confirmed", "1 incident (fall)"},
            INTERRUPTED: {simulated},
            TIMEOUT: {simulated, "waived: start pose"},
            ABORTED: {simulated},
            EUROBENCH: {simulated},
            CUT_OFF: set(),
        }
        assert (runs[CUT_OFF].team, runs[CUT_OFF].outcome) == ("Delft", None)


def test_a_result_without_flags_is_flagged_by_what_stands_in_it(older: Path) -> None:
    path = older / "results" / EUROBENCH / "result.json"
    result = stored(path)
    result["false_starts"] = [{"time": 1.0, "event": "handle_is_touched", "accepted": None}]
    result["quality"]["remarks"] = ["fault at -1.9 s: stamps go back", "fault: lost", "a gap"]
    path.write_text(json.dumps(result))
    assert [flag.words for flag in listed(older)[EUROBENCH].flags] == [
        "1 false start UNDECIDED (handle touched)",
        "2 testbed faults",
        "SIMULATED: not an official result",
    ]
    path.write_text(json.dumps({**result, "incidents": [{"kind": "of a later version"}]}))
    run = listed(older)[EUROBENCH]
    assert (run.problem, run.flags) == (None, ())


@pytest.mark.parametrize("name", EXIT_CODES)
def test_a_replay_shows_the_stored_result(
    older: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    run = older / "results" / name
    replay = ["run", "--testbed", "replay", str(run), "--speed", "0"]
    assert main([*replay, "--results", str(older / "none")]) == EXIT_CODES[name]
    assert "replay: equals the stored result" in capsys.readouterr().out


def test_a_referee_goes_on_with_an_opened_run(older: Path) -> None:
    drive = Drive(older / "results")
    folder = older / "results" / ABORTED
    before = stored(folder / "result.json")
    assert drive.open(folder) is None
    drive.act(Finalise(TeamWord.PROTESTED, "A. Nother"))
    drive.wait(1.0)
    drive.engine.close()
    after = stored(folder / "result.json")
    assert after["closure"] | {"time": 0} == {
        "time": 0,
        "referee": "A. Nother",
        "team_word": "protested",
        "note": "",
    }
    told = ("false_starts", "waivers", "incidents", "rulings", "notes", "setup", "start", "stop")
    _within({key: before[key] for key in told}, after)


def test_standings_report_and_export_take_the_runs(
    older: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    settings = ["--settings", str(older / "settings.toml")]
    assert main(["standings", "--practice", "--json", "-", *settings]) == 0
    said = json.loads(capsys.readouterr().out)
    teams = [team["team"] for rules in said["rulesets"] for team in rules["overall"]]
    assert sorted(teams) == ["Delft", "Pisa é", "Roma Due"]  # the list's name, as it is now
    assert {run["folder"] for run in said["left_out"]} == {INTERRUPTED, ABORTED, CUT_OFF}
    assert main(["report", str(older / "results" / RULED)]) == 0
    page = (older / "results" / RULED / "report.html").read_text()
    assert "seen in the video" in page
    export = ["export", "--practice", "--team", "2", "--output", str(older / "2.zip")]
    assert main([*export, *settings]) == 0
    with zipfile.ZipFile(older / "2.zip") as archive:
        packed = {Path(name).name for name in archive.namelist()}
    assert {"result.json", "journal.jsonl", f"{TIMEOUT}_0.mcap", f"{ABORTED}_0.mcap"} <= packed


def test_the_settings_say_what_they_said(older: Path) -> None:
    file = older / "settings.toml"
    _within(tomllib.loads(file.read_text()), msgspec.to_builtins(load_settings(file)))


def _within(told: object, settings: object) -> None:
    """Everything told is what the settings have."""
    match told, settings:
        case dict(), dict():
            for key, value in told.items():
                _within(value, settings[key])
        case list(), list() | tuple():
            assert len(told) == len(settings)
            for one, other in zip(told, settings, strict=True):
                _within(one, other)
        case _:
            assert told == settings
