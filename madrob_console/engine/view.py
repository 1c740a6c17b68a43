"""The state as screens get it, made whole of what the parts of the engine know."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from madrob_console.archive.run_journal import Unfinished
from madrob_console.common.names import is_rehearsal
from madrob_console.engine.current_run import Acting, CurrentRun
from madrob_console.engine.observation import NEWEST, Backlog, Observation
from madrob_console.engine.replay import NO_ACTS, EngineContext
from madrob_console.engine.snapshot import (
    DoorView,
    EvidenceView,
    ExportView,
    LatchView,
    Snapshot,
)
from madrob_console.engine.start_checks import PreStart
from madrob_console.messages.codec import ROBOT_STARTED_TOPIC
from madrob_console.referee.acts import ACTS, Situation
from madrob_console.referee.checks import Check, CheckState, Freshness
from madrob_console.referee.competition_plan import Plan
from madrob_console.referee.records import CheckName
from madrob_console.referee.run import Phase, Run
from madrob_console.testbeds.source import INFO_TOPIC, Announcement
from scoring.procedure import Procedure, StepRecord
from scoring.protocol import Event, LockDetection, Step
from scoring.result import Result

NO_STEPS = tuple(StepRecord(step, step.text) for step in Step)

_NAMES = tuple(act.name for act in ACTS)


@dataclass(frozen=True, slots=True, eq=False)
class StateView:
    """Builds the snapshot for the screens."""

    engine_context: EngineContext
    observation: Observation
    backlog: Backlog
    pre_start: PreStart
    at_hand: CurrentRun
    acting: Acting

    def snapshot(
        self,
        now: float,
        seen: float,
        situation: Situation,
        unfinished: tuple[Unfinished, ...],
        plan: Plan,
        export: ExportView | None,
        others: Iterable[str | None],
    ) -> Snapshot:
        """Everything that a screen shows.

        `seen` is the time up to which all messages were taken, s since the epoch; `others` is
        what is wrong around the engine, in words.
        """
        at_hand, replay, source = (
            self.at_hand,
            self.engine_context.replay,
            self.engine_context.source,
        )
        run, observation = at_hand.run, self.observation
        sensors, procedure = observation.sensors, observation.procedure
        recorder, evidence = at_hand.recorder.view(), self.engine_context.evidence_client.status
        topics = sensors.topics(source.status(), at_hand.recorder.dropped(), seen)
        door, latch = sensors.door_view(seen), sensors.latch_view(seen)
        scored = at_hand.result.scored
        rescoring = scored is not None and at_hand.result.outdated
        result = scored.result if scored and not rescoring else None
        kind = scored.record.source if scored and not replay else source.kind
        other = source.other_referee
        told = testbed_problem(source.announcement, run)
        problems = (  # by what they cost the run
            at_hand.event_publisher.journal.problem,
            at_hand.result.problem,
            self.engine_context.scorer.problem(at_hand.place),
            *at_hand.result.waiting,
            f"recorder: {recorder.problem}" if recorder.problem else None,
            f"recorder: {recorder.dropped} messages dropped" if recorder.dropped else None,
            None if replay else disk_problem(situation.checks),
            f"{INFO_TOPIC}: {told}" if told else None,
            f"another referee: {other}" if other else None,
            self.backlog.problem,
            *sensors.topic_faults(source.status(), seen),
            panel_fault(door, run),
            f"{ROBOT_STARTED_TOPIC}: {source.robot_problem}" if source.robot_problem else None,
            *(replay.problems if replay else ()),
            *others,
            *(f"evidence: {words}" for words in (evidence.faults(run.start) if evidence else ())),
        )
        return Snapshot(
            time=now,
            source_kind=source.kind,
            source_label=source.label,
            simulated=source.announcement.simulated,
            sides_problem=source.sides_problem,
            run=run,
            elapsed=elapsed(run, now),
            remaining=remaining(run, now),
            settling=procedure is not None and procedure.settling and run.active,
            checks=() if replay else situation.checks,
            refusals=(
                dict.fromkeys(_NAMES, NO_ACTS) if replay else self.acting.refusals(situation)
            ),
            steps=observation.steps or NO_STEPS,
            ask_referee=question(run, procedure, latch),
            door=door,
            handle=sensors.handle_view(seen, run.handle_zero, observation.largest_force),
            latch=latch,
            passage=sensors.passage_view(seen),
            topics=topics,
            recorder=recorder,
            disk_free=None if replay else self.pre_start.free_disk(seen),
            evidence=None
            if evidence is None
            else EvidenceView.of(evidence, run.start, self.pre_start.evidence_lasts(seen)),
            faults=tuple(filter(None, problems)),
            provisional=dict(observation.provisional),
            provisional_doubts=dict(observation.provisional_doubts),
            log=at_hand.event_publisher.log.lines,
            events=_newest(result) if result else observation.events,
            result=result,
            result_source=kind if result else None,
            rescoring=rescoring,
            unfinished=unfinished,
            opened=at_hand.opened is not None,
            folder=str(at_hand.folder) if at_hand.folder else None,
            playback=replay.view(result) if replay else None,
            export=export,
            teams=situation.teams,
            plan=plan,
            testbed=self.engine_context.config.testbed,
            competition=self.engine_context.config.competition,
        )


def _newest(result: Result) -> tuple[Event, ...]:
    return tuple(Event(each.time, each.event) for each in result.events[-2 * NEWEST :])


def disk_problem(checks: Iterable[Check]) -> str | None:
    failed = (
        one for one in checks if one.name is CheckName.DISK and one.state is CheckState.FAILED
    )
    return next((f"{check.name}: {check.reason}" for check in failed), None)


def testbed_problem(told: Announcement, run: Run) -> str | None:
    official = run.active and run.setup is not None and not run.setup.practice
    rehearsal = run.setup is not None and is_rehearsal(run.setup.competition)
    if official and told.simulated is not None and not rehearsal:
        return f"the testbed is simulated ({told.simulated}): void this run after its stop"
    return told.problem


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
