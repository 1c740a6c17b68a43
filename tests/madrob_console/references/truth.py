"""What each reference run must score to: what happened, and how far a right score may be off it.

Derived from the formulas of `runs.py` and the filters of `filters.py`, never by scoring.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import msgspec

from madrob_console.cli.reference_set import Expected, Reference
from scoring.indicator_table import IndicatorName
from scoring.protocol import Outcome, Step
from tests.madrob_console.references.facts import (
    EUROBENCH,
    PROTOCOL,
    START,
    Facts,
    Rules,
    Span,
    facts,
)
from tests.madrob_console.references.motion import Motion
from tests.madrob_console.references.runs import INTERVAL, ReferenceRun


def reference(run: ReferenceRun) -> Reference:
    """All that a run must score to."""
    return Reference(
        recording=f"{run.name}.mcap",
        about=run.about,
        outcome=Outcome.COMPLETED if run.timeout is None else Outcome.TIMEOUT,
        steps=_steps(facts(run, PROTOCOL)),
        indicators={rules.name: _indicators(run, rules) for rules in (PROTOCOL, EUROBENCH)},
    )


def _steps(found: Facts) -> dict[str, Expected]:
    """The times of the steps, which are the protocol's in every ruleset."""
    instants = [found.touched, found.opened, found.opened, found.left, found.closed, found.closed]
    expected: dict[str, Expected] = {}
    done: list[Span] = []
    for step, instant in zip(Step, instants, strict=True):
        if instant is None:
            break
        latest = max([*done, instant], key=lambda span: span.truth)
        done.append(latest)
        expected[str(step.value)] = latest.expected()
    for step in Step:
        if step > len(done):
            first = step == len(done) + 1
            words = _UNDONE[step] if first else f"comes after step {step - 1}"
            why = "a step counts only after all steps before it"
            expected[str(step.value)] = Expected(missing=words, why=why)
    return expected


_UNDONE = {
    Step.TOUCH: "handle not touched",
    Step.UNLOCK: "implied by opening",
    Step.CLOSE: "door not closed",
}
"""Why the first step is not done that is not, of those that can be the first here."""


def _indicators(run: ReferenceRun, rules: Rules) -> dict[IndicatorName, Expected]:
    found = facts(run, rules)
    motion = Motion(run, rules)
    return {
        IndicatorName.EXECUTION_TIME: _execution(found, rules),
        IndicatorName.TIME_TO_HANDLE: _between(START, found.touched, _UNTOUCHED),
        IndicatorName.DOOR_OCCUPATION_TIME: _occupation(found),
        IndicatorName.PASSAGE_TIME: _passage(found, rules),
        IndicatorName.UNSAFETY_OF_DOOR_OPERATION: motion.unsafety(),
        IndicatorName.SMOOTHNESS_OF_DOOR_ACTUATION: motion.smoothness(),
        IndicatorName.ROUGHNESS_OF_DOOR_ACTUATION: _roughness(run),
        IndicatorName.CAPABILITY_LEVEL: _capability(found, rules),
    }


_UNTOUCHED = "handle never touched"
_UNAPPROACHED = "robot never approached on the starting side"
_NOT_THROUGH = "robot never reached the destination side"
_UNOPENED = "door never opened"
_UNCLOSED = "door never closed"


def _no_value(reason: str) -> Expected:
    return Expected(missing=reason, why="what did not happen has no time")


def _between(since: Span | None, until: Span | None, missing: str) -> Expected:
    if since is None or until is None:
        return _no_value(missing)
    return until.since(since).expected()


def _execution(found: Facts, rules: Rules) -> Expected:
    if not rules.to_end:
        return found.stop.since(START).expected()
    if found.left is None:
        return _no_value(_NOT_THROUGH)
    if found.closed is None:
        return _no_value(_UNCLOSED)
    return max(found.closed, found.left, key=lambda span: span.truth).since(START).expected()


def _occupation(found: Facts) -> Expected:
    if found.approached is None:
        return _no_value(_UNAPPROACHED)
    return _between(found.approached, found.left, _NOT_THROUGH)


def _passage(found: Facts, rules: Rules) -> Expected:
    if found.touched is None:
        return _no_value(_UNTOUCHED)
    if not rules.to_end and found.opened is None:
        return _no_value(_UNOPENED)
    return _between(found.touched, found.closed, _UNCLOSED)


def _capability(found: Facts, rules: Rules) -> Expected:
    if rules.to_end:
        happened = (found.approached, found.touched, found.left, found.closed)
        level = sum(each is not None for each in happened)
        why = "of approach, touch, leaving and closing so many happen"
    else:
        level = sum(one.missing is None for one in _steps(found).values())
        why = "so many steps are done in their order"
    return Expected(truth=level, lowest=level, highest=level, why=why)


def _roughness(run: ReferenceRun) -> Expected:
    if not run.pulses:
        return Expected(truth=0.0, lowest=0.0, highest=0.0, why="no force at any time")
    peaks = [abs(run.handle_zero + pulse.peak) for pulse in run.pulses]
    strongest = run.pulses[peaks.index(max(peaks))]
    loss = 1 - math.cos(math.pi * INTERVAL / 2 / strongest.duration)
    why = (
        f"half a sine of {strongest.peak:g} N on {run.handle_zero:g} N at rest, of which no zero "
        f"is subtracted; its peak lies at most {INTERVAL / 2:g} s beside a sample"
    )
    return Expected(
        truth=max(peaks),
        lowest=max(peaks) - loss * abs(strongest.peak),
        highest=max(peaks),
        why=why,
    )


def expected_text(references: Sequence[Reference]) -> bytes:
    """The file that is shipped with the recordings; what is null is left out."""
    told = _without_nulls(msgspec.to_builtins(references))
    return msgspec.json.format(msgspec.json.encode(told), indent=1) + b"\n"


def _without_nulls(told: object) -> object:
    match told:
        case dict():
            return {key: _without_nulls(value) for key, value in told.items() if value is not None}
        case list() | tuple():
            return [_without_nulls(value) for value in told]
        case _:
            return told
