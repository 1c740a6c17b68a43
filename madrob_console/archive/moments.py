"""The events of a run with their instants, found by the names that files and screens use."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from madrob_console.common.errors import MadrobError
from madrob_console.common.formatting import seconds_of
from madrob_console.common.names import terminal_safe
from madrob_console.referee.protests import open_protests
from madrob_console.referee.run import Run
from scoring.protocol import event_words

_MOST_EVENTS = 20  # from the beginning, and from the end: a door may flicker
_MOST_MARKS = 20
_NOT_A_WORD = re.compile(r"[\W_]+")


@dataclass(frozen=True, slots=True)
class Moment:
    """Something that happened in a run; `name` as in file names, `time` in s since the epoch.

    `logged`: a log time, as for the referee's marks; else the testbed's time.
    """

    name: str
    words: str
    time: float
    since_start: float
    logged: bool = False


def moments_of(events: Sequence[tuple[str, float]], run: Run, start: float) -> tuple[Moment, ...]:
    """The moments of a run by time; of very many events the first and the last.

    These are events, incidents, false starts, and the instants of protests. `events` are
    EUROBENCH's names and times, s since the epoch, as is `start`.
    """
    if len(events) > 2 * _MOST_EVENTS:
        events = (*events[:_MOST_EVENTS], *events[-_MOST_EVENTS:])
    moments = [Moment(name, event_words(name), at, at - start) for name, at in events]
    for incident in run.incidents[:_MOST_MARKS]:
        name, at = _NOT_A_WORD.sub("_", f"incident_{incident.kind}"), incident.time
        moments.append(Moment(name, f"incident: {incident.kind}", at, at - start, logged=True))
    for mark in run.false_starts[:_MOST_MARKS]:
        words, name = f"false start: {mark.event.words}", f"false_start_{mark.event}"
        moments.append(Moment(name, words, mark.time, mark.time - start))
    moments += [
        Moment(f"protest_{protest.number}", protest.title, protest.at, protest.at - start)
        for protest in run.protests[:_MOST_MARKS]
        if protest.at is not None
    ]
    return tuple(sorted(moments, key=lambda moment: moment.since_start))


def moments_called(
    text: str, events: Sequence[tuple[str, float]], run: Run, start: float
) -> tuple[Moment, ...]:
    """The moments that somebody means by a time or a name, the earliest first.

    `text` is seconds from the start (`12.5`, `1:05`), `start`, `stop`, `protest` (the instant in
    question of the open one, else of the last), or an event as in files or on screens:
    `door_opens`, `Door opens`, `protest 1`. The rest is as for `moments_of`.
    """
    if (typed := seconds_of(text)) is not None:
        # a file name keeps no sign
        name = f"at_{'minus_' if typed < 0 else ''}{abs(typed):.3f} s"
        return (Moment(name, f"{typed:.3f} s", start + typed, typed),)
    moments = [moment for moment in _named(events, run, start) if math.isfinite(moment.time)]
    wanted = _key(text)
    if matching := [
        moment for moment in moments if wanted in map(_key, (moment.name, moment.words))
    ]:
        return tuple(matching)
    there = ", ".join(dict.fromkeys(terminal_safe(moment.name) for moment in moments))
    raise MadrobError(
        f"'{terminal_safe(text)}' is no time and no event of this run: give seconds, or one of "
        f"{there}"
    )


def _named(events: Sequence[tuple[str, float]], run: Run, start: float) -> Iterator[Moment]:
    """Also the run's ends and a protest without an instant."""
    yield Moment("start", "start", start, 0.0)
    if run.stop is not None:
        yield Moment("stop", "stop", run.stop, run.stop - start)
    yield from moments_of(events, run, start)
    for protest in run.protests:
        if protest.at is None:
            yield Moment(f"protest_{protest.number}", protest.title, start, 0.0)
    for protest in (*open_protests(run.protests), *reversed(run.protests))[:1]:
        at = start if protest.at is None else protest.at
        yield Moment("protest", "protest", at, at - start)


def _key(text: str) -> str:
    return _NOT_A_WORD.sub(" ", text.casefold()).strip()
