"""Where the time of a run went: its phases, and runs beside each other as bars.

Plain data to SVG, without matplotlib.
"""

from __future__ import annotations

import statistics
from collections.abc import Iterable, Mapping, Sequence
from enum import Enum

from scoring.figures.colours import GREY
from scoring.figures.fluid import TICK_ROOM, axis, bars, drawing
from scoring.protocol import Step

BAR = 26
"""Height of a bar and of what is around it, px."""

_INSET = 4


class TimedPhase(Enum):
    """A part of a run: from a step to the next one that takes time.

    Attributes:
        step: which ends it; None = none, it lasts until the stop.
        words: what it is called.
        colour: of its bars.
    """

    TOUCH = (Step.TOUCH, "start to touch", "#7a8fb0")
    OPEN = (Step.OPEN, "touch to opening", "#d95f02")
    CROSS = (Step.CROSS, "opening to crossed", "#1f4e9e")
    CLOSE = (Step.CLOSE, "crossed to closed", "#2a8a6e")
    LOCK = (Step.LOCK, "closed to locked", "#8a5a9e")
    REST = (None, "no further step", "#bbbbbb")

    def __init__(self, step: Step | None, words: str, colour: str) -> None:
        self.step = step
        self.words = words
        self.colour = colour


PhaseTimes = Mapping[TimedPhase, float]
"""How long each phase was, s; a phase that was not brought to its end is missing."""


def phases_of(
    done: Mapping[Step, float], start: float, stop: float | None
) -> dict[TimedPhase, float]:
    """The phases of a run, in order.

    Args:
        done: when each step was done, as it counts, s.
        start: of the run, s.
        stop: of the run, s; None = not known, then nothing is said of what came last.
    """
    found: dict[TimedPhase, float] = {}
    at = start
    for phase in TimedPhase:
        time = stop if phase.step is None else done.get(phase.step)
        if time is None and phase.step is not None:
            continue  # no step counts after one that does not
        if time is not None and (time > at or phase.step not in (None, Step.LOCK)):
            found[phase] = max(0.0, time - at)
            at = max(at, time)
    return found


def median_phases(runs: Iterable[PhaseTimes]) -> dict[TimedPhase, float]:
    """The median of each phase over the runs that brought it to its end."""
    every = list(runs)
    known = {
        phase: [run[phase] for run in every if phase in run]
        for phase in TimedPhase
        if phase.step is not None
    }
    return {phase: statistics.median(times) for phase, times in known.items() if times}


def phase_bars(runs: Sequence[PhaseTimes], alternative: str) -> str:
    """A bar for each run, below each other, over one time axis, as an SVG element.

    Args:
        runs: from above.
        alternative: what it shows, for those who cannot see it.
    """
    longest = max((sum(run.values()) for run in runs), default=0.0)
    window = (0.0, max(longest, 1e-3))
    parts = []
    for row, run in enumerate(runs):
        at = 0.0
        for phase, time in run.items():
            top, height = BAR * row + _INSET, BAR - 2 * _INSET
            piece = bars([(at, at + time)], window, top, height) if time else ""
            parts.append(f'<g style="fill: {phase.colour}">{piece}</g>')
            at += time
    bottom = BAR * len(runs) + 2
    parts.append(f'<g style="fill: {GREY}; stroke: {GREY}">{axis(window, bottom)}</g>')
    return drawing(parts, bottom + TICK_ROOM, alternative)
