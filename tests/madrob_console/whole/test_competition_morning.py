"""A whole competition morning in tmux: eight runs of four teams, played by keys alone."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from madrob_console.referee.acts import FileProtest
from madrob_console.referee.records import TeamWord
from scoring.protocol import Outcome
from tests.madrob_console.console_process import READING
from tests.madrob_console.engine.test_amended_runs import Desk
from tests.madrob_console.engine_process import ROOT, STARTING
from tests.tmux import Tmux

MADROB = [sys.executable, "-m", "madrob_console.cli.main"]
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


@contextmanager
def console(*named: str, settings: tuple[str, ...] = (), lines: int = 24) -> Iterator[Tmux]:
    """A console in tmux; the engine that these options name, and no other, ends with it."""
    # a socket's path has 107 characters at most: pytest's folders are longer
    with tempfile.TemporaryDirectory(prefix="madrob-", ignore_cleanup_errors=True) as folder:
        env = {"XDG_STATE_HOME": folder, "XDG_CONFIG_HOME": folder}
        try:
            command = [*MADROB, "console", *named, *settings]
            with Tmux(command, lines=lines, env=env, cwd=ROOT) as window:
                yield window
        finally:
            stop = [*MADROB, "engine", "stop", "--force", *named]
            subprocess.run(
                stop, env=os.environ | env, cwd=ROOT, capture_output=True, timeout=60, check=False
            )


class Referee:
    """Presses keys, waits for what the screen says to them, and prints a log of both."""

    def __init__(self, window: Tmux) -> None:
        self._window = window
        self._began = time.monotonic()

    def see(self, *texts: str, key: str = "", timeout: float = STARTING) -> None:
        """Wait until all of `texts` are on the screen."""
        for text in texts:
            said = self._window.wait_for(text, timeout=timeout)
            print(f"{time.monotonic() - self._began:6.1f} s  {key:<8}  {said}", flush=True)

    def press(self, key: str, *texts: str) -> None:
        """Press a key and wait until all of `texts` are on the screen.

        A key that comes before a person could have read what is new is left out, and that is said:
        whoever reads it presses again.
        """
        left_out = " is left out: "
        said = self._window.line_with(left_out)  # of a key before
        self._window.press(key)
        for _ in range(3):
            said = self._window.wait_for(texts[0], STARTING, instead=left_out, before=said)
            if left_out not in said:
                break
            time.sleep(READING)
            self._window.press(key)
        self.see(*texts, key=key)

    def set_up(self, planned: Planned, before: Planned | None) -> None:
        """From the screen on which the run before ended, up to a confirmed pose."""
        done = f"Run 1 of subject {planned.subject} is set up"
        if before is None:
            self.press("Enter", done)
            self.press("F7", "Done: handle zeroed", "1 of 9 checks fail")
        else:
            self.press("F2", "Draft for subject")
            self._window.write(str(planned.subject))
            self.see(f"Subject {planned.subject}")
            if planned.condition != before.condition:
                self._window.press("Tab", "Tab")  # over the run number
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
        if doubted in self._window.wait_for(doubted, instead=word_asked):
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
            shown = self._window.screen()
            print(*shown, sep="\n")
            for team in TEAMS.values():  # a long name may be cut
                assert sum(f" {team[:3]}" in row for row in shown) >= 2


def read(path: Path) -> dict[str, Any]:
    document: dict[str, Any] = json.loads(path.read_text())
    return document


def check_result(planned: Planned, results: Path) -> None:
    """A run's folder holds what was done."""
    numbers = (planned.subject, planned.condition, 1)
    (folder,) = results.glob("practice/subject_{:03d}_cond_{:03d}_run_{:03d}_*".format(*numbers))
    result = read(folder / "result.json")
    assert (result["subject"], result["condition_number"], result["run_number"]) == numbers
    assert (result["team"], result["source"]) == (TEAMS[planned.subject], "simulated")
    assert (result["outcome"], result["issue"]) == (planned.outcome, planned.issues)
    word = result["closure"] and result["closure"]["team_word"]
    assert word == WORDS.get(planned.word)
    issues = [read(path)["issue"] for path in sorted(folder.glob("result_issue_*.json"))]
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
@pytest.mark.needs("tmux")
def test_a_competition_morning(tmp_path: Path) -> None:
    results, settings, teams = (tmp_path / name for name in ("results", "madrob.toml", "teams.csv"))
    settings.write_text('[competition]\nname = "Morning Cup"\nreferee = "R. Eferee"\n')
    lines = [f"{subject},{team}\n" for subject, team in TEAMS.items()]
    teams.write_text("".join(["subject,team\n", *lines]), encoding="utf-8")
    named = ("--testbed", "simulated", "--results", str(results))
    options = ("--speed=4", f"--settings={settings}", f"--teams={teams}")
    with console(*named, settings=options) as window:
        referee = Referee(window)
        referee.see("2 of 9 checks fail")
        before: Planned | None = None
        for planned in MORNING:
            referee.set_up(planned, before)
            referee.play(planned.outcome)
            referee.decide(planned)
            before = planned
        referee.look_back()
        window.press("F10")
        assert window.wait_exit() == 0
    for planned in MORNING:
        check_result(planned, results)
    folders = list(map(str, results.glob("practice/subject_*")))
    command = [*MADROB, "score", "--json", *folders]
    scored = json.loads(subprocess.check_output(command, cwd=ROOT, timeout=300))["runs"]
    assert len(scored) == len(MORNING)
    for run in scored:  # the recordings score to what the console showed
        shown = read(Path(run["path"]) / "result.json")
        for part in ("outcome", "indicators", "steps", "events", "quality"):
            assert run[part] == shown[part], (run["path"], part)


@pytest.mark.needs("tmux")
def test_r_replays_the_run_at_the_instant_of_its_protest_and_comes_back(tmp_path: Path) -> None:
    desk = Desk(tmp_path / "results")
    desk.act(FileProtest("we were through earlier", "Delft", "step 4: cross the threshold", 6.5))
    desk.engine.close()
    named = ("--testbed", "simulated", "--results", str(tmp_path / "results"))
    with console(*named, lines=36) as window:
        referee = Referee(window)
        referee.see("SIMULATED")
        referee.press("F3", "1 touch the handle")
        referee.press("h", "1 PROTEST open")
        referee.press("Enter", "R Replay")
        referee.press("R", "PAUSED 1x 0:06.50")
        time.sleep(READING)
        window.press("F10")
        referee.see("1 PROTEST open")
        window.press("F10")
        assert window.wait_exit() == 0
