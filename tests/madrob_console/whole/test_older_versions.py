"""What version 0.1.0 wrote is read, judged and shown as it was: runs, settings, teams.

The runs were recorded by that version on its simulated testbed, the referee's acts among them.
Nothing in `version_0_1_0` is ever made anew."""

from __future__ import annotations

import json
import re
import shutil
import tomllib
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jsonschema
import msgspec
import pytest

from madrob_console.archive import score
from madrob_console.archive.check import Grade, check_run
from madrob_console.archive.folders import JOURNAL_FILE, RESULT_FILE, RunPath
from madrob_console.archive.history import History, RunSummary
from madrob_console.archive.result_document import ResultDocument, result_schema
from madrob_console.archive.run_journal import find_unfinished
from madrob_console.archive.scored import open_run
from madrob_console.cli.main import main
from madrob_console.cli.output import BAD_INPUT
from madrob_console.cli.repairing import repair_all
from madrob_console.common.files import Hold
from madrob_console.config import load_settings
from madrob_console.referee.acts import Finalise, Void
from madrob_console.referee.journal import HOLD_FILE
from madrob_console.referee.records import TeamWord
from tests.madrob_console.engine.drive import Drive
from tests.madrob_console.recorded_runs import final, without_digests

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
    assert checked.differences_of(Grade.DIFFERS) == ()  # other libraries, other last digits
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
    assert run.problem is not None
    assert "result.json is damaged (Invalid enum value 'of a later version'" in run.problem
    assert (run.valid, run.values) == (False, {})


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
    assert main(["standings", "--practice", "--json", *settings]) == 0
    said = json.loads(capsys.readouterr().out)
    teams = [team["team"] for rules in said["rulesets"] for team in rules["overall"]]
    assert sorted(teams) == ["Delft", "Pisa é", "Roma Due"]  # the list's name, as it is now
    assert {run["folder"] for run in said["left_out"]} == {INTERRUPTED, ABORTED, CUT_OFF}
    assert main(["report", str(older / "results" / RULED)]) == 0
    page = (older / "results" / RULED / "report.html").read_text()
    assert "seen in the video" in page
    export = ["export", "--practice", "--subject", "2", "--output", str(older / "2.zip")]
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


SAID = "result.json was changed after it was written: `madrob recover` makes it again"

Change = Callable[[str], str]


def number(key: str, value: str) -> Change:
    """The value of an indicator is another one."""
    return lambda text: re.sub(rf'("{key}": {{\s*"value": )[-\d.]+', rf"\g<1>{value}", text)


def word(before: str, after: str) -> Change:
    return lambda text: text.replace(before, after, 1)


CHANGES: dict[str, Change] = {
    "a better time": number("execution_time", "3.21"),
    "a lower force": number("roughness_of_door_actuation", "0.5"),
    "a lower level": number("capability_level", "4"),
    "one digit": number("passage_time", "4.0"),
    "another team": word('"team": "', '"team": "X'),
    "another word": word('"acknowledged"', '"acknowledges"'),
    "another outcome": word('"outcome": "completed"', '"outcome": "timeout"'),
    "no practice": word('"practice": true', '"practice": false'),
    "a remark": lambda text: re.sub(r'"remarks": \[\]', '"remarks": ["fine"]', text),
    "a version": word('"software": "', '"software": "9'),
    "a space": lambda text: f"{text} ",
    "a flag": word('"flags": [', '"flags_": ['),
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    source = final()
    return shutil.copytree(source, tmp_path / "results" / source.name)


def change_result(folder: Path, change: Change) -> None:
    path = folder / RESULT_FILE
    before = path.read_text()
    assert change(before) != before
    path.write_text(change(before))


def summary(folder: Path) -> RunSummary:
    (run,) = History(folder.parent).refresh()
    return run


def printed(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str]:
    capsys.readouterr()
    code = main([*map(str, arguments)])
    told = capsys.readouterr()
    return code, told.out + told.err


@pytest.mark.parametrize("change", CHANGES)
def test_a_changed_result_is_named_by_all_who_list_and_is_made_again(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], change: str
) -> None:
    right, lines = (folder / RESULT_FILE).read_bytes(), (folder / JOURNAL_FILE).read_bytes()
    root, site = folder.parent, tmp_path / "site"
    assert printed(capsys, "standings", root, "--practice")[0] == 0
    change_result(folder, CHANGES[change])
    for command in (
        ["standings", root],
        ["standings", root, "--practice"],
        ["table", "runs", root],
        ["publish", site, root],
        ["publish", site, root, "--practice"],
    ):
        code, told = printed(capsys, *command)
        assert code == BAD_INPUT, command
        assert f"{folder.name}: {SAID}" in told, command
    assert not list(site.rglob(RESULT_FILE))
    for kind in ([], ["--practice"]):
        packed = ["--subject", "3", "--output", tmp_path / "team.zip", *kind]
        code, told = printed(capsys, "export", root, *packed)
        assert code == BAD_INPUT
        assert SAID in told or "no official runs" in told or "no practice runs" in told
    code, told = printed(capsys, "recover", folder)
    assert code == 0
    assert "its result was made again from journal and recording" in told
    assert (folder / RESULT_FILE).read_bytes() == right
    assert (folder / JOURNAL_FILE).read_bytes() == lines  # which named it already
    assert summary(folder).problem is None
    assert "made again" not in printed(capsys, "recover", folder)[1]


@pytest.mark.parametrize("place", [0.2, 0.4, 0.6, 0.8])
def test_one_flipped_bit_is_found(folder: Path, place: float) -> None:
    path = folder / RESULT_FILE
    data = bytearray(path.read_bytes())
    data[int(place * len(data))] ^= 1
    path.write_bytes(data)
    run = summary(folder)
    assert "result.json" in (run.problem or "")
    assert run.repairable
    assert not run.valid
    assert open_run(folder).out_of_date


def test_a_run_that_an_engine_holds_is_no_exception(folder: Path) -> None:
    change_result(folder, CHANGES["a better time"])
    with Hold(folder / HOLD_FILE):
        assert summary(folder).problem == SAID


def test_opening_the_run_makes_its_result_again(folder: Path) -> None:
    right = (folder / RESULT_FILE).read_bytes()
    change_result(folder, CHANGES["a better time"])
    drive = Drive(folder.parent)
    assert drive.open(folder) is None
    drive.engine.close()
    assert (folder / RESULT_FILE).read_bytes() == right
    assert summary(folder).problem is None


def test_a_result_whose_digest_is_another_in_the_journal_is_made_again(folder: Path) -> None:
    path = folder / JOURNAL_FILE
    path.write_text(re.sub(r'"sha256": "[0-9a-f]', '"sha256": "x', path.read_text()))
    assert summary(folder).problem == SAID
    before = path.read_text().splitlines()
    assert main(["recover", str(folder)]) == 0
    *lines, written = path.read_text().splitlines()
    assert lines == before
    assert json.loads(written)["what"] == "result written"
    assert summary(folder).problem is None


def test_a_kill_before_the_line_of_a_later_result_accuses_nobody(folder: Path) -> None:
    first = (folder / JOURNAL_FILE).read_bytes()
    drive = Drive(folder.parent)
    assert drive.open(folder) is None
    drive.act(Void("the floor was wet"))
    drive.engine.close()
    path = folder / JOURNAL_FILE
    lines = path.read_bytes().splitlines(keepends=True)
    assert json.loads(lines[-1])["what"] == "result written"
    path.write_bytes(b"".join(lines[:-1]))
    run = summary(folder)
    assert (run.problem, run.voided) == (None, True)
    path.write_bytes(first)  # the act is gone, too: that is another journal
    assert summary(folder).problem == SAID


def test_a_result_of_a_version_without_digests_is_believed_as_before(folder: Path) -> None:
    without_digests(folder)
    change_result(folder, CHANGES["a better time"])
    assert summary(folder).problem is None


def test_what_came_of_a_changed_remark_is_not_kept(folder: Path) -> None:
    right = (folder / RESULT_FILE).read_bytes()
    change_result(folder, CHANGES["a remark"])
    assert list(repair_all(folder.parent)) == []
    assert (folder / RESULT_FILE).read_bytes() == right
