"""What a bag says of its run, and the instants of its events.

It stands in the bag as the metadata record `madrob_run`; what happens afterwards stands in the
journal, on `/madrob/referee/event`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from typing import TypeVar

import msgspec

from madrob_console.archive.folders import JOURNAL_FILE
from madrob_console.common.errors import MadrobError
from madrob_console.common.formatting import seconds_of
from madrob_console.common.names import SourceKind, is_rehearsal, terminal_safe
from madrob_console.messages.topic_mapping import DEFAULT_MAPPINGS, TopicMapping
from madrob_console.referee.flags import RECORD_LOST
from madrob_console.referee.journal import Entry
from madrob_console.referee.rebuild import after
from madrob_console.referee.records import RunSetup, open_protests
from madrob_console.referee.run import Run
from scoring.assessment import Assessment
from scoring.protocol import Thresholds, event_words
from scoring.rest import HandleRest
from scoring.rulesets import RulesetName, ruleset

RECORD_NAME = "madrob_run"

_KEY = "run"

A = TypeVar("A", bound=Assessment)


@dataclass(frozen=True, slots=True)
class RunLabel:
    """Whose run it is, as tables for programs name it; empty or None where unknown.

    `run` is the repetition, `run_id` unique over all testbeds (section 2).
    """

    subject: int | None
    team: str
    condition: int
    run: int | None
    run_id: str = ""
    testbed: str = ""
    competition: str = ""

    @property
    def rehearsal(self) -> bool:
        return is_rehearsal(self.competition)


@dataclass(frozen=True, slots=True)
class RunRecord:
    """Everything set for a run when its recording was opened; `handle_zero` in N.

    `source` is `simulated` also where that testbed spoke over ROS. `version` is the recording
    software's. `zero_samples` None = the zero was never set.
    """

    setup: RunSetup
    handle_zero: float
    thresholds: Thresholds
    mappings: tuple[TopicMapping, ...]
    source: SourceKind
    competition: str
    version: str
    zero_samples: HandleRest | None = None

    def corrected(self, run: Run) -> RunRecord:
        return self if run.setup is None else replace(self, setup=run.setup)

    @property
    def label(self) -> RunLabel:
        setup = self.setup
        return RunLabel(
            setup.subject,
            setup.team,
            setup.condition.number,
            setup.run_number,
            setup.run_id,
            setup.testbed,
            self.competition,
        )

    def to_metadata(self) -> dict[str, str]:
        return {_KEY: msgspec.json.encode(self).decode()}

    @classmethod
    def from_metadata(cls, metadata: dict[str, str]) -> RunRecord:
        try:
            return msgspec.json.decode(metadata[_KEY], type=cls)
        except KeyError:
            raise MadrobError(f"metadata record {RECORD_NAME} has no '{_KEY}'") from None
        except (msgspec.MsgspecError, UnicodeDecodeError) as error:
            words = f"metadata record {RECORD_NAME} is damaged: {error}"
            raise MadrobError(f"{words}: use the madrob-console that recorded it") from None

    def assessment(self, start: float, rules: RulesetName | None = None) -> Assessment:
        """`start` is the (planned) start, s since the epoch; `rules` None = the run's own."""
        return self.assessed_by(Assessment, start, rules)

    def assessed_by(self, kind: type[A], start: float, rules: str | None = None) -> A:
        return kind(
            self.setup.condition,
            start,
            ruleset=ruleset(rules or self.setup.ruleset),
            thresholds=self.thresholds,
            lock_detection=self.setup.lock_detection,
            handle_zero=self.handle_zero,
        )


def record_from(entries: Sequence[Entry]) -> tuple[RunRecord, str]:
    """The record of a run whose bag has lost it, by its journal; and the remark that says so.

    Raises MadrobError where no set-up is there.
    """
    if not entries:
        raise MadrobError("a bag without a MADROB run: score and replay need one")
    run = reduce(after, entries, Run())
    if run.setup is None:
        raise MadrobError(f"{RECORD_LOST}: score the original bag, or put its {JOURNAL_FILE} here")
    record = RunRecord(
        run.setup,
        run.handle_zero,
        Thresholds(),
        tuple(mapping.limited() for mapping in DEFAULT_MAPPINGS),
        SourceKind.ROS,
        run.setup.competition,
        version="",
        zero_samples=run.zero_samples,
    )
    zero = "" if run.zero_samples else ", no handle zero"
    return record, f"{RECORD_LOST}: set-up from its journal, default topics and thresholds{zero}"


# Events of a run with their instants, found by the names that files and screens use.


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
    """The moments that somebody means by a time or a name, the earliest first.

    `text` is seconds from the start (`12.5`, `1:05`), `start`, `stop`, `protest` (the instant in
    question of the open one, else of the last), or an event as in files or on screens:
    `door_opens`, `Door opens`, `protest 1`. The rest is as for `moments_of`.
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
    """Also the run's ends and a protest without an instant."""
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
    return _NOT_A_WORD.sub(" ", text.casefold()).strip()
