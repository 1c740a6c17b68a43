"""All passage sensors flicker for a whole run: the engine keeps up, and scoring is no slower."""

from __future__ import annotations

import gc
import time
from itertools import cycle
from pathlib import Path
from statistics import median

import pytest

from madrob_console.archive import score
from madrob_console.messages.codec import DEFAULT_MAPPINGS
from madrob_console.referee.acts import ConfirmPose, SetUp, ZeroHandle
from madrob_console.referee.run import Phase
from scoring.protocol import Outcome
from scoring.result import Result
from tests.madrob_console.engine.drive import make_setup
from tests.madrob_console.engine.faulty_source import FaultyDrive
from tests.madrob_console.engine.spoilt import Edit, set_value

LASTING = 300.0  # s
PARTS, SLICES = 5, 5
SCORINGS = 5
SHOWN = 0.1  # s between two states for the screens
STRIPS = [m.topic for m in DEFAULT_MAPPINGS if "/passage/" in m.topic]


NOBODY, SOMEBODY = 3.0, 1.2  # m to what is below


def ranges(*heights: float) -> Edit:
    """These in turn."""
    turn = cycle(heights)
    return lambda message: set_value(message, next(turn))


def lasting_run(results: Path, timeout: float, *heights: float) -> tuple[list[float], Path, Result]:
    """A run that ends by its timeout: processor time of the engine, s a second of each part of it,
    its folder and its result. Of a part it is the median of some: other programs disturb a few."""
    drive = FaultyDrive(results)
    drive.act(SetUp(make_setup(timeout=timeout, countdown=1.0)))
    drive.wait(2.1)
    drive.act(ZeroHandle(), ConfirmPose())
    drive.begin()
    for topic in STRIPS:
        drive.faulty.fake(topic, ranges(*heights))
    drive.wait_until(lambda: drive.engine.run.phase is Phase.RUNNING)
    parts = []
    for _ in range(PARTS):
        drive.faulty.handed.clear()
        slices = []
        for _ in range(SLICES):
            steps, began = round((timeout - 2.0) / PARTS / SLICES / SHOWN), time.process_time()
            for _ in range(steps):
                drive.wait(SHOWN)
                drive.engine.snapshot()
            slices.append((time.process_time() - began) / (steps * SHOWN))
        parts.append(median(slices))
    result = drive.result()
    assert result.outcome is Outcome.TIMEOUT
    folder = drive.engine.folder
    assert folder is not None
    drive.engine.close()
    return parts, folder, result


def scored_again(folder: Path, expected: Result) -> float:
    """Processor time that scoring a run again takes, s: the quickest of some."""
    gc.collect()  # scoring is a process of its own: its collector has no engine to look through
    times = []
    for _ in range(SCORINGS):
        began = time.process_time()
        again = next(score(folder)).result
        times.append(time.process_time() - began)
        assert again == expected
    return min(times)


@pytest.mark.slow
def test_strips_that_flicker_for_five_minutes_hold_nothing_up(tmp_path: Path) -> None:
    assert len(STRIPS) == 4
    quiet, folder, result = lasting_run(tmp_path / "quiet", LASTING / 3, NOBODY)
    scoring_quiet = scored_again(folder, result) / (LASTING / 3)
    parts, folder, result = lasting_run(tmp_path / "flickering", LASTING, SOMEBODY, NOBODY)
    scoring = scored_again(folder, result) / LASTING
    print(
        f"\nall strips flickering for {LASTING:g} s, processor time a second of the run: engine "
        f"{', '.join(f'{1e3 * part:.0f}' for part in parts)} ms ({1e3 * max(quiet):.0f} without), "
        f"scoring again {1e3 * scoring:.1f} ms ({1e3 * scoring_quiet:.1f} without)"
    )
    assert max(parts) <= 1.5 * min(parts)
    assert max(parts) <= 2.0 * max(quiet)
    assert scoring <= 2.0 * scoring_quiet
