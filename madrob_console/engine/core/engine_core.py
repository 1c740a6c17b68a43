"""The core decides: it takes one input at a time and returns what is to be done.

It waits for nobody and is called by one thread. What it cannot know comes with the input.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import assert_never

from madrob_console.archive.unfinished_runs import Unfinished
from madrob_console.engine.core.acting import Acting
from madrob_console.engine.core.current_run import CurrentRun, ReplayedRun
from madrob_console.engine.core.effects import (
    Effect,
    PlainValue,
    Publish,
    RetryWriting,
)
from madrob_console.engine.core.engine_config import EngineConfig
from madrob_console.engine.core.inputs import (
    CutOff,
    CutOffRunsListed,
    DoAct,
    EngineEnds,
    Input,
    JournalReopened,
    LineWithdrawn,
    LineWritten,
    NumberGivenOut,
    OpenEarlierRun,
    RecordingClosed,
    RecordingOpened,
    ReplayedLine,
    ReplayEnds,
    ResultWritten,
    RunScored,
    Tick,
)
from madrob_console.engine.core.now import Now
from madrob_console.engine.core.observation import Observation
from madrob_console.engine.core.situations import SituationFactory
from madrob_console.engine.core.state_view import shown_state, testbed_problem
from madrob_console.engine.playback import PlaybackView
from madrob_console.engine.snapshot import ExportView, Snapshot
from madrob_console.messages.codec import (
    REFEREE_ELAPSED_TOPIC,
    REFEREE_LEVEL_TOPIC,
    REFEREE_RUNNING_TOPIC,
    REFEREE_STATE_TOPIC,
)
from madrob_console.messages.types import MessageTypes
from madrob_console.referee.acts import Act, Situation
from madrob_console.referee.rebuild import after
from madrob_console.referee.records import FaultKind
from madrob_console.referee.run import Phase
from madrob_console.testbeds.announcement import INFO_TOPIC
from recorder.bag import RawMessage
from scoring.protocol import POST_ROLL

WATCH_PERIOD = 0.1
"""Between two checks of the topics in a run, s."""

ELAPSED_RATE = 10.0
"""How often the time of a run is published, Hz."""

RETRY_PERIOD = 1.5
"""Pause between two tries to write what the disk refused, s."""


class Core:
    """Decides for one testbed, one run after the other; or for the replay of one `recorded` run."""

    def __init__(
        self, config: EngineConfig, types: MessageTypes, recorded: ReplayedRun | None = None
    ) -> None:
        self._effects: list[Effect] = []
        self._watched = self._retried = 0.0
        self._published: dict[str, tuple[int, bool | float]] = {}
        self._unfinished: tuple[Unfinished, ...] = ()
        self.observation = Observation(config.mappings, config.thresholds, config.limits, types)
        self.current_run = CurrentRun(self.observation, config.limits.lost, self._effects, recorded)
        self._situations = SituationFactory(config, self.observation, self.current_run)
        self._acting = Acting(self._situations, self.current_run, self._effects)

    @property
    def records(self) -> bool:
        """Whether messages that come now belong to the recording."""
        return self.current_run.state.recording and not self.current_run.state.over

    @property
    def waiting(self) -> type[Act] | None:
        """The act that waits for the disk. From any thread."""
        return self._acting.waiting

    def observe(self, message: RawMessage, *, recorded: bool, shown: bool) -> None:
        """Take a message; what follows from it is decided by the next `Tick`."""
        self.observation.receive(message, recorded=recorded, shown=shown)

    def situation(self, now: Now) -> Situation:
        return self._situations.at(now)

    def opening_refusal(self, now: Now) -> str | None:
        """Why no earlier run can be opened now, in words."""
        return self._acting.opening_refusal(now)

    def step(self, happened: Input, now: Now) -> Sequence[Effect]:
        """Decide what follows from an input: the state after it, and the effects in order."""
        self._take(happened, now)
        self._advance(now)
        effects = tuple(self._effects)
        self._effects.clear()
        return effects

    def _take(self, happened: Input, now: Now) -> None:  # noqa: C901  one case an input
        current, acting = self.current_run, self._acting
        match happened:
            case Tick():
                pass  # see `_advance`
            case DoAct():
                acting.do(happened, now)
            case OpenEarlierRun():
                acting.open_earlier(happened, now)
            case LineWritten():
                acting.take_written(happened, now)
            case LineWithdrawn():
                acting.take_withdrawal(happened)
            case NumberGivenOut():
                acting.take_number(happened, now)
            case RecordingOpened():
                acting.take_recording(happened, now)
            case JournalReopened():
                acting.take_journal(happened, now)
                results, opened = self._situations.config.results, current.state.folder
                others = (run for run in self._unfinished if results / run.folder != opened)
                self._unfinished = tuple(others)
            case RecordingClosed():
                current.note_recording(happened, now)
            case CutOffRunsListed(runs):
                self._unfinished = runs
            case RunScored():
                current.take_result(happened)
            case ResultWritten():
                current.note_result(happened, now)
            case EngineEnds():
                acting.withdraw("the engine ended", now)
            case CutOff(reason):
                if current.run.active:
                    current.interrupt(reason, now)
                if current.state.recording:
                    current.finish(now)
            case ReplayedLine(entry):
                self._advance(now)
                run = after(current.run, entry)
                current.write(entry)
                current.change(run, (), now)
            case ReplayEnds():
                self._advance(now)
                current.end_replay(now)
            case _:
                assert_never(happened)

    def _advance(self, now: Now) -> None:
        """What the time brings."""
        current = self.current_run
        self._acting.withdraw_overdue(now)
        if not 0 <= now.time - self._watched < WATCH_PERIOD:
            self._watched = now.time
            self._watch(now)
        current.advance(now)
        self._publish_values(now.time)
        state = current.state
        over = state.decided is not None and now.time >= state.decided + POST_ROLL
        if over and state.recording:
            # nothing more is recorded; what is, is judged
            state.over |= now.unjudged > 0
            if not now.unjudged:
                current.finish(now)
        self._retry_writing(now)

    def _publish_values(self, time: float) -> None:
        """Publish the plain values that have changed, and all of each new run."""
        run, generation = self.current_run.run, self.current_run.generation
        running = run.phase is Phase.RUNNING
        values: dict[str, bool | float] = {
            REFEREE_RUNNING_TOPIC: running,
            REFEREE_LEVEL_TOPIC: self.current_run.level,
        }
        if running and run.start is not None:
            tenths = max(0.0, (time - run.start) * ELAPSED_RATE // 1)
            values[REFEREE_ELAPSED_TOPIC] = tenths / ELAPSED_RATE
        for topic, value in values.items():
            if self._published.get(topic) != (generation, value):
                self._published[topic] = generation, value
                self._effects.append(Publish(PlainValue(topic, value)))

    def _watch(self, now: Now) -> None:
        current = self.current_run
        if not current.state.recording:
            return
        current.note_faults(self._faults(now), now)
        if now.workers.evidence is not None:
            current.note_evidence(now.workers.evidence, now)

    def _faults(self, now: Now) -> Mapping[tuple[str, FaultKind], str]:
        testbed = now.testbed
        faults = dict(self.observation.sensors.faults(testbed.topics, now.taken))
        others = {
            (REFEREE_STATE_TOPIC, FaultKind.SEVERAL_PUBLISHERS): testbed.other_referee,
            (INFO_TOPIC, FaultKind.ANNOUNCEMENT): testbed_problem(
                testbed.announcement, self.current_run.run
            ),
            ("engine", FaultKind.BEHIND): now.behind,
            **{(topic, FaultKind.SOURCE): why for topic, why in testbed.robot_problems.items()},
        }
        return faults | {key: words for key, words in others.items() if words is not None}

    def _retry_writing(self, now: Now) -> None:
        if 0 <= now.time - self._retried < RETRY_PERIOD:
            return
        self._retried = now.time
        result, active = self.current_run.state.result, self.current_run.run.active
        self._effects.append(RetryWriting(results=not active))
        if not active and not now.disk.writing and result.problem and result.awaited is None:
            self.current_run.score(now)  # files that could not be read may be readable now

    def snapshot(
        self,
        now: Now,
        export: ExportView | None = None,
        others: Iterable[str | None] = (),
        playback: PlaybackView | None = None,
    ) -> Snapshot:
        """Everything that a screen shows; `others` is what is wrong around the engine, in words."""
        return shown_state(
            now,
            self._situations.at(now),
            self.current_run,
            self.observation,
            self._acting.refusals(now),
            self._unfinished,
            export,
            others,
            playback,
        )
