"""Keys and copies through a real tmux: at the speed of a script and of hands."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.madrob_console.ui.fake_engine import FOLDER
from tests.tmux import Tmux

pytestmark = [pytest.mark.machine, pytest.mark.needs("tmux")]
ROOT = Path(__file__).parents[3]
STARTING = 30.0
MACHINE, HUMAN = 0.0, 0.5
"""Between two keys, s."""


@pytest.fixture
def ends(tmp_path: Path) -> Path:
    """The file by which the run ends."""
    return tmp_path / "ends"


PROGRAM = [sys.executable, "-m", "tests.madrob_console.ui.moving_engine", "--running"]


@pytest.fixture
def tmux(ends: Path) -> Iterator[Tmux]:
    with Tmux([*PROGRAM, str(ends)], cwd=ROOT) as tmux:
        tmux.wait_for("RUNNING", timeout=STARTING)
        yield tmux


def type_keys(tmux: Tmux, keys: str, gap: float) -> None:
    """By tmux's names; without a gap all at once."""
    if not gap:
        tmux.press(*keys.split())
        return
    for key in keys.split():
        tmux.press(key)
        time.sleep(gap)


@pytest.mark.parametrize("gap", [MACHINE, HUMAN])
def test_answers_to_an_abort_rule_on_nothing_when_the_run_is_over(
    tmux: Tmux, ends: Path, gap: float
) -> None:
    tmux.press("F8")
    tmux.wait_for("ABORT the run")
    ends.touch()
    tmux.wait_for("NOT POSSIBLE ANY MORE: the run has stopped")
    type_keys(tmux, "1 2 1", gap)
    tmux.press("Enter")
    tmux.wait_for("COMPLETED")
    assert "ruling" not in "\n".join(tmux.screen())


@pytest.mark.parametrize("gap", [MACHINE, HUMAN])
def test_a_refused_timeout_and_what_would_have_answered_it_rule_on_nothing(
    tmux: Tmux, ends: Path, gap: float
) -> None:
    ends.touch()
    tmux.wait_for("The result is written")
    time.sleep(HUMAN)
    type_keys(tmux, "F9 2 Enter F9 2 y", gap)
    tmux.wait_for("is left out: F9 was refused: the run has stopped")
    screen = "\n".join(tmux.screen())
    assert "Step 2" not in screen
    assert "Copy" not in screen.splitlines()[-8]


@pytest.mark.parametrize("gap", [MACHINE, HUMAN])
def test_an_abort_is_answered_at_any_speed(tmux: Tmux, gap: float) -> None:
    type_keys(tmux, "F8 1 y", gap)
    tmux.wait_for("ABORTED")


def test_y_copies_into_the_tmux_of_this_machine(tmux: Tmux, ends: Path) -> None:
    ends.touch()
    tmux.wait_for("The result is written")
    time.sleep(HUMAN)
    tmux.press("y")
    tmux.wait_for("the run's folder")
    tmux.press("p")
    tmux.wait_for("Copied, also into tmux's buffer: the run's folder")
    assert tmux.buffer() == FOLDER


def test_y_copies_into_a_tmux_at_the_other_end_of_ssh_that_lets_it(ends: Path) -> None:
    ends.touch()
    with Tmux(["env", "-u", "TMUX", *PROGRAM, str(ends)], cwd=ROOT) as tmux:
        tmux.set_option("set-clipboard", "on")
        tmux.wait_for("The result is written", timeout=STARTING)
        time.sleep(HUMAN)
        tmux.press("y")
        tmux.wait_for("the run's folder")
        tmux.press("p")
        tmux.wait_for("Copied, if tmux has `set-clipboard on`")
        assert tmux.buffer() == FOLDER
