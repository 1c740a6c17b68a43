"""The indicators: a value with its uncertainty and its unit, or the reason why there is none."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, NamedTuple

from madrob_console.referee.flags import common_reason
from madrob_console.standings.tally import aggregate_of
from madrob_console.ui.cells.lines import Line, Span, Tone, View, line, paragraph
from madrob_console.ui.look.words import fitted
from scoring.indicator_table import IndicatorName
from scoring.result import (
    DOUBTED,
    difference_text,
    distinguishable,
    uncertainty_text,
    value_text,
)

if TYPE_CHECKING:
    from madrob_console.archive.history import RunSummary
    from madrob_console.engine.shown.snapshot import Snapshot
    from madrob_console.standings.tally import Aggregate
    from scoring.result import Indicator, Result

_NAME = 28
_SHORT_NAME = 21
_VALUE = 10
_SHORT_VALUE = 8
_SPREAD = 11
"""Cells of an uncertainty with the gaps around it."""
_ROOMY = 75
_WITH_WORDS = 62
"""Cells with which a difference says whether it is better."""
_IN_POWERS = 1e3
"""A larger difference has no room otherwise."""

ALIKE = "="
"""A difference within the uncertainty."""


class _Room(NamedTuple):
    """Cells: of a row, of a name, of a value, of an uncertainty; with names and numbers short."""

    row: int
    name: int
    value: int
    spread: int

    @property
    def compared(self) -> int:
        """As many as a row without uncertainties would have: what is compared does not shrink."""
        used = self.name + self.value + self.spread
        return self.row - used + _NAME + _VALUE


class IndicatorTable(View):
    """One row each; a long reason takes more.

    Attributes:
        earlier: completed runs of the same team in the same condition, to compare with.
    """

    earlier: Sequence[RunSummary] = ()

    def draw(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        """A header and the indicators; below them what the signs mean that are among them."""
        if snapshot.result is None:
            return ()
        found = snapshot.result.indicators
        if reason := common_reason(found):
            begin = line(Span("indicators  ", Tone.STRONG))
            return [
                *paragraph(f"none: {reason}", width, Tone.WARN, begin),
                *_drift(snapshot.result, snapshot.handle.touch_force),
            ]
        roomy = width >= _ROOMY
        comparable = snapshot.run.comparable
        earlier = self.earlier if comparable else ()
        count = len(earlier)
        against = f"against mean of {count} earlier" if count else "no earlier run to compare"
        if not comparable:
            against = "compared with no other run"
        delay = "* with the manual start's delay"
        head = fitted(f"indicators  {delay}", _NAME + 18) if roomy else fitted("indicators", _NAME)
        lines = [line(Span(head[:12], Tone.STRONG), Span(f"{head[12:]}{against}", Tone.DIM))]
        room = _room(found.values(), width)
        signs = set()
        for name, indicator in found.items():
            rows, alike = _rows(name, indicator, aggregate_of(earlier, name), count, room)
            lines += rows
            if name is IndicatorName.ROUGHNESS_OF_DOOR_ACTUATION:
                lines += _drift(snapshot.result, snapshot.handle.touch_force)
            signs |= {ALIKE} if alike else set()
            signs |= {DOUBTED} if indicator.doubts else set()
        told = ([] if roomy else [delay]) + [text for sign, text in _LEGEND if sign in signs]
        return [*lines, *(row for text in told for row in paragraph(text, width, Tone.DIM))]


_LEGEND = (
    (DOUBTED, f"{DOUBTED} doubted, see below"),
    (ALIKE, f"{ALIKE} differs by less than the uncertainties: not distinguishable"),
)


def _room(found: Iterable[Indicator], width: int) -> _Room:
    """Names and values are shortened where the uncertainties leave no room for all."""
    spread = _SPREAD if any(uncertainty_text(one.uncertainty) for one in found) else 0
    if not spread or width >= _ROOMY + spread:
        return _Room(width, _NAME, _VALUE, spread)
    return _Room(width, _SHORT_NAME, _SHORT_VALUE, spread)


def _rows(
    name: IndicatorName, indicator: Indicator, earlier: Aggregate | None, count: int, room: _Room
) -> tuple[list[Line], bool]:
    """The rows of an indicator, and whether it differs from the mean by no more than is known."""
    words = name.words if room.name == _NAME else name.words.partition(" of ")[0]
    title = words + (" *" if name.spec.with_the_start else "")
    head = line(f"{title:<{room.name}}")
    if indicator.value is None:
        return paragraph(indicator.text, room.row, Tone.WARN, line(*head, " ")), False
    value = value_text(indicator.value, indicator.uncertainty)
    spread = uncertainty_text(indicator.uncertainty)
    behind = compared(name, indicator, earlier, count, room.compared)
    row = line(
        *head,
        Span(f"{value:>{room.value}}", Tone.STRONG),
        Span(indicator.sign or " ", Tone.WARN),
        Span(f"{f' {spread}'[: room.spread]:<{room.spread}}{indicator.unit:<7}", Tone.DIM),
        *behind,
    )
    return [row], any(span.text.strip() == ALIKE for span in behind)


def _drift(result: Result, touch_force: float) -> list[Line]:
    """How far the handle came to rest from its zero, where that is too far (section 11)."""
    rest = result.rest
    if rest is None or rest.drift is None or not rest.drifted(touch_force):
        return []
    head = line(Span(f"{'  at rest after, from zero':<{_NAME}}", Tone.WARN))
    return [line(*head, Span(f"{rest.drift:>+10.2f} N", Tone.WARN))]


def compared(
    name: IndicatorName, indicator: Indicator, earlier: Aggregate | None, count: int, width: int
) -> Line:
    """The difference to the mean, and whether it is better; with room, the mean.

    Beside that stands of how many runs it is, where not all of the `count` have a value. A
    difference within the uncertainties is neither better nor worse (protocol section 11).
    """
    if earlier is None or indicator.value is None:
        return ()
    value, known = indicator.value, indicator.uncertainty
    difference = value - earlier.mean
    better = (difference > 0) is name.spec.higher_is_better
    word, tone = ("better", Tone.GOOD) if better else ("worse", Tone.WARN)
    if not distinguishable(value, earlier.mean, known, earlier.uncertainty):
        word, tone = ALIKE, Tone.PLAIN
    elif difference == 0:
        word, tone = "equal", Tone.PLAIN
    spreads = () if known is None else (known, earlier.uncertainty)
    text = difference_text(difference, spreads, 4)
    if abs(difference) >= _IN_POWERS:
        text = f"{difference:+.2e}"
    parts = [Span(f"{text:>{9 if known is None or width >= _WITH_WORDS else 8}}", tone)]
    if width >= _WITH_WORDS:
        parts.append(Span(f" {word:<6}", tone))
    elif word == ALIKE:
        parts.append(Span(f" {word}", tone))
    if width >= _ROOMY:
        of = "" if earlier.count == count else f" ({earlier.count})"
        parts.append(Span(f" {value_text(earlier.mean, earlier.uncertainty)}{of}", Tone.DIM))
    return tuple(parts)
