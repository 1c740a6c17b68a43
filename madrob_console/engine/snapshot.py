"""What the engine shows: immutable, typed, plain data that can cross a socket."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

import msgspec

from madrob_console.archive.unfinished_runs import Unfinished
from madrob_console.common.names import REHEARSAL, SourceKind, is_rehearsal
from madrob_console.engine.playback import PlaybackView
from madrob_console.engine.requests import Role, TakeOver
from madrob_console.referee.acts import Abort
from madrob_console.referee.checks import Check
from madrob_console.referee.competition_plan import NO_PLAN, Plan
from madrob_console.referee.evidence import Evidence
from madrob_console.referee.flags import NO_INDICATORS, Flag, flags
from madrob_console.referee.journal import Origin
from madrob_console.referee.run import Run
from madrob_console.referee.team_list import NO_TEAMS, TeamList
from madrob_console.referee.topic_health import Freshness
from scoring.indicator_table import IndicatorName
from scoring.procedure import StepRecord
from scoring.protocol import Event, Side
from scoring.result import Indicator, Result


@dataclass(frozen=True, slots=True)
class TopicView:
    """One testbed topic, live.

    Attributes:
        publishers: matched now.
        freshness, age: state and age (s) of the newest message; age None = never seen.
        rate: messages a second over the last 2 s.
        received, lost, dropped: counts since the source was opened; lost None = unknown.
        optional: whether the testbed works without it.
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
        index: 0 is the farthest from the hinge.
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


class Extent(msgspec.Struct, frozen=True, array_like=True, gc=False):  # hundreds cross a socket
    """The lowest and the highest reading around `time`, s since the epoch."""

    time: float
    low: float
    high: float


Recent = tuple[tuple[Extent, ...], ...]
"""The last 20 s of a signal, in stretches between which readings were missing."""


@dataclass(frozen=True, slots=True)
class DoorView:
    """The panel. `angle` in rad; None when there is no fresh value."""

    angle: float | None
    is_open: bool | None
    freshness: Freshness
    closed_angle: float
    recent: Recent = ()


@dataclass(frozen=True, slots=True)
class HandleView:
    """The handle. Forces in N; `force` and `recent` are raw; None when there is no fresh value."""

    force: float | None
    zero: float
    touch_force: float
    maximum: float | None
    freshness: Freshness
    recent: Recent = ()


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
    """

    state: str
    messages: int = 0
    size: int = 0
    dropped: int = 0
    problem: str | None = None


class Weight(StrEnum):
    """How noticeable a line of the log should be."""

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
        text: in words, safe for a terminal.
    """

    number: int
    time: float
    relative: float | None
    origin: Origin
    text: str
    weight: Weight = Weight.PLAIN


@dataclass(frozen=True, slots=True)
class ExportView:
    """The last export of a team's runs or a dossier; under way without path and problem.

    Attributes:
        subject: the team's number; 0 for a dossier.
        problem: why there is none, or what is missing in it, in words.
        dossier: the run's folder, of a dossier; empty = it is of a team.
    """

    subject: int
    path: str = ""
    problem: str = ""
    dossier: str = ""

    @property
    def what(self) -> str:
        return f"the dossier of {self.dossier}" if self.dossier else f"subject {self.subject}"


@dataclass(frozen=True, slots=True)
class RightToAct:
    """Whether one screen may act.

    Attributes:
        holder: the screen that has the right to act instead; empty = this one has it, or would
            get it with its next command.
        free: no screen has it: the one that had it has gone.
    """

    role: Role = Role.REFEREE
    holder: str = ""
    free: bool = False

    @property
    def only_watches(self) -> bool:
        """Whether nobody can act here: keys need not be shown."""
        return self.role is Role.WATCH

    @property
    def refusal(self) -> str | None:
        if self.only_watches:
            return "`madrob console` can act, this screen only watches"
        return (
            f"{self.holder} has the right to act; here an act asks before it takes it over"
            if self.holder
            else None
        )


@dataclass(frozen=True, slots=True)
class Pulse:
    """How fresh the rest is and what waits for the disk, measured when it is sent.

    All fields are empty while nothing is wrong; times are whole seconds, so that it changes rarely.

    Attributes:
        gone: why the engine sends nothing more, in words; empty = it may.
        server: silence of the engine's process, s.
        core: standstill of its core, s.
        disk: silence of the disk, s.
        unwritten: lines of the journal that are not on disk after a second.
        refused: what the disk refuses of the current run, in words; empty = nothing.
        waiting: how many earlier runs are not on disk.
        writing: the act that takes effect when it is on disk; empty = none.
    """

    gone: str = ""
    server: int = 0
    core: int = 0
    disk: int = 0
    unwritten: int = 0
    refused: str = ""
    waiting: int = 0
    writing: str = ""

    @property
    def unsaved(self) -> bool:
        return bool(self.unwritten or self.refused)

    @property
    def stale(self) -> bool:
        return bool(self.gone or self.server or self.core)

    @property
    def words(self) -> str | None:
        if self.gone:
            return self.gone
        if self.server:
            return f"the engine is silent for {self.server} s"
        if self.core:
            return f"the engine has not moved for {self.core} s"
        if self.disk:
            return f"disk silent for {self.disk} s: nothing new starts"
        return None


def label_of(source: str, *, practice: bool, rehearsal: bool) -> str:
    """A source's label with the kind of run: `LIVE ros domain 0`, or `PRACTICE ros domain 0`."""
    rest = source.removeprefix("LIVE ")
    kind = "PRACTICE" if practice and (rest != source or rehearsal) else ""
    words = (REHEARSAL if rehearsal else "", kind, rest if rehearsal or kind else source)
    return " ".join(filter(None, words))


@dataclass(frozen=True, slots=True)
class Snapshot:
    """Everything a screen shows, at one instant.

    Attributes:
        time: steady time, s since the epoch.
        source_kind, source_label: `LIVE ros domain 0`, `SIMULATED nominal`, `REPLAY <name>`.
        simulated: what the simulated testbed plays; None = a real one, or a replay.
        sides_problem: why the sides must be set by hand; None = the testbed confirmed them.
        elapsed: s since the start; negative in the countdown; the execution time once stopped;
            None outside a run.
        remaining: s to the timeout while running; s to the start in the countdown; else None.
        settling: whether step 6 waits for the settle time.
        refusals: act name -> why it is not possible now; a missing name is possible. Only acts
            that can be judged without their arguments.
        steps: the six steps, live or final.
        ask_referee: a question that only the referee can answer, in words.
        passage: ten sensors, cw 0..4 then ccw 0..4.
        disk_free: bytes.
        faults: what is wrong now, one line each, what costs the run most first; they stay until
            they are gone.
        provisional: indicator file name -> value (s) of the time indicators known so far.
        provisional_doubts: indicator file name -> why its value may be wrong, as far as known.
        log: the last 200 lines.
        events: the newest of the current run.
        result: once it is written to disk; none while another one replaces it.
        rescoring: whether the result is outdated, and the next one takes a while.
        result_source: what the result was measured on.
        unfinished: runs that were cut off and wait for a decision, oldest first.
        plan: of the competition; how much of it is done is asked for (`GivePlan`).
        testbed: name of the engine's testbed.
        competition: of the engine's runs, by its own settings.
        right: of this screen; all else is the same for all screens.
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
    provisional_doubts: dict[str, tuple[str, ...]] = field(default_factory=dict)
    log: tuple[LogLine, ...] = ()
    events: tuple[Event, ...] = ()
    result: Result | None = None
    result_source: SourceKind | None = None
    simulated: str | None = None
    evidence: Evidence | None = None
    rescoring: bool = False
    unfinished: tuple[Unfinished, ...] = ()
    opened: bool = False
    folder: str | None = None
    playback: PlaybackView | None = None
    export: ExportView | None = None
    teams: TeamList = NO_TEAMS
    plan: Plan = NO_PLAN
    testbed: str = ""
    competition: str = ""
    right: RightToAct = RightToAct()
    pulse: Pulse = Pulse()

    @property
    def rehearsal(self) -> bool:
        """Whether the engine's competition, or the current run's, is a rehearsal (section 2)."""
        of_run = "" if self.run.setup is None else self.run.setup.competition
        return is_rehearsal(self.competition) or is_rehearsal(of_run)

    @property
    def only_practice(self) -> bool:
        """Whether every run that is set up now is practice."""
        return self.simulated is not None and not is_rehearsal(self.competition)

    @property
    def practice(self) -> bool:
        """Whether the current run is practice, or the next one will be (protocol section 2)."""
        setup = self.run.setup
        if setup is None:
            return self.only_practice
        simulated = self.result_source is SourceKind.SIMULATED and not self.rehearsal
        return setup.practice or simulated

    @property
    def label(self) -> str:
        """The source of the messages, for people; a rehearsal and practice are named so."""
        return label_of(self.source_label, practice=self.practice, rehearsal=self.rehearsal)

    def refusal(self, name: str) -> str | None:
        refused = self.pulse.gone or self.right.refusal
        if name == Abort.name and not self.right.only_watches:  # what it asks takes the right over
            refused = self.pulse.gone
        if name != TakeOver.name or self.pulse.gone:
            return refused or self.refusals.get(name)
        if self.right.role is Role.WATCH:
            return refused
        return None if self.right.holder else "this console has the right to act"

    @property
    def indicators(self) -> Mapping[IndicatorName, Indicator]:
        return NO_INDICATORS if self.result is None else self.result.indicators

    @property
    def flags(self) -> tuple[Flag, ...]:
        """Points that a decision on the run depends on, the most serious first."""
        if (result := self.result) is None:
            return flags(self.run, self.steps, self.result_source)
        return flags(self.run, result.steps, self.result_source, result.quality, result.indicators)

    @property
    def pulse_words(self) -> str | None:
        """What is wrong with its freshness, and what still works; None while nothing is wrong."""
        words = self.pulse.words
        if words and self.run.active and not self.pulse.stale:
            return f"{words}; the clock runs, abort works"
        return words

    @property
    def notice(self) -> str | None:
        """Says that another screen may act, no fault; None for a screen that only watches."""
        silent = self.right.only_watches or self.pulse.gone  # then there is no right to take
        return None if silent else self.right.refusal

    @property
    def all_faults(self) -> tuple[str, ...]:
        return (*filter(None, (self.pulse_words,)), *self.faults)
