"""What happened in a run, and at which instant; found by the words of files and of screens."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from madrob_console.errors import MadrobError
from madrob_console.names import terminal_safe
from madrob_console.referee.protests import open_protests
from madrob_console.referee.run import Run
from madrob_console.referee.run_times import seconds_of
from scoring.protocol import event_words

_MOST_EVENTS = 20  # from the beginning, and from the end: a door may flicker
_MOST_MARKS = 20
_NOT_A_WORD = re.compile(r"[\W_]+")


@dataclass(frozen=True, slots=True)
class Moment:
    """Something that happened in a run.

    Attributes:
        name: as it stands in file names.
        words: what happened, for people.
        time: s since the epoch.
        since_start: s since the start of the run.
        logged: its time is a log time, as the referee's marks have it; else the testbed's.
    """

    name: str
    words: str
    time: float
    since_start: float
    logged: bool = False


def moments_of(events: Sequence[tuple[str, float]], run: Run, start: float) -> tuple[Moment, ...]:
    """What happened in a run, by time; of very many events the first and the last.

    Events, incidents, false starts, and the instants that protests are about.

    Args:
        events: their names as EUROBENCH has them, and when they were, s since the epoch.
        run: what the referee marked.
        start: of the run, s since the epoch.
    """
    if len(events) > 2 * _MOST_EVENTS:
        events = (*events[:_MOST_EVENTS], *events[-_MOST_EVENTS:])
    found = [Moment(name, event_words(name), at, at - start) for name, at in events]
    for incident in run.incidents[:_MOST_MARKS]:
        name, at = _NOT_A_WORD.sub("_", f"incident_{incident.kind}"), incident.time
        found.append(Moment(name, f"incident: {incident.kind}", at, at - start, logged=True))
    for mark in run.false_starts[:_MOST_MARKS]:
        words, name = f"false start: {mark.event.words}", f"false_start_{mark.event}"
        found.append(Moment(name, words, mark.time, mark.time - start))
    found += [
        Moment(f"protest_{one.number}", one.title, one.at, one.at - start)
        for one in run.protests[:_MOST_MARKS]
        if one.at is not None
    ]
    return tuple(sorted(found, key=lambda moment: moment.since_start))


def moments_called(
    text: str, events: Sequence[tuple[str, float]], run: Run, start: float
) -> tuple[Moment, ...]:
    """What somebody means by a time or by what happened, the earliest first.

    Args:
        text: seconds from the start (`12.5`, `1:05`), `start`, `stop`, `protest` (the instant in
            question of the one that is open, else of the last), or what happened, as files or
            screens have it: `door_opens`, `Door opens`, `protest 1`.
        events: as for `moments_of`.
        run: as there.
        start: as there.

    Raises:
        MadrobError: nothing of this run is called so; the message has what is.
    """
    if (typed := seconds_of(text)) is not None:
        # a file name keeps no sign
        name = f"at_{'minus_' if typed < 0 else ''}{abs(typed):.3f} s"
        return (Moment(name, f"{typed:.3f} s", start + typed, typed),)
    known = [one for one in _named(events, run, start) if math.isfinite(one.time)]
    wanted = _key(text)
    if found := [one for one in known if wanted in _called(one)]:
        return tuple(found)
    there = ", ".join(dict.fromkeys(terminal_safe(one.name) for one in known))
    raise MadrobError(
        f"'{terminal_safe(text)}' is no time and no event of this run: give seconds, or one of "
        f"{there}"
    )


def _named(events: Sequence[tuple[str, float]], run: Run, start: float) -> Iterator[Moment]:
    """Whatever has a name: what happened, the run's ends, a protest without an instant, too."""
    yield Moment("start", "start", start, 0.0)
    if run.stop is not None:
        yield Moment("stop", "stop", run.stop, run.stop - start)
    yield from moments_of(events, run, start)
    for one in run.protests:
        if one.at is None:
            yield Moment(f"protest_{one.number}", one.title, start, 0.0)
    for one in (*open_protests(run.protests), *reversed(run.protests))[:1]:
        at = start if one.at is None else one.at
        yield Moment("protest", "protest", at, at - start)


def _called(moment: Moment) -> Iterable[str]:
    return map(_key, (moment.name, moment.words))


def _key(text: str) -> str:
    """What is left where case, blanks and underscores do not matter."""
    return _NOT_A_WORD.sub(" ", text.casefold()).strip()
