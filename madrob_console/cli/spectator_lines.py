"""`madrob watch --json` and `--plain`: a run as lines, for programs, logs and screen readers."""

from __future__ import annotations

import re
import select
import sys
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from msgspec.structs import replace

from madrob_console.common.formatting import time_of_day
from madrob_console.engine.public_state import SpectatorState
from madrob_console.ui.link import EngineLink, OpenClient

if TYPE_CHECKING:
    from madrob_console.engine.snapshot import Snapshot

PERIOD = 0.25
"""Between two looks at the state, s."""

StateLines = Callable[["Snapshot | None", "Snapshot"], Iterator[str]]
"""The lines for a state and the one before, which is None at first."""


def follow_engine(open_client: OpenClient, lines: StateLines) -> int:
    """Print a run's lines, and those of the next engine when this one has ended, until Ctrl+C.

    Raises:
        MadrobError: there is no engine to begin with.
        BrokenPipeError: the reader of the standard output has gone.
    """
    link = EngineLink(open_client, time.monotonic)
    reader = select.poll()
    reader.register(sys.stdout, 0)
    before: Snapshot | None = None
    try:
        link.connect()
        while not reader.poll(1000 * PERIOD):  # it reports nothing but the end of the reader
            snapshot = link.snapshot()
            assert snapshot is not None
            for line in lines(before, snapshot):
                print(line, flush=True)
            before = snapshot
            if snapshot.pulse.gone:
                link.look_for_engine(lambda look: look())
    finally:
        link.close()
    raise BrokenPipeError


def json_lines(before: Snapshot | None, now: Snapshot) -> Iterator[str]:
    """The state in JSON, where more has changed than times and the numbers in faults."""
    state = SpectatorState.of_snapshot(now)
    if before is None or _timeless(SpectatorState.of_snapshot(before)) != _timeless(state):
        yield state.text


def _timeless(state: SpectatorState) -> SpectatorState:
    faults = tuple(map(_numberless, state.faults))
    return replace(state, time=0.0, elapsed=None, remaining=None, faults=faults)


def _numberless(fault: str) -> str:
    return re.sub(r"\d+(\.\d+)?", "", fault)


def plain_lines(before: Snapshot | None, now: Snapshot) -> Iterator[str]:
    """The event log's new lines with their times, and whether the engine is there."""
    if before is None or (before.pulse.gone and not now.pulse.gone):
        yield f"{time_of_day(now.time)} watching {now.label}"
        return
    if before.pulse.stale != now.pulse.stale or before.pulse.gone != now.pulse.gone:
        words = now.pulse.gone or now.pulse.words or "the engine answers again"
        yield f"{time_of_day(now.time)} {words}"
    newest = before.log[-1].number if before.log else -1
    for line in now.log:
        if line.number > newest:
            at = time_of_day(line.time) if line.relative is None else f"{line.relative:+.1f} s"
            yield f"{at} {line.text}"
