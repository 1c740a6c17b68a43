"""`madrob watch --json` and `--plain`: a run as lines, for programs, logs and screen readers."""

from __future__ import annotations

import re
import select
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from operator import itemgetter
from typing import TYPE_CHECKING

from msgspec.structs import replace

from madrob_console.common.formatting import time_of_day
from madrob_console.engine.public_state import SpectatorState
from madrob_console.engine.snapshot import Weight
from madrob_console.referee.acts import ConfirmPose, Finalise, SetUp, Start, ZeroHandle
from madrob_console.referee.flags import undecided
from madrob_console.referee.journal import Origin
from madrob_console.referee.run import Phase
from madrob_console.ui.link import EngineLink, OpenClient
from scoring.indicator_table import IndicatorName
from scoring.procedure import UNSETTLED
from scoring.protocol import Outcome

if TYPE_CHECKING:
    from madrob_console.engine.snapshot import Snapshot

PERIOD = 0.25
"""Between two looks at the state, s."""

StateLines = Callable[["Snapshot | None", "Snapshot"], Iterator[str]]
"""The lines for a state and the one before, which is None at first."""


def follow_engine(open_client: OpenClient, lines: StateLines) -> int:
    """Print a run's lines, and those of the next engine when this one has ended, until Ctrl+C.

    Raises:
        MadrobError: there is no engine to begin with.
        BrokenPipeError: the reader of the standard output has gone.
    """
    link = EngineLink(open_client, time.monotonic)
    reader = select.poll()
    reader.register(sys.stdout, 0)
    before: Snapshot | None = None
    try:
        link.connect()
        while not reader.poll(1000 * PERIOD):  # it reports nothing but the end of the reader
            snapshot = link.snapshot()
            assert snapshot is not None
            for line in lines(before, snapshot):
                print(line, flush=True)
            before = snapshot
            if snapshot.pulse.gone:
                link.look_for_engine(lambda look: look())
    finally:
        link.close()
    raise BrokenPipeError


def json_lines(before: Snapshot | None, now: Snapshot) -> Iterator[str]:
    """The state in JSON, where more has changed than times and the numbers in faults."""
    state = SpectatorState.of_snapshot(now)
    if before is None or _timeless(SpectatorState.of_snapshot(before)) != _timeless(state):
        yield state.text


def _timeless(state: SpectatorState) -> SpectatorState:
    faults = tuple(map(_numberless, state.faults))
    return replace(state, time=0.0, elapsed=None, remaining=None, faults=faults)


def _numberless(fault: str) -> str:
    return re.sub(r"\d+(\.\d+)?", "", fault)


_TOLD = tuple(
    act.log.partition("{")[0] or act.name
    for act in (SetUp, ZeroHandle, ConfirmPose, Start, Finalise)
)
"""How the log's lines begin of acts without a sentence here: the change of the state has one."""

_ENDS = {
    Outcome.TIMEOUT: "is over by timeout",
    Outcome.ABORTED: "is aborted and invalid",
    Outcome.INTERRUPTED: "was interrupted by a failure",
}


def plain_lines(before: Snapshot | None, now: Snapshot) -> Iterator[str]:
    """What has happened between two states, in English sentences with their times."""
    if before is None or (before.pulse.gone and not now.pulse.gone):
        yield f"{time_of_day(now.time)} watching {now.label}: {_standing(now)}"
        return
    start, stop = now.run.start, now.run.stop
    for at, text in sorted(_events(before, now), key=itemgetter(0)):
        during = start is not None and start < at <= (stop or at)
        yield f"{f'{at - start:+.1f} s' if start and during else time_of_day(at)} {text}"


def _events(before: Snapshot, now: Snapshot) -> Iterator[tuple[float, str]]:
    """Times (s since the epoch) and sentences."""
    if before.pulse.stale != now.pulse.stale or before.pulse.gone != now.pulse.gone:
        yield now.time, now.pulse.gone or now.pulse.words or "the engine answers again"
    if _run_id(now) != _run_id(before) and now.run.phase is not Phase.READY:
        yield now.time, f"an earlier run is opened: {_who(now)}" if now.opened else _standing(now)
    else:
        yield from _run_events(before, now)
    newest = before.log[-1].number if before.log else -1
    for line in now.log:
        decision = line.origin in (Origin.REFEREE, Origin.REMOTE) or line.weight is Weight.ALARM
        if line.number > newest and decision and not line.text.startswith(_TOLD):
            yield line.time, line.text
    for fault in _without(now.faults, before.faults):
        yield now.time, f"fault: {fault}"
    for fault in _without(before.faults, now.faults):
        yield now.time, f"over: {fault}"


def _run_events(before: Snapshot, now: Snapshot) -> Iterator[tuple[float, str]]:
    """Steps, results and phases of one run."""
    run, was = now.run, before.run
    for old, new in zip(before.steps, now.steps, strict=True) if was.active else ():
        if new.final is not None and not old.done:
            so_far = " so far" if new.step in UNSETTLED and now.result is None else ""
            yield new.final, f"step {new.step}, {new.step.text}, is done{so_far}"
        elif old.done and not new.done:
            yield now.time, f"step {new.step}, {new.step.text}, is open again: {new.reason}"
    if now.result is not None and now.result != before.result:
        yield now.time, _result_words(now)
    set_up = run.phase is Phase.READY and run.setup != was.setup
    if run.phase is not was.phase or run.fixed_start != was.fixed_start or set_up:
        yield from _phase_event(before, now)


def _without(faults: Sequence[str], others: Sequence[str]) -> list[str]:
    without_numbers = set(map(_numberless, others))
    return [fault for fault in faults if _numberless(fault) not in without_numbers]


def _phase_event(before: Snapshot, now: Snapshot) -> Iterator[tuple[float, str]]:
    run, who = now.run, _who(now)
    setup, start = run.setup, run.start
    match run.phase:
        case Phase.READY if setup is not None:
            condition = setup.condition
            task = f"{condition.number}: {condition.way}, {condition.benchmark_type}"
            yield now.time, f"{who} is set up in condition {task}"
        case Phase.COUNTDOWN if run.countdown_began == before.run.countdown_began:
            does = "is held" if run.held is not None else "goes on"
            left = f"{now.remaining or 0.0:.1f} s before the start"
            yield now.time, f"the countdown of {who} {does}, {left}"
        case Phase.COUNTDOWN if setup is not None:
            yield now.time, f"the countdown of {who} begins: {setup.countdown:g} s"
        case Phase.RUNNING if start is not None:
            yield start, f"{who} starts"
        case Phase.STOPPED if before.run.active:
            yield run.stop or now.time, f"the run has ended: {run.outcome}, {run.outcome_reason}"
        case Phase.FINAL if run.closure is not None:
            by, word = run.closure.referee, run.closure.team_word
            yield now.time, f"the result is final: signed by {by}, team {word}"
        case _:
            pass


def _run_id(snapshot: Snapshot) -> str:
    return "" if snapshot.run.setup is None else snapshot.run.setup.run_id


def _who(snapshot: Snapshot) -> str:
    if (setup := snapshot.run.setup) is None:
        return "no run"
    kind = "practice run" if snapshot.practice else "run"
    return f"{kind} {setup.run_number} of team {setup.subject} {setup.team}".rstrip()


def _standing(snapshot: Snapshot) -> str:
    if snapshot.result is not None:
        return _result_words(snapshot)
    state = "set up" if snapshot.run.phase is Phase.IDLE else snapshot.run.phase
    return f"{_who(snapshot)} is {state}"


def _result_words(snapshot: Snapshot) -> str:
    """Outcome, time and steps of the result, and what is still open."""
    result = snapshot.result
    assert result is not None
    done = sum(record.done for record in result.steps)
    took = result.indicators[IndicatorName.EXECUTION_TIME].text
    completed = "is completed in" if done == len(result.steps) else "has ended after"
    words = f"{_who(snapshot)} {_ENDS.get(result.outcome, f'{completed} {took}')}"
    words += f": {done} of {len(result.steps)} steps"
    if snapshot.run.voided is not None:
        words += "; VOID, it does not count"
    if waiting := undecided(snapshot.flags):
        words += f"; undecided: {'; '.join(flag.words for flag in waiting)}"
    return words
