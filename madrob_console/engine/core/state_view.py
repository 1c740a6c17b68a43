"""The state as screens get it, made whole of what the parts of the core know."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from madrob_console.archive.unfinished_runs import Unfinished
from madrob_console.common.names import is_rehearsal
from madrob_console.engine.core.current_run import CurrentRun
from madrob_console.engine.core.now import Now
from madrob_console.engine.core.observation import NEWEST, Observation
from madrob_console.engine.playback import PlaybackView
from madrob_console.engine.snapshot import DoorView, ExportView, LatchView, Snapshot
from madrob_console.referee.acts import ACTS, Situation
from madrob_console.referee.checks import Check, CheckState
from madrob_console.referee.records import CheckName
from madrob_console.referee.run import Phase, Run
from madrob_console.referee.topic_health import Freshness
from madrob_console.testbeds.announcement import INFO_TOPIC, Announcement
from scoring.procedure import Procedure, StepRecord
from scoring.protocol import Event, LockDetection, Step
from scoring.result import Result

NO_STEPS = tuple(StepRecord(step, step.text) for step in Step)

NO_ACTS = "a replay shows what was decided then: nothing can be done to the run"

_NAMES = tuple(act.name for act in ACTS)


def shown_state(  # noqa: PLR0913, PLR0917  all that there is to show
    now: Now,
    situation: Situation,
    current: CurrentRun,
    observation: Observation,
    refusals: Mapping[str, str],
    unfinished: tuple[Unfinished, ...],
    export: ExportView | None,
    others: Iterable[str | None],
    playback: PlaybackView | None,
) -> Snapshot:
    """Everything that a screen shows.

    `others` is what is wrong around the engine, in words; only a replay has a `playback`.
    """
    run, state, live = current.run, current.state, playback is None
    testbed, taken, evidence = now.testbed, now.taken, now.workers.evidence
    sensors, procedure = observation.sensors, observation.procedure
    recorder, scored = now.workers.recorder, state.result.scored
    door, latch = sensors.door_view(taken), sensors.latch_view(taken)
    rescoring = scored is not None and state.result.is_outdated(now.monotonic)
    result = scored.result if scored and not rescoring else None
    kind = scored.record.source if scored and live else testbed.kind
    announced = testbed_problem(testbed.announcement, run)
    lacking = evidence.remarks(run.start) if evidence is not None and state.recording else ()
    problems = (  # by what they cost the run
        now.disk.journal_problem,
        state.result.problem,
        now.workers.scoring,
        *now.disk.late_runs,
        f"recorder: {recorder.problem}" if recorder.problem else None,
        f"recorder: {recorder.dropped} messages dropped" if recorder.dropped else None,
        disk_problem(situation.checks) if live else None,
        f"{INFO_TOPIC}: {announced}" if announced else None,
        f"another referee: {testbed.other_referee}" if testbed.other_referee else None,
        now.behind,
        *sensors.topic_faults(testbed.topics, taken),
        panel_fault(door, run),
        *(f"{topic}: {words}" for topic, words in testbed.robot_problems.items()),
        *others,
        *(f"evidence: {words}" for words in lacking),
    )
    return Snapshot(
        time=now.time,
        source_kind=testbed.kind,
        source_label=testbed.label,
        simulated=testbed.announcement.simulated,
        sides_problem=testbed.sides_problem,
        run=run,
        elapsed=elapsed(run, now.time),
        remaining=remaining(run, now.time),
        settling=procedure is not None and procedure.settling and run.active,
        checks=situation.checks if live else (),
        refusals=dict(refusals) if live else dict.fromkeys(_NAMES, NO_ACTS),
        steps=observation.steps or NO_STEPS,
        ask_referee=question(run, procedure, latch),
        door=door,
        handle=sensors.handle_view(taken, run.handle_zero, observation.largest_force),
        latch=latch,
        passage=sensors.passage_view(taken),
        topics=sensors.topics(testbed.topics, now.workers.dropped, taken),
        recorder=recorder,
        disk_free=now.disk.free,
        evidence=evidence,
        faults=tuple(filter(None, problems)),
        provisional=dict(observation.provisional),
        provisional_doubts=dict(observation.provisional_doubts),
        log=current.log.lines,
        events=_newest(result) if result else observation.events,
        result=result,
        result_source=kind if result else None,
        rescoring=rescoring,
        unfinished=unfinished,
        opened=state.opened is not None,
        folder=str(state.folder) if state.folder else None,
        playback=playback,
        export=export,
        teams=now.teams,
        plan=now.plan,
        testbed=situation.testbed,
        competition=situation.competition,
    )


def _newest(result: Result) -> tuple[Event, ...]:
    return tuple(Event(each.time, each.event) for each in result.events[-2 * NEWEST :])


def disk_problem(checks: Iterable[Check]) -> str | None:
    failed = (
        check
        for check in checks
        if check.name is CheckName.DISK and check.state is CheckState.FAILED
    )
    return next((f"{check.name}: {check.reason}" for check in failed), None)


def testbed_problem(announced: Announcement, run: Run) -> str | None:
    official = run.active and run.setup is not None and not run.setup.practice
    rehearsal = run.setup is not None and is_rehearsal(run.setup.competition)
    if official and announced.simulated is not None and not rehearsal:
        return f"the testbed is simulated ({announced.simulated}): void this run after its stop"
    return announced.problem


def elapsed(run: Run, now: float) -> float | None:
    """Seconds since the start; negative in the countdown, frozen while held and at the stop."""
    if run.start is None:
        return None
    return (run.stop or run.held or now) - run.start


def remaining(run: Run, now: float) -> float | None:
    """Seconds to the timeout while running, to the start in the countdown."""
    if run.start is None or run.setup is None:
        return None
    if run.phase is Phase.COUNTDOWN:
        return max(0.0, run.start - (run.held or now))
    if run.phase is Phase.RUNNING:
        return max(0.0, run.start + run.setup.timeout - now)
    return None


def question(run: Run, procedure: Procedure | None, latch: LatchView) -> str | None:
    if run.phase is not Phase.RUNNING or procedure is None:
        return None
    if procedure.lock_detection is LockDetection.SENSOR:
        if latch.freshness in (Freshness.LOST, Freshness.NEVER):
            return "the latch sensor is silent: confirm or deny steps 2 and 6"
        return None
    if procedure.lock_detection is LockDetection.REFEREE and Step.CLOSE in procedure.done:
        return "the door is closed: confirm step 6 once it is locked"
    return None


def panel_fault(door: DoorView, run: Run) -> str | None:
    if run.setup is None or door.angle is None:
        return None
    against = -door.angle * run.setup.condition.opening_side.sign > door.closed_angle
    return f"panel at {door.angle:+.3f} rad, against the opening side" if against else None
