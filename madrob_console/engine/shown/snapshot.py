"""What the engine shows: immutable, typed, plain data that can cross a socket."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

from madrob_console.archive.unfinished import Unfinished
from madrob_console.engine.shown.playback import PlaybackView
from madrob_console.engine.shown.requests import Role, TakeOver
from madrob_console.kinds import SourceKind
from madrob_console.referee.health import Freshness
from madrob_console.referee.journal import Origin
from madrob_console.referee.preflight import Check
from madrob_console.referee.run import Run
from scoring.procedure import StepRecord
from scoring.protocol import Side
from scoring.result import Result


@dataclass(frozen=True, slots=True)
class TopicView:
    """One testbed topic, live.

    Attributes:
        topic, type: its names.
        publishers: matched now.
        freshness, age: state and age (s) of the newest message; age None = never seen.
        rate: messages a second over the last 2 s; None = unknown.
        received, lost, dropped: counts since the source was opened; lost None = unknown.
        optional: whether the testbed works without it.
        problem: what is wrong with it, in words; None = nothing.
    """

    topic: str
    type: str
    publishers: int
    freshness: Freshness
    age: float | None
    rate: float | None
    received: int
    lost: int | None
    dropped: int
    optional: bool
    problem: str | None


@dataclass(frozen=True, slots=True)
class SensorView:
    """One of the ten used passage sensors.

    Attributes:
        side, index: its place; index 0 is the farthest from the hinge.
        occupied: something is under it; None = not known yet. A masked one keeps its state.
        masked: the panel passes under it now, its reading is ignored.
        height: of what is under it, m; None = nothing, no reading or stale.
        freshness: of its strip.
    """

    side: Side
    index: int
    occupied: bool | None
    masked: bool
    height: float | None
    freshness: Freshness


@dataclass(frozen=True, slots=True)
class DoorView:
    """The panel. `angle` in rad; None when there is no fresh value."""

    angle: float | None
    is_open: bool | None
    freshness: Freshness
    closed_angle: float


@dataclass(frozen=True, slots=True)
class HandleView:
    """The handle. Forces in N; `force` is raw and None when there is no fresh value."""

    force: float | None
    zero: float
    touch_force: float
    maximum: float | None
    freshness: Freshness


@dataclass(frozen=True, slots=True)
class LatchView:
    """The optional latch. `engaged` None when there is no value; freshness NEVER without one."""

    engaged: bool | None
    freshness: Freshness


@dataclass(frozen=True, slots=True)
class RecorderView:
    """The recorder.

    Attributes:
        state: `closed`, `recording`, `failed` or `finished`.
        messages, size, dropped: written, bytes on disk, not written.
        problem: in words; None = nothing.
    """

    state: str
    messages: int = 0
    size: int = 0
    dropped: int = 0
    problem: str | None = None


class Weight(StrEnum):
    """How much a line of the log wants to be seen."""

    PLAIN = "plain"
    NOTICE = "notice"
    ALARM = "alarm"


@dataclass(frozen=True, slots=True)
class LogLine:
    """One line of the event log.

    Attributes:
        number: counts up from 0 over the life of the engine; a screen asks for what is new.
        time: s since the epoch.
        relative: s since the start (negative in the countdown); None outside a run.
        origin: who made it happen.
        text: in words, safe for a terminal.
        weight: how much it wants to be seen.
    """

    number: int
    time: float
    relative: float | None
    origin: Origin
    text: str
    weight: Weight = Weight.PLAIN


@dataclass(frozen=True, slots=True)
class ExportView:
    """The last export of a team's runs; with neither path nor problem it is being made.

    Attributes:
        subject: the team's number.
        path: of the zip.
        problem: why there is none, or what is missing in it, in words.
    """

    subject: int
    path: str = ""
    problem: str = ""


@dataclass(frozen=True, slots=True)
class RightToAct:
    """Whether one screen may act.

    Attributes:
        role: what the screen is there for.
        holder: the screen that has the right to act instead; empty = this one has it, or would
            get it with its next command.
    """

    role: Role = Role.REFEREE
    holder: str = ""

    @property
    def refusal(self) -> str | None:
        """Why this screen may not act, in words; None when it may."""
        if self.role is Role.WATCH:
            return "this screen only watches: `madrob console` can act"
        return f"{self.holder} has the right to act: t takes it over" if self.holder else None


@dataclass(frozen=True, slots=True)
class Snapshot:
    """Everything a screen shows, at one instant.

    Attributes:
        time: steady time, s since the epoch.
        source_kind, source_label: `LIVE ros domain 0`, `SIMULATED nominal`, `REPLAY <name>`.
        sides_problem: why the sides must be set by hand; None = the testbed confirmed them.
        run: the referee's state of the run.
        elapsed: s since the start; negative in the countdown; the execution time once stopped;
            None outside a run.
        remaining: s to the timeout while running; s to the start in the countdown; else None.
        settling: whether step 6 waits for the settle time.
        checks: the pre-start checks.
        refusals: act name -> why it is not possible now; a missing name is possible. Only acts
            that can be judged without their arguments.
        steps: the six steps as they stand, live or final.
        ask_referee: a question that only the referee can answer, in words.
        door, handle, latch, passage, topics, recorder: the sensors and the recorder; passage is
            ten sensors, cw 0..4 then ccw 0..4.
        disk_free: bytes; None = unknown.
        faults: what is wrong now, one line each; they stay until they are gone.
        provisional: indicator file name -> value (s) of the time indicators known so far.
        log: the last 200 lines.
        result: once it is written to disk.
        result_source: what the result was measured on; None without one.
        unfinished: runs that were cut off and wait for a decision, oldest first.
        opened: whether it is an earlier run, opened again.
        folder: the run folder as text, once it exists.
        playback: where a replay stands; None for anything else.
        export: the last export of a team's runs; None before the first.
        right: of the screen that is shown this; all else is the same for all screens.
    """

    time: float
    source_kind: SourceKind
    source_label: str
    sides_problem: str | None
    run: Run
    elapsed: float | None
    remaining: float | None
    settling: bool
    checks: tuple[Check, ...]
    refusals: dict[str, str]
    steps: tuple[StepRecord, ...]
    ask_referee: str | None
    door: DoorView
    handle: HandleView
    latch: LatchView
    passage: tuple[SensorView, ...]
    topics: tuple[TopicView, ...]
    recorder: RecorderView
    disk_free: int | None
    faults: tuple[str, ...]
    provisional: dict[str, float] = field(default_factory=dict)
    log: tuple[LogLine, ...] = ()
    result: Result | None = None
    result_source: SourceKind | None = None
    unfinished: tuple[Unfinished, ...] = ()
    opened: bool = False
    folder: str | None = None
    playback: PlaybackView | None = None
    export: ExportView | None = None
    right: RightToAct = RightToAct()

    def refusal(self, name: str) -> str | None:
        """Why an act or command of that name is not possible now on this screen, in words."""
        refused = self.right.refusal
        if name != TakeOver.name:
            return refused or self.refusals.get(name)
        if self.right.role is Role.WATCH:
            return refused
        return None if self.right.holder else "this console has the right to act"

    @property
    def all_faults(self) -> tuple[str, ...]:
        """What is wrong, first of all that another screen has the right to act."""
        refused = self.right.refusal
        if refused is None or self.right.role is Role.WATCH:
            return self.faults
        return (refused, *self.faults)
