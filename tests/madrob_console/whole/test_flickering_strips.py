"""All passage sensors flicker for a whole run: the engine keeps up, and scoring is no slower."""

from __future__ import annotations

import time
from itertools import cycle
from pathlib import Path

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
PARTS = 5
SHOWN = 0.1  # s between two states for the screens
STRIPS = [m.topic for m in DEFAULT_MAPPINGS if "/passage/" in m.topic]


def flickering() -> Edit:
    """Somebody is there in each second message."""
    heights = cycle([1.2, 3.0])
    return lambda message: set_value(message, next(heights))


@pytest.mark.slow
def test_strips_that_flicker_for_five_minutes_hold_nothing_up(tmp_path: Path) -> None:
    assert len(STRIPS) == 4
    drive = FaultyDrive(tmp_path)
    drive.act(SetUp(make_setup(timeout=LASTING, countdown=1.0)))
    drive.wait(2.1)
    drive.act(ZeroHandle(), ConfirmPose())
    drive.begin()
    for topic in STRIPS:
        drive.faulty.fake(topic, flickering())
    drive.wait_until(lambda: drive.engine.run.phase is Phase.RUNNING)
    parts = []
    for _ in range(PARTS):
        drive.faulty.handed.clear()
        began = time.process_time()
        for _ in range(round((LASTING - 2.0) / PARTS / SHOWN)):
            drive.wait(SHOWN)
            drive.engine.snapshot()
        parts.append(time.process_time() - began)
    result = drive.result()
    assert result.outcome is Outcome.TIMEOUT
    folder = drive.engine.folder
    assert folder is not None
    drive.engine.close()
    began = time.process_time()
    again = next(score(folder)).result
    scoring = time.process_time() - began
    print(
        f"\nall strips flickering for {LASTING:g} s: the engine took "
        f"{', '.join(f'{part:.2f}' for part in parts)} s for each {LASTING / PARTS:g} s; scoring "
        f"the bag again {scoring:.2f} s"
    )
    assert again == result
    assert max(parts) <= 1.5 * min(parts)
    assert sum(parts) <= 0.5 * LASTING
    assert scoring <= LASTING / 100
