"""A referee looks at the instant that a protest is about, in a real terminal."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from madrob_console.referee.acts import FileProtest
from tests.madrob_console.console_process import READING
from tests.madrob_console.engine.test_amended_runs import Desk
from tests.tmux import Tmux

pytestmark = pytest.mark.needs("tmux")

MADROB = [sys.executable, "-m", "madrob_console.cli.main"]
STARTING = 60.0
ASKED = FileProtest("we were through earlier", "Delft", "step 4: cross the threshold", 6.5)


@contextmanager
def window(*named: str, at: str | None = None) -> Iterator[Tmux]:
    """A console in tmux; the engine that these options name, and no other, ends with it."""
    with tempfile.TemporaryDirectory(prefix="madrob-") as own:
        env = {"XDG_RUNTIME_DIR": own, "XDG_CONFIG_HOME": own}
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


def test_at_shows_the_instant_in_question_and_stands_still(tmp_path: Path) -> None:
    run = protested(tmp_path / "results")
    with window("--testbed", "replay", str(run), at="protest") as tmux:
        tmux.wait_for("PAUSED 1x 0:06.50", timeout=STARTING)
        tmux.press("F10")
        assert tmux.wait_exit() == 0


def test_r_replays_the_marked_run_on_the_same_terminal_and_comes_back(tmp_path: Path) -> None:
    results = tmp_path / "results"
    protested(results)
    with window("--testbed", "simulated", "--results", str(results)) as tmux:
        tmux.wait_for("SIMULATED", timeout=STARTING)
        for key, words in (("F3", "F10"), ("h", "1 PROTEST open")):
            time.sleep(READING)
            tmux.press(key)
            tmux.wait_for(words)
        time.sleep(READING)
        tmux.press("R")
        tmux.wait_for("PAUSED 1x 0:06.50", timeout=STARTING)
        time.sleep(READING)
        tmux.press("F10")
        tmux.wait_for("1 PROTEST open")
        shutil.rmtree(results / "practice")
        time.sleep(READING)
        tmux.press("R")
        tmux.wait_for("says why", timeout=STARTING)
        time.sleep(READING)
        tmux.press("F10")
        assert tmux.wait_exit() == 0
