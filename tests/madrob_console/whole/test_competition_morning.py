"""A whole competition morning in a terminal: eight runs of four teams, played by keys alone."""

from __future__ import annotations

import json
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path

import pytest

from madrob_console.referee.acts import FileProtest
from madrob_console.referee.records import TeamWord
from scoring.protocol import Outcome
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

TEAMS = {1: "Delft", 2: "門ロボット", 3: "Bots & Co", 4: "Zürich"}
PULL, PUSH = 1, 6
"""Conditions: no force from CCW to CW, the door opens towards CCW or towards CW."""
WORDS = {"a": TeamWord.ACKNOWLEDGED, "b": TeamWord.ABSENT}


@dataclass(frozen=True, slots=True)
class Planned:
    """One run of the morning.

    Attributes:
        word: key of the team's word; empty = the result is left as it is.
        denied: the step that the referee denies afterwards.
        issues: how often the result is finalised.
    """

    subject: int
    condition: int
    word: str
    outcome: Outcome = Outcome.COMPLETED
    denied: int | None = None
    issues: int = 1


MORNING = (
    Planned(1, PULL, "a"),
    Planned(2, PULL, "", outcome=Outcome.ABORTED),
    Planned(3, PULL, "a"),
    Planned(4, PULL, "b"),
    Planned(1, PUSH, "b", denied=4),
    Planned(2, PUSH, "a"),
    Planned(3, PUSH, "a", outcome=Outcome.TIMEOUT),
    Planned(4, PUSH, "a", issues=2),
)


class Referee:
    """Presses keys and waits for what the screen says to them."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self.press = console.answer

    def see(self, text: str, timeout: float = STARTING) -> None:
        """Wait until a text is on the screen."""
        self._console.wait_for(text, timeout=timeout)

    def set_up(self, planned: Planned, before: Planned | None) -> None:
        """From the screen on which the run before ended, up to a confirmed pose."""
        done = f"Run 1 of subject {planned.subject} is set up"
        if before is None:
            self.press("Enter", done)
            self.press("F7", "Done: handle zeroed", "1 of 9 checks fail")
        else:
            self.press("F2", "Draft for subject")
            self._console.send(str(planned.subject))
            self.see(f"Subject {planned.subject}")
            if planned.condition != before.condition:
                self._console.press("Tab", "Tab")  # over the run number
                self.press("Right", f"{planned.condition}: push")
            self.press("F3", "referee (sensor)")
            self.press("x", done, TEAMS[planned.subject], f"{planned.condition}: pu")
        self.press("F6", "Done: start pose confirmed", "all passed or waived")

    def play(self, outcome: Outcome) -> None:
        """Through the countdown to the end of the run."""
        self.press("F5", "COUNTDOWN")
        self.see("RUNNING")
        match outcome:
            case Outcome.ABORTED:
                self.press("F8", "ABORT the run")
                self.press("1", "Abort now?")
                self.press("y", "ABORTED: invalid (robot unsafe)")
            case Outcome.TIMEOUT:
                self.see("✓ 1 touch the handle", timeout=LONGEST_RUN)
                self.press("F9", "DECLARE TIMEOUT")
                self.press("1", "Timeout now?")
                self.press("y", "TIMEOUT, valid (the team gives up)")
            case _:
                self.see("COMPLETED, valid (all six steps done)", timeout=LONGEST_RUN)

    def finalise(self, word: str) -> None:
        """Close the result with the team's word.

        The testbed goes by the clock of this machine: where that is busy its stamps jitter, and the
        result is doubted. A referee reads that, and signs it as it is.
        """
        doubted, word_asked = "Sign it all the same?", "What does the team say?"
        self.press("Enter", "What do you want to do")
        self.press("f", "Sign the result")
        if self._console.wait_for(doubted, word_asked) == doubted:
            self.press("y", word_asked)
        self.press(word, "Note (Enter for none):")
        self.press("Enter", f"signed by R. Eferee, {WORDS[word].words}")

    def decide(self, planned: Planned) -> None:
        """All that follows a run."""
        if planned.denied is not None:  # the capability follows
            self.press(str(planned.denied), f"Step {planned.denied}: ", "Sensors: ")
            self.press("d", "denied (no reason given)", f" {planned.denied - 1} steps")
        if planned.word:
            self.finalise(planned.word)
        for issue in range(2, planned.issues + 1):
            self.press("Enter", "What do you want to do")
            self.press("u", "Re-issue the final result")
            self.press("2", "Re-issue the result?")
            self.press("y", f"version {issue}, not final")
            self.finalise(planned.word)

    def look_back(self) -> None:
        """Every run is in the history, every team in the standings."""
        for key, title in (("h", "7 valid, 1 INVALID"), ("s", "PRACTICE runs: not official")):
            self.press(key, title, f"1-{len(MORNING)} of {len(MORNING)}")
            shown = self._console.screen()
            for team in TEAMS.values():  # a long name may be cut
                assert sum(f" {team[:3]}" in row for row in shown) >= 2


def check_result(planned: Planned, results: Path) -> None:
    """A run's folder holds what was done."""
    numbers = (planned.subject, planned.condition, 1)
    (folder,) = results.glob("practice/subject_{:03d}_cond_{:03d}_run_{:03d}_*".format(*numbers))
    result = result_of(folder)
    assert (result["subject"], result["condition_number"], result["run_number"]) == numbers
    assert (result["team"], result["source"]) == (TEAMS[planned.subject], "simulated")
    assert (result["outcome"], result["issue"]) == (planned.outcome, planned.issues)
    word = result["closure"] and result["closure"]["team_word"]
    assert word == WORDS.get(planned.word)
    issues = [
        json.loads(p.read_bytes())["issue"] for p in sorted(folder.glob("result_issue_*.json"))
    ]
    assert issues == list(range(1, planned.issues))
    rulings = [(ruling["step"], ruling["confirmed"]) for ruling in result["rulings"]]
    assert rulings == ([] if planned.denied is None else [(planned.denied, False)])
    capability = result["indicators"]["capability_level"]["value"]
    match planned.outcome:
        case Outcome.COMPLETED:
            assert capability == (planned.denied or 7) - 1
        case Outcome.TIMEOUT:
            assert 1 <= capability < 6
        case _:
            assert capability is None


@pytest.mark.slow
def test_a_competition_morning(tmp_path: Path) -> None:
    teams = tmp_path / "teams.csv"
    lines = [f"{subject},{team}\n" for subject, team in TEAMS.items()]
    teams.write_text("".join(["subject,team\n", *lines]), encoding="utf-8")
    settings = '[competition]\nname = "Morning Cup"\nreferee = "R. Eferee"\n'
    with (
        Hall(results=tmp_path / "results", settings=settings) as hall,
        hall.console("console", f"--teams={teams}") as console,
    ):
        referee = Referee(console)
        referee.see("2 of 9 checks fail")
        before: Planned | None = None
        for planned in MORNING:
            referee.set_up(planned, before)
            referee.play(planned.outcome)
            referee.decide(planned)
            before = planned
        referee.look_back()
        console.press("F10")
        assert console.wait_exit() == 0
    for planned in MORNING:
        check_result(planned, hall.results)
    folders = list(map(str, hall.results.glob("practice/subject_*")))
    command = [*MADROB, "score", "--json", *folders]
    scored = json.loads(subprocess.check_output(command, cwd=ROOT, timeout=300))["runs"]
    assert len(scored) == len(MORNING)
    for run in scored:  # the recordings score to what the console showed
        shown = result_of(Path(run["path"]))
        for part in ("outcome", "indicators", "steps", "events", "quality"):
            assert run[part] == shown[part], (run["path"], part)


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
