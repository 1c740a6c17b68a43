"""What the core cannot know: the time, and what testbed, disk and workers say now."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from madrob_console.common.names import SourceKind
from madrob_console.engine.snapshot import RecorderView
from madrob_console.referee.competition_plan import NO_PLAN, Plan
from madrob_console.referee.evidence import Evidence
from madrob_console.referee.team_list import NO_TEAMS, TeamList
from madrob_console.testbeds.announcement import SILENT, Announcement
from madrob_console.testbeds.source import Source, TopicStatus


@dataclass(frozen=True, slots=True)
class TestbedState:
    """What the source says of the testbed; see `Source`."""

    __test__ = False  # no test

    kind: SourceKind
    label: str
    topics: tuple[TopicStatus, ...] = ()
    announcement: Announcement = SILENT
    sides_problem: str | None = None
    robot_problems: Mapping[str, str] = field(default_factory=dict)
    other_referee: str | None = None

    @classmethod
    def of(cls, source: Source) -> TestbedState:
        return cls(
            source.kind,
            source.label,
            tuple(source.status()),
            source.announcement,
            source.sides_problem,
            source.robot_problems,
            source.other_referee,
        )


@dataclass(frozen=True, slots=True)
class DiskState:
    """The disk of the results.

    Attributes:
        free: bytes; None = unknown, or no answer comes.
        problem: why no recording can begin there, in words; None = not known yet.
        silent: how long it has not answered, s.
        journal_problem, lines: why lines of the journal are not on disk, and how many.
        writing: whether a result is being written.
        late_runs: earlier runs that are in memory alone, and why.
    """

    free: int | None = None
    problem: str | None = None
    silent: float = 0.0
    journal_problem: str | None = None
    lines: int = 0
    writing: bool = False
    late_runs: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class WorkerState:
    """The processes beside the engine, and its recorder.

    Attributes:
        recorder: of the current run.
        recorder_silent: how long the disk has taken nothing of the recording, s.
        dropped: messages that are not in the recording, by topic.
        scoring: why a result is missing or late, in words; empty = all is well.
        hopeless: several tries to score failed: the next run need not wait for the result.
        evidence: what is recorded beside the run; None = nothing is wanted, or there can be none.
    """

    recorder: RecorderView = field(default_factory=lambda: RecorderView("closed"))
    recorder_silent: float = 0.0
    dropped: Mapping[str, int] = field(default_factory=dict)
    scoring: str = ""
    hopeless: bool = False
    evidence: Evidence | None = None


@dataclass(frozen=True, slots=True)
class Now:
    """The moment of an input.

    Attributes:
        time: steady, s since the epoch.
        monotonic: of the machine, s.
        taken: time up to which all messages were taken, s since the epoch: a program that is
            held up makes no topic silent.
        judged: time up to which all messages were judged, s since the epoch.
        unjudged: recorded messages that wait to be judged.
        behind: that the engine is late with messages, in words.
    """

    time: float
    monotonic: float
    taken: float
    judged: float
    testbed: TestbedState
    disk: DiskState = field(default_factory=DiskState)
    workers: WorkerState = field(default_factory=WorkerState)
    unjudged: int = 0
    behind: str | None = None
    teams: TeamList = NO_TEAMS
    plan: Plan = NO_PLAN
