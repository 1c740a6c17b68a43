"""The run for programs: what robots hear over ROS, and spectators read as JSON."""

from __future__ import annotations

import json
from enum import StrEnum
from typing import TYPE_CHECKING, Any

import msgspec

from madrob_console.referee.flags import undecided
from madrob_console.referee.journal import Entry
from madrob_console.referee.protests import open_protests
from madrob_console.referee.run import Phase, Run
from scoring.indicator_table import IndicatorName
from scoring.procedure import UNSETTLED
from scoring.protocol import BenchmarkType, Outcome, Side, Step

if TYPE_CHECKING:
    from madrob_console.engine.snapshot import Pulse, Snapshot
    from scoring.result import Result


class PublishedState(msgspec.Struct, frozen=True, kw_only=True):
    """Where the run stands, as `/madrob/referee/state` has it.

    Attributes:
        phase: of the run.
        subject: number of the team; null before a run is set up.
        team: its name; may be empty; null before a run is set up.
        run_number: for this subject and condition; null before a run is set up.
        run_id: which run of all testbeds it is; null before a run is set up.
        testbed: its name; null before a run is set up.
        condition_number: 1 to 20; null before a run is set up.
        benchmark_type: of the condition; null before a run is set up.
        opening_side: to where the door may open; null before a run is set up.
        starting_side: where the robot starts; null before a run is set up.
        start_time: s since 1970; planned during the countdown; null before, and while a false
            start holds the countdown.
        timeout: s from the start; null before a run is set up.
        outcome: null until the run has ended.
        void: whether the referee has voided the run.
    """

    phase: Phase
    subject: int | None
    team: str | None
    run_number: int | None
    run_id: str | None
    testbed: str | None
    condition_number: int | None
    benchmark_type: BenchmarkType | None
    opening_side: Side | None
    starting_side: Side | None
    start_time: float | None
    timeout: float | None
    outcome: Outcome | None
    void: bool

    @classmethod
    def of(cls, run: Run) -> PublishedState:
        setup = run.setup
        condition = setup.condition if setup else None
        return PublishedState(
            phase=run.phase,
            subject=setup.subject if setup else None,
            team=setup.team if setup else None,
            run_number=setup.run_number if setup else None,
            run_id=setup.run_id if setup else None,
            testbed=setup.testbed if setup else None,
            condition_number=condition.number if condition else None,
            benchmark_type=condition.benchmark_type if condition else None,
            opening_side=condition.opening_side if condition else None,
            starting_side=condition.starting_side if condition else None,
            start_time=run.fixed_start,
            timeout=setup.timeout if setup else None,
            outcome=run.outcome,
            void=run.voided is not None,
        )

    @property
    def text(self) -> str:
        """The JSON object on one line, in ASCII."""
        return json.dumps(msgspec.to_builtins(self))


class EngineState(StrEnum):
    """Whether the rest of the state is of now."""

    LIVE = "live"
    SILENT = "silent"
    ENDED = "ended"

    @classmethod
    def of(cls, pulse: Pulse) -> EngineState:
        if pulse.gone:
            return cls.ENDED
        return cls.SILENT if pulse.stale else cls.LIVE


class PublicStep(msgspec.Struct, frozen=True):
    """One of the six steps.

    Attributes:
        step: its number, 1 to 6.
        name: in words.
        time: s from the start; null = not done.
        settled: whether the time can change by the referee's word only.
        referee: true = the referee confirmed the step, false = denied it; null = neither.
    """

    step: Step
    name: str
    time: float | None
    settled: bool
    referee: bool | None


class PublicResult(msgspec.Struct, frozen=True):
    """The result of the run.

    Attributes:
        issue: its number, from 1.
        final: whether it is signed, and no protest is open.
        valid: whether it counts, for an official run.
        values: of the indicators, in their units; null = there is none.
        doubted: the indicators whose values may be wrong.
        undecided: what the referee has still to decide, in words.
    """

    issue: int
    final: bool
    valid: bool
    values: dict[IndicatorName, int | float | None]
    doubted: tuple[IndicatorName, ...]
    undecided: tuple[str, ...]

    @classmethod
    def of(cls, result: Result, snapshot: Snapshot) -> PublicResult:
        run = snapshot.run
        return cls(
            run.issue,
            run.phase is Phase.FINAL and not open_protests(run.protests),
            run.valid,
            {name: indicator.value for name, indicator in result.indicators.items()},
            tuple(name for name, indicator in result.indicators.items() if indicator.doubts),
            tuple(flag.words for flag in undecided(snapshot.flags)),
        )


class SpectatorState(PublishedState, frozen=True, kw_only=True):
    """A line of `madrob watch --json`.

    Attributes:
        time: of this state, s since 1970.
        engine: `silent` and `ended`: the rest is the last that was heard.
        source: what the run is measured on, in words.
        practice: whether the run counts nowhere; before the set-up: the next one.
        rehearsal: whether it is of a rehearsal, where it counts as an official one would.
        elapsed: s since the start; negative in the countdown, the time of the run once stopped.
        remaining: s to the timeout, in the countdown to the start; else null.
        steps: the six, in order.
        faults: what is wrong now, in words.
        result: null until it is on disk.
    """

    time: float
    engine: EngineState
    source: str
    practice: bool
    rehearsal: bool
    elapsed: float | None
    remaining: float | None
    steps: tuple[PublicStep, ...]
    faults: tuple[str, ...]
    result: PublicResult | None

    @classmethod
    def of_snapshot(cls, snapshot: Snapshot) -> SpectatorState:
        run, result = snapshot.run, snapshot.result
        return cls(
            **msgspec.structs.asdict(PublishedState.of(run)),
            time=snapshot.time,
            engine=EngineState.of(snapshot.pulse),
            source=snapshot.label,
            practice=snapshot.practice,
            rehearsal=snapshot.rehearsal,
            elapsed=_rounded(snapshot.elapsed),
            remaining=_rounded(snapshot.remaining),
            steps=tuple(
                PublicStep(
                    record.step,
                    record.name,
                    _rounded(record.final - run.start) if record.final and run.start else None,
                    result is not None or record.step not in UNSETTLED,
                    None if record.referee is None else record.referee.confirmed,
                )
                for record in snapshot.steps
            ),
            faults=snapshot.faults,
            result=PublicResult.of(result, snapshot) if result else None,
        )


def _rounded(duration: float | None) -> float | None:
    return None if duration is None else round(duration, 3)


def state_schemas() -> dict[str, dict[str, Any]]:
    """Return the JSON schemas of what robots and spectators read, by their names."""
    return {
        "state": msgspec.json.schema(PublishedState),
        "event": msgspec.json.schema(Entry),
        "watch": msgspec.json.schema(SpectatorState),
    }
