"""A whole competition morning in tmux: twelve runs of four teams, played by keys alone."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from madrob_console.referee.acts import FileProtest
from madrob_console.referee.records import TeamWord
from scoring.protocol import Outcome
from tests.madrob_console.console_process import READING
from tests.madrob_console.engine.test_amended_runs import Desk
from tests.tmux import Tmux

ROOT = Path(__file__).parents[3]
MADROB = [sys.executable, "-m", "madrob_console.cli.main"]
SPEED = 4
STARTING = 60.0
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
    run: int
    word: str
    outcome: Outcome = Outcome.COMPLETED
    denied: int | None = None
    issues: int = 1


MORNING = (
    Planned(1, PULL, 1, "a"),
    Planned(2, PULL, 1, "", outcome=Outcome.ABORTED),
    Planned(3, PULL, 1, "a"),
    Planned(4, PULL, 1, "b"),
    Planned(1, PUSH, 1, "b", denied=4),
    Planned(2, PUSH, 1, "a"),
    Planned(3, PUSH, 1, "a", outcome=Outcome.TIMEOUT),
    Planned(4, PUSH, 1, "a"),
    Planned(1, PUSH, 2, "a"),
    Planned(2, PUSH, 2, "a"),
    Planned(3, PUSH, 2, "b"),
    Planned(4, PUSH, 2, "a", issues=2),
)


class Referee:
    """Presses keys, waits for what the screen says to them, and prints a log of both."""

    def __init__(self, window: Tmux) -> None:
        self._window = window
        self._began = time.monotonic()

    def see(self, *texts: str, key: str = "", timeout: float = 20.0) -> None:
        """Wait until all of `texts` are on the screen."""
        for text in texts:
            said = self._window.wait_for(text, timeout=timeout)
            elapsed = time.monotonic() - self._began
            print(f"{elapsed:6.1f} s  {key:<8}  {said}", flush=True)
            key = ""

    def press(self, key: str, *texts: str, timeout: float = 20.0) -> None:
        """Press a key and wait until all of `texts` are on the screen.

        A key that comes before a person could have read what is new is left out, and that is said:
        whoever reads it presses again.
        """
        left_out = " is left out: "
        said = self._window.line_with(left_out)  # of a key before
        self._window.press(key)
        for _ in range(3):
            said = self._window.wait_for(texts[0], timeout, instead=left_out, before=said)
            if left_out not in said:
                break
            time.sleep(READING)
            self._window.press(key)
        self.see(*texts, key=key, timeout=timeout)

    def press_until(self, key: str, text: str) -> None:
        """Press a key that may be refused for a moment, until `text` is on the screen."""
        for _ in range(20):
            self._window.press(key)
            with suppress(AssertionError):
                self.see(text, key=key, timeout=1.0)
                return
        self.see(text, key=key)

    def reads(self, text: str, other: str) -> bool:
        """Wait until one of two texts is on the screen; whether it is the first."""
        return text in self._window.wait_for(text, instead=other)

    def go_on(self, fields: int) -> None:
        """Go to a field further on."""
        self._window.press(*["Tab"] * fields)

    def write(self, text: str, *texts: str) -> None:
        """Type into the field that has the focus."""
        self._window.write(text)
        self.see(*texts, key=repr(text))


@pytest.fixture
def results(tmp_path: Path) -> Path:
    return tmp_path / "results"


@pytest.fixture
def window(tmp_path: Path, results: Path) -> Iterator[Tmux]:
    """The console in tmux; at the end its engine is told to go."""
    settings, teams = tmp_path / "madrob.toml", tmp_path / "teams.csv"
    settings.write_text('[competition]\nname = "Morning Cup"\nreferee = "R. Eferee"\n')
    lines = [f"{subject},{team}\n" for subject, team in TEAMS.items()]
    teams.write_text("".join(["subject,team\n", *lines]), encoding="utf-8")
    console = [
        *MADROB, "console", "--testbed", "simulated", "--speed", str(SPEED),
        "--results", str(results), "--settings", str(settings), "--teams", str(teams),
    ]  # fmt: skip
    # a socket's path has 107 characters at most: pytest's folders are longer
    with tempfile.TemporaryDirectory(prefix="madrob-", ignore_cleanup_errors=True) as folder:
        env = {"XDG_STATE_HOME": folder}
        try:
            with Tmux(console, env=env, cwd=ROOT) as window:
                yield window
        finally:
            stop = [*MADROB, "engine", "stop", "--force", "--results", str(results)]
            subprocess.run(
                stop, env=os.environ | env, cwd=ROOT, capture_output=True, timeout=60, check=False
            )


@pytest.mark.slow
@pytest.mark.needs("tmux")
def test_a_competition_morning(window: Tmux, results: Path) -> None:
    referee = Referee(window)
    referee.see("2 of 9 in the way", timeout=STARTING)
    before: Planned | None = None
    for planned in MORNING:
        set_up(referee, planned, before)
        PLAY[planned.outcome](referee)
        if planned.denied is not None:
            deny(referee, planned.denied)
        if planned.word:
            finalise(referee, planned.word)
        if planned.issues > 1:
            referee.press("Enter", "What do you want to do")
            referee.press("u", "Re-issue the final result")
            referee.press("2", "Re-issue the result?")
            referee.press("y", f"issue {planned.issues}, not final")
            finalise(referee, planned.word)
        before = planned
    look_back(referee, window)
    window.press("F10")
    assert window.wait_exit() == 0
    folders = list(results.glob("practice/subject_*"))
    assert len(folders) == len(MORNING)
    for planned in MORNING:
        check_result(planned, results)
    check_scores(folders)


def set_up(referee: Referee, planned: Planned, before: Planned | None) -> None:
    """From the screen on which the run before ended, up to a confirmed pose."""
    done = f"Run {planned.run} of subject {planned.subject} is set up"
    if before is None:
        referee.press("Enter", done)
        referee.press("F7", "Done: zero the handle", "1 of 9 in the way of a start")
    else:
        referee.press("F2", "Draft for subject")
        referee.write(str(planned.subject), f"Subject {planned.subject}")
        if planned.condition != before.condition:
            referee.go_on(2)  # over the run number
            referee.press("Right", f"{planned.condition}: push")
        referee.press("F3", "ruling (sensors)")
        referee.press("x", done, TEAMS[planned.subject], f"{planned.condition}: pu")
    referee.press("F6", "Done: confirm the start pose", "all passed or waived")


def complete(referee: Referee) -> None:
    """The robot does it."""
    start(referee)
    referee.see("COMPLETED, valid (all six steps done)", timeout=LONGEST_RUN)


def abort(referee: Referee) -> None:
    """The referee interrupts the run."""
    start(referee)
    referee.press("F8", "ABORT the run")
    referee.press("1", "Abort now?")
    referee.press("y", "ABORTED: the run is invalid (robot unsafe)")


def declare_timeout(referee: Referee) -> None:
    """The robot gives up after it has touched the handle."""
    start(referee)
    referee.see("✓ 1 touch the handle", timeout=LONGEST_RUN)
    referee.press("F9", "DECLARE TIMEOUT")
    referee.press("1", "Timeout now?")
    referee.press("y", "TIMEOUT, valid (the team gives up)")


PLAY = {Outcome.COMPLETED: complete, Outcome.ABORTED: abort, Outcome.TIMEOUT: declare_timeout}


def start(referee: Referee) -> None:
    """Through the countdown."""
    referee.press("F5", "COUNTDOWN")
    referee.see("RUNNING", timeout=LONGEST_RUN)


def deny(referee: Referee, step: int) -> None:
    """Overrule the sensors on the results screen; the capability follows."""
    referee.press(str(step), f"Step {step}: ", "Sensors: ")
    referee.press("d", f"Done: step {step} denied (seen by the referee)", f" {step - 1} steps")


def finalise(referee: Referee, word: str) -> None:
    """Close the result with the team's word.

    The testbed goes by the clock of this machine: where that is busy its stamps jitter, and the
    result is doubted. A referee reads that, and signs it as it is.
    """
    referee.press("Enter", "What do you want to do")
    referee.press("f", "Sign the result")
    if referee.reads("Sign it all the same?", "What does the team say?"):
        referee.press("y", "What does the team say?")
    referee.press(word, "Note (Enter for none):")
    referee.press("Enter", f", final: {WORDS[word].told}")


def look_back(referee: Referee, window: Tmux) -> None:
    """Every run is in the history, every team in the standings."""
    runs, standings = len(MORNING), len({(run.subject, run.condition) for run in MORNING})
    referee.press("h", "11 valid, 1 INVALID", f"1-{runs} of {runs}")
    shown = window.screen()
    print(*shown, sep="\n")
    for subject, team in TEAMS.items():
        of_team = sum(run.subject == subject for run in MORNING)
        assert rows_of(team, shown) >= of_team
    referee.press("s", "PRACTICE runs: not official", f"1-{standings} of {standings}")
    shown = window.screen()
    print(*shown, sep="\n")
    assert all(rows_of(team, shown) >= 2 for team in TEAMS.values())


def rows_of(team: str, screen: list[str]) -> int:
    """How many rows name a team; a long name may be cut."""
    return sum(f" {team[:3]}" in row for row in screen)


def check_result(planned: Planned, results: Path) -> None:
    """A run's folder holds what was done."""
    numbers = (planned.subject, planned.condition, planned.run)
    (folder,) = results.glob("practice/subject_{:03d}_cond_{:03d}_run_{:03d}_*".format(*numbers))
    result = read(folder / "result.json")
    assert (result["subject"], result["condition_number"], result["run_number"]) == numbers
    assert (result["team"], result["source"]) == (TEAMS[planned.subject], "simulated")
    assert (result["outcome"], result["issue"]) == (planned.outcome, planned.issues)
    word = result["closure"] and result["closure"]["team_word"]
    assert word == WORDS.get(planned.word)
    earlier = [read(folder / f"result_issue_{n}.json") for n in range(1, planned.issues)]
    assert [document["issue"] for document in earlier] == list(range(1, planned.issues))
    rulings = [(ruling["step"], ruling["confirmed"]) for ruling in result["rulings"]]
    assert rulings == ([] if planned.denied is None else [(planned.denied, False)])
    capability = result["indicators"]["capability_level"]["value"]
    if planned.denied is not None:
        assert capability == planned.denied - 1
    elif planned.outcome is Outcome.COMPLETED:
        assert capability == 6
    elif planned.outcome is Outcome.TIMEOUT:
        assert 1 <= capability < 6
    else:
        assert capability is None


def check_scores(folders: list[Path]) -> None:
    """The recordings score to what the console showed."""
    command = [*MADROB, "score", "--json", *map(str, folders)]
    output = subprocess.check_output(command, cwd=ROOT, timeout=300)
    runs = json.loads(output)["runs"]
    assert len(runs) == len(folders)
    for scored in runs:
        shown = read(Path(scored["path"]) / "result.json")
        for part in ("outcome", "indicators", "steps", "events", "quality"):
            assert scored[part] == shown[part], (scored["path"], part)


def read(path: Path) -> dict[str, Any]:
    document: dict[str, Any] = json.loads(path.read_text())
    return document


ASKED = FileProtest("we were through earlier", "Delft", "step 4: cross the threshold", 6.5)


@contextmanager
def replay_window(*named: str, at: str | None = None) -> Iterator[Tmux]:
    """A console in tmux; the engine that these options name, and no other, ends with it."""
    with tempfile.TemporaryDirectory(prefix="madrob-") as own:
        env = {"XDG_STATE_HOME": own, "XDG_CONFIG_HOME": own}
        words = ["console", *named, *([] if at is None else ["--at", at])]
        try:
            with Tmux([*MADROB, *words], columns=120, lines=36, env=env) as tmux:
                yield tmux
        finally:
            stop = [*MADROB, "engine", "stop", "--force", *named]
            subprocess.run(stop, env=os.environ | env, check=False, capture_output=True)


def protested(results: Path) -> Path:
    """A results folder with a run against which a protest is open; the run's folder."""
    desk = Desk(results)
    desk.act(ASKED)
    desk.engine.close()
    return desk.run_folder


@pytest.mark.needs("tmux")
def test_at_shows_the_instant_in_question_and_stands_still(tmp_path: Path) -> None:
    run = protested(tmp_path / "results")
    with replay_window("--testbed", "replay", str(run), at="protest") as tmux:
        tmux.wait_for("PAUSED 1x 0:06.50", timeout=STARTING)
        tmux.press("F10")
        assert tmux.wait_exit() == 0


@pytest.mark.needs("tmux")
def test_r_replays_the_marked_run_on_the_same_terminal_and_comes_back(tmp_path: Path) -> None:
    results = tmp_path / "results"
    protested(results)
    with replay_window("--testbed", "simulated", "--results", str(results)) as tmux:
        tmux.wait_for("SIMULATED", timeout=STARTING)
        for key, words in (("F3", "F10"), ("h", "1 PROTEST open")):
            time.sleep(READING)
            tmux.press(key)
            tmux.wait_for(words)
        time.sleep(READING)
        for key in ("Enter", "R"):
            tmux.press(key)
            time.sleep(READING)
        tmux.wait_for("PAUSED 1x 0:06.50", timeout=STARTING)
        time.sleep(READING)
        tmux.press("F10")
        tmux.wait_for("1 PROTEST open")
        shutil.rmtree(results / "practice")
        time.sleep(READING)
        for key in ("Enter", "R"):
            tmux.press(key)
            time.sleep(READING)
        tmux.wait_for("says why", timeout=STARTING)
        time.sleep(READING)
        tmux.press("F10")
        assert tmux.wait_exit() == 0
