"""How long after the post-roll of a run its result is on disk."""

from __future__ import annotations

import sys
import time
from contextlib import closing
from pathlib import Path
from tempfile import TemporaryDirectory

from madrob_console.archive.folders import RESULT_FILE
from madrob_console.engine.runtime.scoring_process import ScoringProcess
from madrob_console.engine.runtime.supervisor import Supervisor
from madrob_console.referee.acts import DeclareTimeout
from scoring.protocol import POST_ROLL
from tests.benchmarks import bare_filter
from tests.benchmarks.commands import duration_of
from tests.benchmarks.report import Figure
from tests.benchmarks.swinging_door import SwingingDrive
from tests.madrob_console.engine.drive import STEP, make_setup

DURATIONS = {20: 0.2, 600: 1.0}
"""s of a run, and the goal."""
MOST = 3


def results(repeats: int) -> list[Figure]:
    """The scoring process works for an engine in virtual time."""
    scorer, figures = ScoringProcess(), []
    with closing(Supervisor(scorer)):
        with TemporaryDirectory() as folder:
            _until_result(Path(folder), min(DURATIONS), scorer)  # once before: libraries are loaded
        for duration, goal in DURATIONS.items():
            ours, bare = [], []
            for _ in range(min(repeats, MOST)):
                with TemporaryDirectory() as folder:
                    took, run = _until_result(Path(folder), duration, scorer)
                    program = (sys.executable, "-m", bare_filter.__name__, str(run))
                    ours.append(took)
                    bare.append(duration_of(program))
            name = f"result of a run of {duration} s"
            figures.append(Figure(name, "s", ours, "load, filter, write", bare, goal))
    return figures


def _until_result(folder: Path, duration: float, scorer: ScoringProcess) -> tuple[float, Path]:
    drive = SwingingDrive(folder, scorer=scorer)
    with closing(drive.engine):
        drive.start(make_setup(timeout=2 * duration))
        drive.wait(duration)
        drive.act(DeclareTimeout("gave up"))
        drive.wait(POST_ROLL - 2 * STEP)
        result, began = drive.folder / RESULT_FILE, time.perf_counter()
        while not result.exists():
            drive.engine.step(STEP)
            scorer.wait_until_idle(STEP)
        return time.perf_counter() - began, drive.folder
