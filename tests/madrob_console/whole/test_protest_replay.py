"""A competition morning in a terminal: runs of three teams, played by keys alone."""

from __future__ import annotations

import time
from pathlib import Path

from madrob_console.referee.acts import FileProtest
from tests.madrob_console.engine.test_amended_runs import Desk
from tests.madrob_console.engine_process import (
    READING,
    STARTING,
    Hall,
)


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
