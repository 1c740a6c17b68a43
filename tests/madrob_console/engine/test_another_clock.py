"""Stamps that are not of the console's clock: named with what to do, and never waved through."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle
from pathlib import Path

import pytest

from madrob_console.clock import NS
from madrob_console.referee.acts import Start, Waive
from madrob_console.referee.on_record import CheckName
from tests.madrob_console.engine.faulty_source import FaultyDrive
from tests.madrob_console.engine.spoilt import HANDLE, Edit, Fault, shift_stamp


@pytest.mark.parametrize(
    ("off", "clock", "words"),
    [
        (-1.7e9, None, "stamps are not of this clock (simulated time?): set it, or use"),
        (11.0, 2000.0, "stamps are not of this clock (simulated time?): set it, or use"),
        (-1.7e9, -1.7e9, "stamps are of simulated time: end the engine, start with"),
        (0.3, 0.3, "stamps are of simulated time: end the engine, start with"),
        (1e8, 0.0, "stamps are not of /clock: stamp by it, or start without"),
    ],
)
def test_stamps_of_another_clock_are_named_first_with_what_to_do_and_cannot_be_waived(
    off: float, clock: float | None, words: str, tmp_path: Path
) -> None:
    drive = FaultyDrive(tmp_path)
    drive.faulty.simulated_time = clock
    shift_stamps(drive, [off])
    drive.set_up()
    wanted = f"{words} --use-sim-time"
    assert drive.check(CheckName.CLOCK) == f"failed: {wanted}"
    assert drive.engine.perform(Start()) == f"{CheckName.CLOCK}: {wanted} (and 1 more)"
    refused = drive.engine.perform(Waive(CheckName.CLOCK, "looks fine"))
    assert refused == f"the check 'clock skew' cannot be waived: {wanted}"
    shift_stamps(drive, [0.0])
    drive.wait(2.1)
    drive.act(Start())


def test_a_wild_stamp_now_and_then_is_of_no_other_clock(tmp_path: Path) -> None:
    drive = FaultyDrive(tmp_path)
    shift_stamps(drive, [0.0, 1000.0])
    drive.faulty.spoil(HANDLE, Fault.ZERO_STAMPS)
    drive.set_up()
    assert drive.check(CheckName.CLOCK).startswith("failed: stamps differ by 100")
    drive.act(Waive(CheckName.CLOCK, "known testbed fault"))


def shift_stamps(drive: FaultyDrive, off: Sequence[float]) -> None:
    """From now on the stamps of each topic are off by these times in turn, s."""

    def shifting() -> Edit:
        shifts = cycle([round(each * NS) for each in off])
        return lambda content: shift_stamp(content, next(shifts))

    for topic in drive.topics():
        drive.faulty.fake(topic, shifting())
