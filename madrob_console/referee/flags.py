"""Flags of a result: what a decision on it depends on.

Every screen, list, page and file asks here. A new kind of flag is a member of `FlagKind` and a
line in `flags`. Its weight says what it does to the reader:

- ALARM, *decide*: the referee still has to. A false start, a step that only the referee can judge,
  a doubt, a protest, each while it is open.
- CAUTION, *changes the score*: without it another result would count, or the result cannot be made
  again. A void, a correction, a ruling, an upheld protest, out of plan, a waived check of what is
  measured or of whose run it is; a recording that lacks messages, a topic that was silent in it, a
  clock that was stepped, a panel against the opening side, a fault that no sample shows.
- REMARK, *for information*: nothing that counts depends on it. What was decided so that the values
  stand (an accepted false start or doubt, a rejected or withdrawn protest); an incident, which
  changes no indicator; another name of the same subject; practice, which counts nowhere; a waiver
  or a fault whose effect doubts and silent topics would tell.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from types import MappingProxyType
from typing import Annotated, TypeAlias

from msgspec import Meta

from madrob_console.common.formatting import counted
from madrob_console.common.names import REHEARSAL, SourceKind, is_rehearsal
from madrob_console.referee.protests import Protest, ProtestEnd
from madrob_console.referee.records import (
    AcceptedDoubts,
    CheckName,
    FalseStart,
    FaultKind,
    Incident,
    TeamWord,
    Waiver,
    merged,
)
from madrob_console.referee.run import Run
from scoring.indicator_table import IndicatorName
from scoring.procedure import Ruling, StepRecord
from scoring.protocol import Outcome
from scoring.quality import Quality, SignalQuality
from scoring.result import Indicator

Doubts: TypeAlias = dict[IndicatorName, tuple[str, ...]]

MOST_NAMED = 4
"""Indicators that are named; further ones are counted."""


def waiting_doubts(
    indicators: Mapping[IndicatorName, Indicator], accepted: Iterable[AcceptedDoubts]
) -> Doubts:
    """The doubts that are not accepted; an acceptance holds for equal sentences only."""
    passed = {
        (name, words)
        for acceptance in accepted
        for name, sentences in acceptance.doubts.items()
        for words in sentences
    }
    waiting = {
        name: tuple(words for words in indicator.doubts if (name, words) not in passed)
        for name, indicator in indicators.items()
    }
    return {name: sentences for name, sentences in waiting.items() if sentences}


def doubted_words(doubts: Mapping[IndicatorName, tuple[str, ...]]) -> str:
    """The doubted indicators: `execution time, passage time`; of many the first."""
    names = [name.words for name in doubts]
    more = len(names) - MOST_NAMED
    if more <= 1:
        return ", ".join(names)
    return f"{', '.join(names[:MOST_NAMED])} and {more} more"


LONGEST_WORDS = 300
"""Characters of a flag."""

NO_INDICATORS: Mapping[IndicatorName, Indicator] = MappingProxyType({})
"""Before there is a result."""

UNKNOWN_QUALITY = Quality()

LONGEST_SILENCE = 0.5
"""In a longer one something may have been missed: a topic is stale by then (section 3), s."""

FlagWords = Annotated[str, Meta(max_length=500)]
"""Longer than any flag of this version."""


class FlagWeight(StrEnum):
    """How much a flag weighs, the lightest first: for information, changes the score, decide."""

    REMARK = "remark"
    CAUTION = "caution"
    ALARM = "alarm"

    @property
    def rank(self) -> int:
        return tuple(FlagWeight).index(self)

    @classmethod
    def _missing_(cls, value: object) -> FlagWeight:
        return cls.ALARM  # a later version's


class FlagKind(StrEnum):
    """What flags are about."""

    VOID = "void"
    FALSE_START = "false start"
    UNDECIDED_STEP = "undecided step"
    DOUBT = "doubt"
    PRACTICE = "practice"
    OUT_OF_PLAN = "out of plan"
    PROTEST = "protest"
    CORRECTION = "correction"
    DENIED_STEP = "denied step"
    CONFIRMED_STEP = "confirmed step"
    RECORDING = "recording"
    FAULT = "fault"
    INCIDENT = "incident"
    WAIVER = "waiver"
    OTHER_NAME = "other name"
    OTHER = "other"
    """What a later version flags."""

    @classmethod
    def _missing_(cls, value: object) -> FlagKind:
        return cls.OTHER


@dataclass(frozen=True, slots=True)
class Flag:
    """One thing that every reader of a result has to know at once.

    Attributes:
        kind: what it is about.
        words: all of it, in a few words.
        weight: how much it weighs.
        undecided: whether the referee still has to decide something.
    """

    kind: FlagKind
    words: FlagWords
    weight: FlagWeight
    undecided: bool = False


def flags(
    run: Run,
    steps: Iterable[StepRecord] = (),
    source: SourceKind | None = None,
    quality: Quality = UNKNOWN_QUALITY,
    indicators: Mapping[IndicatorName, Indicator] = NO_INDICATORS,
) -> tuple[Flag, ...]:
    """All flags of a run, the most serious first.

    The `steps` are empty before the stop. A `source` of None is not flagged.
    """
    # else there is nothing to decide
    counts = run.voided is None and run.outcome not in (Outcome.ABORTED, Outcome.INTERRUPTED)
    unordered = (
        *(_false_starts(run.false_starts) if counts else ()),
        *(_undecided_steps(steps) if counts else ()),
        *(_doubts(run, indicators) if counts else ()),
        *_protests(run.protests),
        *_decisions(run, source),
        *_rulings(run.rulings),
        *_recording(run, quality if counts else None),
        *_incidents(run.incidents),
        *_waivers(run.waivers),
        *_other_name(run.team_reason),
    )
    most_serious_first = sorted(unordered, key=lambda flag: -flag.weight.rank)
    return tuple(replace(flag, words=_cut(flag.words)) for flag in most_serious_first)


def data_remarks(quality: Quality) -> list[str]:
    """What to know of a run's data, those on signals with a line for each cause."""
    of_signals = ((q.signal.value, words) for q in quality.signals for words in q.remarks())
    return [*merged(of_signals), *quality.remarks, *quality.lost]


def common_reason(indicators: Mapping[IndicatorName, Indicator]) -> str:
    """The reason why a run has no indicator, where all have the same one; else empty."""
    reasons = {indicator.reason for indicator in indicators.values()}
    return (reasons.pop() or "") if len(reasons) == 1 else ""


def worst(flags: Iterable[Flag]) -> FlagWeight | None:
    return max((flag.weight for flag in flags), key=lambda weight: weight.rank, default=None)


def serious(flags: Iterable[Flag]) -> tuple[Flag, ...]:
    return tuple(flag for flag in flags if flag.weight is not FlagWeight.REMARK)


def undecided(flags: Iterable[Flag]) -> tuple[Flag, ...]:
    return tuple(flag for flag in flags if flag.undecided)


def _false_starts(marks: Sequence[FalseStart]) -> Iterator[Flag]:
    waiting = [mark for mark in marks if mark.accepted is None]
    if waiting:
        first = f"{'first: ' if len(waiting) > 1 else ''}{waiting[0].event.words}"
        words = f"{counted(len(waiting), 'false start')} UNDECIDED ({first})"
        yield Flag(FlagKind.FALSE_START, words, FlagWeight.ALARM, undecided=True)
    if passed := len(marks) - len(waiting):
        words = f"{counted(passed, 'false start')} accepted"
        yield Flag(FlagKind.FALSE_START, words, FlagWeight.REMARK)


def _undecided_steps(steps: Iterable[StepRecord]) -> Iterator[Flag]:
    for record in steps:
        if record.undecided:
            words = f"step {record.step:d} UNDECIDED ({record.reason})"
            yield Flag(FlagKind.UNDECIDED_STEP, words, FlagWeight.ALARM, undecided=True)


def _doubts(run: Run, indicators: Mapping[IndicatorName, Indicator]) -> Iterator[Flag]:
    if waiting := waiting_doubts(indicators, run.accepted_doubts):
        words = f"{counted(len(waiting), 'value')} to check: {doubted_words(waiting)}"
        yield Flag(FlagKind.DOUBT, words, FlagWeight.ALARM, undecided=True)
    for accepted in run.accepted_doubts:
        standing = {
            name: accepted.doubts[name]
            for name, indicator in indicators.items()
            if not set(accepted.doubts.get(name, ())).isdisjoint(indicator.doubts)
        }
        if standing:
            words = f"doubt accepted: {doubted_words(standing)} ({accepted.reason})"
            yield Flag(FlagKind.DOUBT, words, FlagWeight.REMARK)


def _decisions(run: Run, source: SourceKind | None) -> Iterator[Flag]:
    """What was decided about the whole run, before its start or after its stop."""
    if run.voided is not None:
        words = f"VOID, does not count ({run.voided.reason})"
        yield Flag(FlagKind.VOID, words, FlagWeight.CAUTION)
    competition = "" if run.setup is None else run.setup.competition
    yield from practice_flags(source, competition, practice=run.practice)
    if run.out_of_plan:
        words = "out of plan: more than the competition planned"
        yield Flag(FlagKind.OUT_OF_PLAN, words, FlagWeight.CAUTION)
    if run.closure is not None and run.closure.team_word is TeamWord.PROTESTED:
        yield Flag(FlagKind.PROTEST, "PROTESTED by the team", FlagWeight.CAUTION)
    if run.corrections:
        words = f"corrected: {_listed(correction.words for correction in run.corrections)}"
        yield Flag(FlagKind.CORRECTION, words, FlagWeight.CAUTION)


def practice_flags(
    source: SourceKind | None, competition: str, *, practice: bool
) -> Iterator[Flag]:
    """Flags a run that is not official: of a rehearsal, simulated, replayed, set up as practice."""
    kind: str = FlagKind.PRACTICE if source in (None, SourceKind.ROS) else source
    if is_rehearsal(competition):
        kind = REHEARSAL
    if practice or kind is not FlagKind.PRACTICE:
        kinds = dict.fromkeys((*["PRACTICE"] * practice, kind.upper()))
        words = f"{', '.join(kinds)}: not an official result"
        yield Flag(FlagKind.PRACTICE, words, FlagWeight.REMARK)


def _protests(protests: Sequence[Protest]) -> Iterator[Flag]:
    """Protests count even for a run that does not: they may be about that."""
    for protest in protests:
        if protest.answer is None:
            words = f"{protest.title} OPEN, UNDECIDED"
            yield Flag(FlagKind.PROTEST, words, FlagWeight.ALARM, undecided=True)
        else:
            upheld = protest.answer.end in (ProtestEnd.UPHELD, ProtestEnd.PARTLY)
            weight = FlagWeight.CAUTION if upheld else FlagWeight.REMARK
            words = f"{protest.title} {protest.answer.end} ({protest.answer.reason})"
            yield Flag(FlagKind.PROTEST, words, weight)


def _rulings(rulings: Iterable[Ruling]) -> Iterator[Flag]:
    last = {ruling.step: ruling.confirmed for ruling in rulings}
    for verdict, kind in ((False, FlagKind.DENIED_STEP), (True, FlagKind.CONFIRMED_STEP)):
        ruled = [f"{step:d}" for step in sorted(last) if last[step] is verdict]
        if ruled:
            steps = f"{'steps' if len(ruled) > 1 else 'step'} {', '.join(ruled)}"
            said = "confirmed" if verdict else "denied"
            yield Flag(kind, f"{steps} {said}", FlagWeight.CAUTION)


def unrecorded_words(messages: int) -> str:
    lacks = counted(messages, "message")
    return f"the recording lacks {lacks}: the result cannot be made again from it"


_UNTOLD_OTHERWISE = (
    FaultKind.UNKNOWN,
    FaultKind.SEVERAL_PUBLISHERS,
    FaultKind.ANNOUNCEMENT,
    FaultKind.NO_READING,
)
"""Faults that may change a value, or whether the run counts, and that no sample shows."""


def _recording(run: Run, quality: Quality | None) -> Iterator[Flag]:
    """What the recording lacks, may have missed, or was measured otherwise (sections 3 and 8).

    Doubts are on what was found. What happened in a silence may be missing without any doubt.
    The `quality` of a run that does not count is None.
    """
    if run.unrecorded:
        yield Flag(FlagKind.RECORDING, unrecorded_words(run.unrecorded), FlagWeight.CAUTION)
    if run.record_lost:
        yield Flag(FlagKind.RECORDING, run.record_lost, FlagWeight.CAUTION)
    if quality is not None:
        needed = [q for q in quality.signals if not q.signal.optional]
        silent = ((q.signal.value, _silence(q)) for q in needed)
        stepped = ((q.signal.value, "clock stepped, stamps shifted") for q in needed if q.shifted)
        faults = [*merged((name, words) for name, words in silent if words), *merged(stepped)]
        if quality.against_opening:
            turned = f"panel turned {quality.against_opening:.3f} rad against the opening side"
            faults.append(turned)
        yield from (Flag(FlagKind.FAULT, words, FlagWeight.CAUTION) for words in faults)
    if run.faults:
        harmless = all(fault.kind not in _UNTOLD_OTHERWISE for fault in run.faults)
        weight = FlagWeight.REMARK if harmless else FlagWeight.CAUTION
        yield Flag(FlagKind.FAULT, counted(len(run.faults), "testbed fault"), weight)


def _silence(of: SignalQuality) -> str:
    if not of.samples:
        return "nothing recorded"
    longest = max(of.largest_gap or 0.0, of.begins_late, of.ends_early)
    return f"no sample for {longest:.1f} s" if longest > LONGEST_SILENCE else ""


def _incidents(incidents: Iterable[Incident]) -> Iterator[Flag]:
    if marked := [mark.kind for mark in incidents]:
        words = f"{counted(len(marked), 'incident')} ({_listed(marked)})"
        yield Flag(FlagKind.INCIDENT, words, FlagWeight.REMARK)


_OF_THE_ATTEMPT = (
    CheckName.TEAM,
    CheckName.DOOR,
    CheckName.HANDLE,
    CheckName.DOORWAY,
    CheckName.POSE,
)
"""Checks of whose run it is and of how it begins. The effect of the others the recording shows."""


def _waivers(waivers: Iterable[Waiver]) -> Iterator[Flag]:
    checks = [waiver.check for waiver in waivers]
    if checks:
        heavy = not set(checks).isdisjoint(_OF_THE_ATTEMPT)
        weight = FlagWeight.CAUTION if heavy else FlagWeight.REMARK
        yield Flag(FlagKind.WAIVER, f"check waived: {_listed(checks)}", weight)


def _cut(words: str) -> str:
    return words if len(words) <= LONGEST_WORDS else f"{words[: LONGEST_WORDS - 3]}..."


def _other_name(why: str) -> Iterator[Flag]:
    if why:
        words = f"team's name other than the list's: {why}"
        yield Flag(FlagKind.OTHER_NAME, words, FlagWeight.REMARK)


def _listed(words: Iterable[str]) -> str:
    return ", ".join(dict.fromkeys(words))
