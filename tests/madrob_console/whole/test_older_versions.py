"""What version 0.1.0 wrote is read, judged and shown as it was; what somebody changed is named.

The runs were recorded by that version on its simulated testbed, the referee's acts among them.
Nothing in `version_0_1_0` is ever made anew."""

from __future__ import annotations

import json
import re
import shutil
import tomllib
import zipfile
from pathlib import Path
from typing import Any

import jsonschema
import msgspec
import pytest

from madrob_console.archive import score
from madrob_console.archive.check import Grade, check_run
from madrob_console.archive.folders import (
    JOURNAL_FILE,
    PRACTICE_FOLDER,
    RESULT_FILE,
    RunPath,
    results_folder_of,
)
from madrob_console.archive.history import History, RunSummary
from madrob_console.archive.result_document import ResultDocument, result_schema
from madrob_console.archive.run_journal import find_unfinished
from madrob_console.archive.scored import open_run
from madrob_console.cli.main import main
from madrob_console.cli.output import BAD_INPUT
from madrob_console.cli.repairing import repair_all
from madrob_console.config import load_settings
from madrob_console.referee.acts import Finalise, Void
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

SIMULATED = "SIMULATED: not an official result"
FLAGS = {
    RULED: {SIMULATED, "steps 1, 2, 3, 4, 5, 6 confirmed", "1 incident (fall)"},
    INTERRUPTED: {SIMULATED},
    TIMEOUT: {SIMULATED, "waived: start pose"},
    ABORTED: {SIMULATED},
    EUROBENCH: {SIMULATED},
}
"""Of the runs with a result."""

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


@pytest.mark.parametrize("path", RESULTS, ids=str)
def test_nothing_that_a_result_says_is_lost_or_another_when_it_is_read(path: Path) -> None:
    data = (OLDER / path).read_bytes()
    again = msgspec.json.encode(msgspec.json.decode(data, type=ResultDocument))
    _within(json.loads(data), json.loads(again))
    jsonschema.validate(json.loads(data), result_schema())


@pytest.mark.parametrize("name", FLAGS)
def test_a_recording_still_gives_the_stored_result(older: Path, name: str) -> None:
    checked = check_run(RunPath(older / "results" / name))
    assert checked.differences_of(Grade.DIFFERS) == ()  # other libraries, other last digits
    assert checked.stored_by is None


def test_the_history_says_of_each_run_what_its_result_says(older: Path) -> None:
    for _ in range(2):  # the second time from the index
        runs = {run.folder: run for run in History(older / "results").refresh()}
        assert runs.keys() == {*FLAGS, CUT_OFF}
        for name, flags in FLAGS.items():
            run, result = runs[name], stored(older / "results" / name / RESULT_FILE)
            values = {key: part["value"] for key, part in result["indicators"].items()}
            assert run.problem is None
            assert run.values == {key: v for key, v in values.items() if v is not None}
            assert (run.outcome, run.started) == (result["outcome"], result["start"])
            assert (run.subject, run.team) == (result["subject"], result["team"])
            assert (run.condition, run.ruleset) == (result["condition_number"], result["ruleset"])
            assert (run.issue, run.source) == (result["issue"], result["source"])
            assert run.final == (result["closure"] is not None)
            assert {flag.words for flag in run.flags} == flags
        assert (runs[RULED].issue, runs[RULED].team_word) == (2, "acknowledged")
        assert runs[ABORTED].reason == "the door fell off"
        assert (runs[CUT_OFF].team, runs[CUT_OFF].outcome) == ("Delft", None)
    (found,) = find_unfinished(older / "results")
    assert (found.folder, found.subject, found.team) == (CUT_OFF, 1, "Delft")
    (scored,) = score(older / "results" / CUT_OFF)
    assert scored.result.outcome == "interrupted"
    assert any(signal.samples for signal in scored.result.quality.signals)


def test_a_referee_goes_on_with_an_opened_run(older: Path) -> None:
    drive = Drive(older / "results")
    folder = older / "results" / ABORTED
    before = stored(folder / RESULT_FILE)
    assert drive.open(folder) is None
    drive.act(Finalise(TeamWord.PROTESTED, "A. Nother"))
    drive.wait(1.0)
    drive.engine.close()
    after = stored(folder / RESULT_FILE)
    _within({"referee": "A. Nother", "team_word": "protested"}, after["closure"])
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
    assert "seen in the video" in (older / "results" / RULED / "report.html").read_text()
    export = ["export", "--practice", "--subject", "2", "--output", str(older / "2.zip")]
    assert main([*export, *settings]) == 0
    with zipfile.ZipFile(older / "2.zip") as archive:
        packed = {Path(name).name for name in archive.namelist()}
    assert {RESULT_FILE, JOURNAL_FILE, f"{TIMEOUT}_0.mcap", f"{ABORTED}_0.mcap"} <= packed


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
            for one, other in zip(told, settings, strict=True):
                _within(one, other)
        case _:
            assert told == settings


SAID = "result.json was changed after it was written: `madrob recover` makes it again"
CHANGES: dict[str, tuple[str, str]] = {
    "a better time": (r'("execution_time": {\s*"value": )[-\d.]+', r"\g<1>3.21"),
    "one digit": (r'("passage_time": {\s*"value": )[-\d.]+', r"\g<1>4.0"),
    "another team": ('"team": "', '"team": "X'),
    "another outcome": ('"outcome": "completed"', '"outcome": "timeout"'),
    "no practice": ('"practice": true', '"practice": false'),
    "a remark": (r'"remarks": \[\]', '"remarks": ["fine"]'),
    "a space": ("^", " "),
    "a flag": (r'"flags": \[', '"flags_": ['),
}
"""What is found in a result, as a pattern, and what stands there afterwards."""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    source = final()
    return shutil.copytree(source, tmp_path / "results" / PRACTICE_FOLDER / source.name)


def change_result(folder: Path, change: str) -> None:
    path = folder / RESULT_FILE
    text, count = re.subn(*CHANGES[change], path.read_text(), count=1)
    assert count == 1
    path.write_text(text)


def summary(folder: Path) -> RunSummary:
    (run,) = History(results_folder_of(folder)).refresh()
    return run


@pytest.mark.parametrize("change", CHANGES)
def test_a_changed_result_is_named_by_all_who_list_and_is_made_again(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], change: str
) -> None:
    def printed(*arguments: object) -> tuple[int, str]:
        code = main([*map(str, arguments)])
        told = capsys.readouterr()
        return code, told.out + told.err

    right, lines = (folder / RESULT_FILE).read_bytes(), (folder / JOURNAL_FILE).read_bytes()
    root, site = results_folder_of(folder), tmp_path / "site"
    assert printed("standings", root, "--practice")[0] == 0
    change_result(folder, change)
    for command in (
        ["standings", root, "--practice"],
        ["table", "runs", root],
        ["publish", site, root, "--practice"],
    ):
        code, told = printed(*command)
        assert code == BAD_INPUT, command
        assert f"{folder.name}: {SAID}" in told, command
    assert not list(site.rglob(RESULT_FILE))
    for kind in ([], ["--practice"]):
        code, told = printed("export", root, "--subject=3", "--output", tmp_path / "a.zip", *kind)
        assert code == BAD_INPUT
        assert SAID in told or "no official runs" in told or "no practice runs" in told
    assert list(repair_all(root)) == []
    assert (folder / RESULT_FILE).read_bytes() == right
    assert (folder / JOURNAL_FILE).read_bytes() == lines  # which named it already
    assert summary(folder).problem is None
    assert "made again" not in printed("recover", folder)[1]


@pytest.mark.parametrize("place", [0.2, 0.4, 0.6, 0.8])
def test_one_flipped_bit_is_found(folder: Path, place: float) -> None:
    path = folder / RESULT_FILE
    data = bytearray(path.read_bytes())
    data[int(place * len(data))] ^= 1
    path.write_bytes(data)
    run = summary(folder)
    assert RESULT_FILE in (run.problem or "")
    assert (run.repairable, run.valid) == (True, False)
    assert open_run(folder).out_of_date


def test_opening_the_run_makes_its_result_again(folder: Path) -> None:
    right = (folder / RESULT_FILE).read_bytes()
    change_result(folder, "a better time")
    drive = Drive(folder.parent)
    assert drive.open(folder) is None
    drive.engine.close()
    assert (folder / RESULT_FILE).read_bytes() == right
    assert summary(folder).problem is None


def test_a_kill_before_the_line_of_a_later_result_accuses_nobody(folder: Path) -> None:
    first = (folder / JOURNAL_FILE).read_bytes()
    drive = Drive(folder.parent)
    assert drive.open(folder) is None
    drive.act(Void("the floor was wet"))
    drive.engine.close()
    path = folder / JOURNAL_FILE
    *lines, last = path.read_bytes().splitlines(keepends=True)
    assert json.loads(last)["what"] == "result written"
    path.write_bytes(b"".join(lines))
    assert (summary(folder).problem, summary(folder).voided) == (None, True)
    path.write_bytes(first)  # the act is gone, too: that is another journal
    assert summary(folder).problem == SAID


def test_a_result_of_a_version_without_digests_is_believed_as_before(folder: Path) -> None:
    without_digests(folder)
    change_result(folder, "a better time")
    assert summary(folder).problem is None
