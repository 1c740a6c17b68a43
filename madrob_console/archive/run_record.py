"""What a bag says of its run, and the instants of its events."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import msgspec

from madrob_console.archive.result_summary import run_id_at
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import SourceKind, terminal_safe
from madrob_console.messages.codec import TopicMapping
from madrob_console.referee.records import RunSetup, open_protests, seconds_of
from madrob_console.referee.run import Run
from scoring.evaluate import Assessment, LiveAssessment
from scoring.protocol import Thresholds, event_words
from scoring.rest import HandleRest
from scoring.rulesets import RulesetName, ruleset

# It stands in the bag as the metadata record `madrob_run`; what happens afterwards stands in the
# journal, on `/madrob/referee/event`.


RECORD_NAME = "madrob_run"
"""Name of the metadata record."""

_KEY = "run"

A = TypeVar("A", bound=LiveAssessment)


@dataclass(frozen=True, slots=True)
class RunLabel:
    """Whose run it is, and which of all: what tables for programs join by.

    Attributes:
        subject: the robot's number; None = not known.
        team: the team's name; empty where unknown.
        condition: its number.
        run: the repetition; None = not known.
        run_id: which run of all testbeds it is (section 2); empty where unknown.
        testbed: the name of the testbed; empty where it had none.
        competition: its name; empty where none was set.
    """

    subject: int | None
    team: str
    condition: int
    run: int | None
    run_id: str = ""
    testbed: str = ""
    competition: str = ""


@dataclass(frozen=True, slots=True)
class RunRecord:
    """Everything set for a run when its recording was opened.

    Attributes:
        setup: subject, condition, start pose and so on.
        handle_zero: N.
        thresholds: the testbed's numbers.
        mappings: which topic carried which signal.
        source: where the messages came from; `simulated` also where that testbed spoke over ROS.
        competition: its name.
        version: of the software that recorded.
        zero_samples: behind the handle zero; None = it was never set, or by an earlier version.
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
        """With the set-up of the run as it stands, after what was corrected."""
        return self if run.setup is None else replace(self, setup=run.setup)

    def label(self, recording: Path) -> RunLabel:
        """Whose run it is.

        Args:
            recording: its bag or its folder, which identifies a run of an earlier version.
        """
        setup = self.setup
        return RunLabel(
            setup.subject,
            setup.team,
            setup.condition.number,
            setup.run_number,
            setup.run_id or run_id_at(recording),
            setup.testbed,
            self.competition,
        )

    def to_metadata(self) -> dict[str, str]:
        """The record as MCAP metadata."""
        return {_KEY: msgspec.json.encode(self).decode()}

    @classmethod
    def from_metadata(cls, metadata: dict[str, str]) -> RunRecord:
        """The record in a bag's metadata.

        Raises:
            MadrobError: it is damaged, or from a version with other fields.
        """
        try:
            return msgspec.json.decode(metadata[_KEY], type=cls)
        except KeyError:
            raise MadrobError(f"metadata record {RECORD_NAME} has no '{_KEY}'") from None
        except (msgspec.MsgspecError, UnicodeDecodeError) as error:
            raise MadrobError(f"metadata record {RECORD_NAME} is damaged: {error}") from None

    def assessment(self, start: float, rules: RulesetName | None = None) -> Assessment:
        """A new assessment of the run.

        Args:
            start: its (planned) start, s since the epoch.
            rules: another ruleset than the run's.
        """
        return self.assessed_by(Assessment, start, rules)

    def assessed_by(self, kind: type[A], start: float, rules: RulesetName | None = None) -> A:
        """A new assessment of some kind, likewise."""
        return kind(
            self.setup.condition,
            start,
            ruleset=ruleset(rules or self.setup.ruleset),
            thresholds=self.thresholds,
            lock_detection=self.setup.lock_detection,
            handle_zero=self.handle_zero,
            stopped_by=ruleset(self.setup.ruleset),
        )


def demand_record(records: Mapping[str, object], path: Path) -> None:
    """A bag with these metadata records is of a run.

    Raises:
        MadrobError: it is of none.
    """
    if RECORD_NAME not in records:
        raise MadrobError(f"{path}: a bag without a MADROB run cannot be replayed")


# What happened in a run, and at which instant; found by the words of files and of screens.


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
