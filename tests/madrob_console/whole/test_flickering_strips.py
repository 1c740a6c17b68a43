"""All passage sensors flicker for a whole run: the engine keeps up, and scoring is no slower."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Iterable
from itertools import cycle
from pathlib import Path
from statistics import median

import pytest

from madrob_console.archive import score
from madrob_console.messages.codec import DEFAULT_MAPPINGS
from madrob_console.referee.acts import ConfirmPose, SetUp, ZeroHandle
from madrob_console.referee.run import Phase
from scoring.protocol import Outcome
from tests.madrob_console.engine.drive import make_setup
from tests.madrob_console.engine.faulty_source import FaultyDrive
from tests.madrob_console.engine.spoilt import Edit, set_value

LASTING = 300.0  # s
SLICES = 24
SCORINGS = 5
SHOWN = 0.1  # s between two states for the screens
STRIPS = [m.topic for m in DEFAULT_MAPPINGS if "/passage/" in m.topic]


NOBODY, SOMEBODY = 3.0, 1.2  # m to what is below


def ranges(*heights: float) -> Edit:
    """These in turn."""
    turn = cycle(heights)
    return lambda message: set_value(message, next(turn))


def begun(results: Path, *heights: float) -> FaultyDrive:
    """A run that goes on, and will end by its timeout."""
    drive = FaultyDrive(results)
    drive.act(SetUp(make_setup(timeout=LASTING, countdown=1.0)))
    drive.wait(2.1)
    drive.act(ZeroHandle(), ConfirmPose())
    drive.begin()
    for topic in STRIPS:
        drive.faulty.fake(topic, ranges(*heights))
    drive.wait_until(lambda: drive.engine.run.phase is Phase.RUNNING)
    return drive


def cost(job: Callable[[], object]) -> float:
    """Processor time that it takes, s."""
    began = time.process_time()
    job()
    return time.process_time() - began


def going_on(drive: FaultyDrive) -> float:
    """Processor time of a slice of a run, s."""
    drive.faulty.handed.clear()

    def shown() -> None:
        for _ in range(round((LASTING - 2.0) / SLICES / SHOWN)):
            drive.wait(SHOWN)
            drive.engine.snapshot()

    return cost(shown)


def ended(drive: FaultyDrive) -> Callable[[], None]:
    """The end of a run; what scores it again, to the same result."""
    result = drive.result()
    assert result.outcome is Outcome.TIMEOUT
    folder = drive.engine.folder
    assert folder is not None
    drive.engine.close()

    def scored() -> None:
        assert next(score(folder)).result == result

    return scored


def ratios(costs: Iterable[tuple[float, float]]) -> list[float]:
    """How many times the first the second of each pair is: side by side, so that others disturb
    both alike."""
    return [second / first for first, second in costs]


@pytest.mark.slow
def test_strips_that_flicker_for_five_minutes_hold_nothing_up(tmp_path: Path) -> None:
    assert len(STRIPS) == 4
    quiet = begun(tmp_path / "quiet", NOBODY)
    flickering = begun(tmp_path / "flickering", SOMEBODY, NOBODY)
    engine = ratios((going_on(quiet), going_on(flickering)) for _ in range(SLICES))
    early, late = median(engine[: SLICES // 2]), median(engine[SLICES // 2 :])
    scorings = ended(quiet), ended(flickering)
    del quiet, flickering
    gc.collect()
    gc.freeze()  # scoring is a process of its own: its collector sees no engine and no tests
    scoring = median(ratios((cost(scorings[0]), cost(scorings[1])) for _ in range(SCORINGS)))
    gc.unfreeze()
    print(
        f"\nall strips flickering for {LASTING:g} s, processor time beside a quiet run: engine "
        f"{early:.2f} times in the first half, {late:.2f} in the second, "
        f"scoring again {scoring:.2f} times"
    )
    assert late <= 1.5 * early
    assert median(engine) <= 2.0
    assert scoring <= 2.0
