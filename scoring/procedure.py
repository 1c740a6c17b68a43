"""The six steps: live progress and capability level (protocol sections 2 and 7).

Each step is looked for after the ones before it. The same chain runs on live evidence and on
that of a stopped run.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from scoring.edges import Edge, edges_until
from scoring.protocol import LockDetection, Step

_REFEREE_LOCKS = "the referee confirms the lock"
_LATCH_SILENT = "latch sensor silent: the referee decides"

UNSETTLED = frozenset({Step.CROSS, Step.CLOSE, Step.LOCK})
"""Steps whose times may change until the recording ends: the robot can turn back, the door open."""


@dataclass(frozen=True, slots=True)
class Ruling:
    """The referee's word on a step, kept beside the automatic finding (protocol section 7).

    Attributes:
        step: which of the six.
        confirmed: true = done, false = not done, null = withdrawn: the sensors count.
        time: when the referee said so, s since the epoch.
        reason: why, in the referee's words.
        referee: the referee's name.
    """

    step: Step
    confirmed: bool | None
    time: float
    reason: str
    referee: str


@dataclass(frozen=True, slots=True)
class StepRecord:
    """One of the six steps: what the sensors say, what the referee says, what counts.

    Attributes:
        step: its number, 1 to 6.
        name: in words.
        sensors: time of the automatic finding, s since the epoch; null = not done.
        referee: the referee's latest word on it; null = none.
        final: the time that counts, s since the epoch; null = not done.
        reason: why it is not done, in words; null where it is.
    """

    step: Step
    name: str
    sensors: float | None = None
    referee: Ruling | None = None
    final: float | None = None
    reason: str | None = None

    @property
    def denied(self) -> bool:
        return self.referee is not None and self.referee.confirmed is False

    @property
    def why_not(self) -> str:
        return (self.reason or "").removesuffix(" yet")

    @property
    def undecided(self) -> bool:
        """Whether only the referee can confirm it, and has not ruled."""
        return self.referee is None and self.reason in (_REFEREE_LOCKS, _LATCH_SILENT)

    @property
    def done(self) -> bool:
        return self.final is not None


@dataclass(frozen=True, slots=True)
class Evidence:
    """What the sensors say about the six steps (section 7); times in s since the epoch.

    Read it before the next sample is fed: edges are not copied, a flickering signal has thousands.

    Attributes:
        door: opening (True) and closing edges.
        door_seen: time of the newest door sample.
        latch: states from the start on, the one at the start included.
        latch_before_start: whether the latch delivered a value before the start.
        crossed: live, since when the crossing holds; after the stop, the time of
            `humanoid_moves_to_<destination>_side`.
    """

    start: float
    stop: float | None
    touched: float | None
    door: Sequence[Edge]
    door_seen: float | None
    latch: Sequence[Edge]
    latch_before_start: bool
    crossed: float | None


@dataclass(frozen=True, slots=True)
class Procedure:
    """The six steps as they stand; `settling`: step 5 is done, the settle time of step 6 runs."""

    steps: tuple[StepRecord, ...]
    settling: bool
    lock_detection: LockDetection

    @property
    def done(self) -> frozenset[Step]:
        return frozenset(record.step for record in self.steps if record.done)

    @property
    def level(self) -> int:
        """Capability level, 0..6."""
        return len(self.done)

    @property
    def completed(self) -> float | None:
        """When the last step was done, s since the epoch.

        None = not yet.
        """
        return self.steps[-1].final


def follow_procedure(
    evidence: Evidence,
    *,
    lock_detection: LockDetection,
    settle_time: float,
    rulings: Sequence[Ruling] = (),
) -> Procedure:
    """Find the six steps in the evidence, under the referee's rulings (the latest counts).

    A confirmed step that the sensors did not find takes the time of the step before it, so that
    the referee's reaction time delays no later step. A confirmed step 6, which may stop the run,
    takes the time of the ruling. `settle_time` is in s.
    """
    mode = _resolve(lock_detection, evidence)
    last = {ruling.step: ruling for ruling in rulings}
    latest = {step: ruling for step, ruling in last.items() if ruling.confirmed is not None}
    automatic = _chain(evidence, mode, settle_time, {})
    ruled = _chain(evidence, mode, settle_time, latest) if latest else automatic
    steps = tuple(
        StepRecord(
            step,
            step.text,
            automatic[step].time,
            latest.get(step),
            ruled[step].time,
            ruled[step].why or None,
        )
        for step in Step
    )
    return Procedure(steps, ruled[Step.LOCK].settling, mode)


@dataclass(frozen=True, slots=True)
class _Finding:
    time: float | None
    why: str = ""
    settling: bool = False


_Finder = Callable[[float], _Finding]


def _resolve(lock_detection: LockDetection, evidence: Evidence) -> LockDetection:
    if lock_detection is not LockDetection.AUTO:
        return lock_detection
    return LockDetection.SENSOR if evidence.latch_before_start else LockDetection.SETTLE


def _chain(
    evidence: Evidence, mode: LockDetection, settle_time: float, rulings: Mapping[Step, Ruling]
) -> dict[Step, _Finding]:
    uses_latch = mode is not LockDetection.SETTLE and bool(evidence.latch)
    finders: dict[Step, _Finder] = {
        Step.TOUCH: lambda _: _finding(evidence.touched, "handle not touched yet"),
        Step.UNLOCK: lambda t: _unlocked(evidence, t, uses_latch),
        Step.OPEN: lambda t: _opened(evidence, t),
        Step.CROSS: lambda t: _crossed(evidence, t),
        Step.CLOSE: lambda t: _closed(evidence, t),
        Step.LOCK: lambda t: _locked(evidence, t, mode, settle_time),
    }
    findings: dict[Step, _Finding] = {}
    before: float | None = evidence.start
    for step, find in finders.items():
        if before is None:
            finding = _Finding(None, f"comes after step {step - 1}")
        else:
            finding = _rule(find(before), rulings.get(step), before, evidence.stop)
        findings[step] = finding
        before = finding.time
    return findings


def _rule(finding: _Finding, ruling: Ruling | None, before: float, stop: float | None) -> _Finding:
    if ruling is None:
        return finding
    if not ruling.confirmed:
        return _Finding(None, f"denied by the referee: {ruling.reason}")
    if finding.time is not None:
        return finding
    if ruling.step is not Step.LOCK:
        return _Finding(before)
    time = max(ruling.time, before)
    return _Finding(time if stop is None else min(time, stop))


def _finding(time: float | None, why: str) -> _Finding:
    return _Finding(time) if time is not None else _Finding(None, why)


def _until(evidence: Evidence, edges: Sequence[Edge]) -> Sequence[Edge]:
    if evidence.stop is None:
        return edges
    return edges[: edges_until(edges, evidence.stop)]


def _first_time(edges: Sequence[Edge], value: bool, after: float) -> float | None:
    count = edges_until(edges, after)
    if count and edges[count - 1].value is value:
        return after
    return next((edge.time for edge in edges[count : count + 2] if edge.value is value), None)


def _unlocked(evidence: Evidence, touched: float, uses_latch: bool) -> _Finding:
    if uses_latch:
        time = _first_time(_until(evidence, evidence.latch), False, touched)
        return _finding(time, "latch still engaged")
    return _finding(_opened(evidence, touched).time, "implied by opening")


def _opened(evidence: Evidence, unlocked: float) -> _Finding:
    time = _first_time(_until(evidence, evidence.door), True, unlocked)
    return _finding(time, "door not opened yet")


def _crossed(evidence: Evidence, opened: float) -> _Finding:
    crossed = evidence.crossed
    if crossed is None or crossed <= opened:
        return _Finding(None, "robot not on the destination side")
    return _Finding(crossed)


def _closed(evidence: Evidence, crossed: float) -> _Finding:
    door = _until(evidence, evidence.door)
    if not door or door[-1].value:
        return _Finding(None, "door not closed yet")
    return _Finding(max(door[-1].time, crossed))


def _locked(evidence: Evidence, closed: float, mode: LockDetection, settle_time: float) -> _Finding:
    if mode is LockDetection.REFEREE:
        return _Finding(None, _REFEREE_LOCKS)
    if mode is LockDetection.SENSOR:
        if not evidence.latch:
            return _Finding(None, _LATCH_SILENT)
        time = _first_time(_until(evidence, evidence.latch), True, closed)
        return _finding(time, "latch not engaged yet")
    settled = closed + settle_time
    opened = _first_time(evidence.door, True, closed)
    if opened is not None and opened < settled:
        return _Finding(None, f"door did not stay closed for {settle_time:g} s")
    if evidence.door_seen is None or evidence.door_seen < settled:
        why = f"door must stay closed for {settle_time:g} s"
        return _Finding(None, why, settling=True)
    return _Finding(closed)
