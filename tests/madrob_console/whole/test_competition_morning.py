"""A competition morning in a terminal: runs of three teams, played by keys alone."""

from __future__ import annotations

import json
import subprocess
import time
from pathlib import Path
from typing import Any

import pytest

from madrob_console.referee.acts import FileProtest
from madrob_console.referee.records import TeamWord
from tests.madrob_console.engine.test_amended_runs import Desk
from tests.madrob_console.engine_process import (
    MADROB,
    READING,
    ROOT,
    STARTING,
    Console,
    Hall,
    result_of,
)

LONGEST_RUN = 60.0
TEAMS = ("Delft", "門ロボット", "Bots & Co")
WORDS = {TeamWord.ACKNOWLEDGED: "a", TeamWord.ABSENT: "b"}
"""The key of each word of a team."""


def sign(console: Console, word: TeamWord) -> None:
    """Close the result with the team's word.

    The testbed goes by the clock of this machine: where that is busy its stamps jitter, and the
    result is doubted. A referee reads that, and signs it as it is.
    """
    doubted, question = "Sign it all the same?", "What does the team say?"
    console.answer("Enter", "What do you want to do")
    console.answer("f", "Sign the result")
    if console.wait_for(doubted, question, timeout=STARTING) == doubted:
        console.answer("y", question)
    console.answer(WORDS[word], "Note (Enter for none):")
    console.answer("Enter", f"signed by R. Eferee, {word.words}")


def set_up_next(console: Console, subject: int) -> None:
    """From the result before to the confirmed pose of another team."""
    console.answer("F2", "Draft for subject")
    console.send(str(subject))
    console.wait_for(f"Subject {subject}", timeout=STARTING)
    if subject == 3:
        console.press("Tab", "Tab")  # over the run number
        console.answer("Right", "6: push")
    console.answer("F3", "referee (sensor)")
    console.answer("x", f"Run 1 of subject {subject} is set up", TEAMS[subject - 1])
    console.answer("F6", "Done: start pose confirmed", "all passed or waived")


def start(console: Console) -> None:
    console.answer("F5", "RUNNING")


def completed_denied_and_issued_twice(console: Console) -> None:
    console.start_a_run()
    console.wait_for("COMPLETED, valid (all six steps done)", timeout=LONGEST_RUN)
    console.answer("4", "Step 4: ", "Sensors: ")
    console.answer("d", "denied (no reason given)", " 3 steps")
    sign(console, TeamWord.ACKNOWLEDGED)
    console.answer("Enter", "What do you want to do")
    console.answer("u", "Re-issue the final result")
    console.answer("2", "Re-issue the result?")
    console.answer("y", "version 2, not final")
    sign(console, TeamWord.ACKNOWLEDGED)


def aborted(console: Console) -> None:
    set_up_next(console, 2)
    start(console)
    console.answer("F8", "ABORT the run")
    console.answer("1", "Abort now?")
    console.answer("y", "ABORTED: invalid (robot unsafe)")


def given_up(console: Console) -> None:
    set_up_next(console, 3)
    start(console)
    console.wait_for("✓ 1 touch the handle", timeout=LONGEST_RUN)
    console.answer("F9", "DECLARE TIMEOUT")
    console.answer("1", "Timeout now?")
    console.answer("y", "TIMEOUT, valid (the team gives up)")
    sign(console, TeamWord.ABSENT)


def outline(result: dict[str, Any]) -> dict[str, object]:
    """What the morning made of a run."""
    keys = ("team", "source", "condition_number", "run_number", "outcome", "issue")
    rulings = [(ruling["step"], ruling["confirmed"]) for ruling in result["rulings"]]
    word = result["closure"] and result["closure"]["team_word"]
    return {**{key: result[key] for key in keys}, "rulings": rulings, "word": word}


@pytest.mark.slow
def test_a_competition_morning(tmp_path: Path) -> None:
    teams = tmp_path / "teams.csv"
    lines = [f"{subject},{team}\n" for subject, team in enumerate(TEAMS, start=1)]
    teams.write_text("".join(["subject,team\n", *lines]), encoding="utf-8")
    settings = '[competition]\nname = "Morning Cup"\nreferee = "R. Eferee"\n'
    with (
        Hall(results=tmp_path / "results", settings=settings) as hall,
        hall.console("console", f"--teams={teams}") as console,
    ):
        for played in (completed_denied_and_issued_twice, aborted, given_up):
            played(console)
        for key, title in (("h", "2 valid, 1 INVALID"), ("s", "PRACTICE runs: not official")):
            console.answer(key, title, "1-3 of 3")
            for team in TEAMS:  # a long name may be cut
                assert console.shows(f" {team[:3]}"), team
        console.press("F10")
        assert console.wait_exit() == 0
    folders = sorted(hall.results.glob("practice/subject_*"))
    results = [result_of(folder) for folder in folders]
    usual = {"source": "simulated", "condition_number": 1, "run_number": 1, "issue": 1}
    usual |= {"rulings": [], "word": None}
    assert [outline(result) for result in results] == [
        usual
        | {"team": TEAMS[0], "outcome": "completed", "issue": 2}
        | {"rulings": [(4, False)], "word": TeamWord.ACKNOWLEDGED},
        usual | {"team": TEAMS[1], "outcome": "aborted"},
        usual
        | {"team": TEAMS[2], "outcome": "timeout", "condition_number": 6, "word": TeamWord.ABSENT},
    ]
    levels = [result["indicators"]["capability_level"]["value"] for result in results]
    assert (levels[:2], 1 <= levels[2] < 6) == ([3, None], True)
    (before,) = folders[0].glob("result_issue_*.json")
    assert result_of(folders[0])["issue"] == json.loads(before.read_bytes())["issue"] + 1
    command = [*MADROB, "score", "--json", *map(str, folders)]
    scored = json.loads(subprocess.check_output(command, cwd=ROOT, timeout=300))["runs"]
    for run, result in zip(scored, results, strict=True):  # the recordings score to what was shown
        for part in ("outcome", "indicators", "steps", "events", "quality"):
            assert run[part] == result[part], (run["path"], part)


def test_r_replays_the_run_at_the_instant_of_its_protest_and_comes_back(tmp_path: Path) -> None:
    desk = Desk(tmp_path / "results")
    desk.act(FileProtest("we were through earlier", "Delft", "step 4: cross the threshold", 6.5))
    desk.engine.close()
    with Hall(results=tmp_path / "results") as hall, hall.console(lines=36) as console:
        console.wait_for("SIMULATED", timeout=STARTING)
        console.answer("F3", "1 touch the handle")
        console.answer("h", "1 PROTEST open")
        console.answer("Enter", "R Replay")
        console.answer("R", "PAUSED 1x 0:06.50")
        time.sleep(READING)
        console.press("F10")
        console.wait_for("1 PROTEST open", timeout=STARTING)
        console.press("F10")
        assert console.wait_exit() == 0
