"""The whole of `result.json`: what stands in it, and the JSON schema that is published with it.

Its parts are the types that scoring and the referee work with; here stands only what is around
them. A key may be added to a format; one that is dropped, renamed or means something else makes a
new one (`RESULT_FORMAT`).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

import msgspec

from madrob_console.archive.file_digests import FileDigest
from madrob_console.archive.folders import RESULT_FORMAT
from madrob_console.common.names import SourceKind, is_rehearsal
from madrob_console.messages.mapping import TopicMapping
from madrob_console.referee.evidence import Evidence
from madrob_console.referee.flags import Flag
from madrob_console.referee.protests import Protest, open_protests
from madrob_console.referee.records import (
    AcceptedDoubts,
    Closure,
    Correction,
    FalseStart,
    Incident,
    JournalMark,
    Note,
    Reissuing,
    TakenBack,
    TestbedFault,
    Voiding,
    Waiver,
)
from madrob_console.referee.run import VALID_OUTCOMES
from madrob_console.referee.run_setup import RunSetup
from scoring.indicator_table import WITH_THE_START
from scoring.procedure import Ruling
from scoring.protocol import Signal, Step, Thresholds
from scoring.rest import HandleRest
from scoring.result import Libraries, Result

SCHEMA_FILE = f"madrob_result_schema_{RESULT_FORMAT}.json"

MANUAL_START = f"{WITH_THE_START} include the delay of the manual start"


@dataclass(frozen=True, kw_only=True)
class Heading:
    """Which run a result is of: the keys before those of the result itself.

    Attributes:
        format: version of this layout.
        software: what wrote it, with its version.
        competition: its name.
        source: where the messages came from; official are runs of `ros` that are no practice.
        issue: number of the result's issue; a final result that is re-issued gets the next.
        subject: the robot's number, 1 to 999.
        team: the team's name.
        run_number: the repetition, 1 to 999.
        condition_number: 1 to 20, as EUROBENCH counts.
        setup: what was set for the run.
        run_id: which run of all testbeds it is: a UUID of version 7, made at the set-up.
        testbed: the name of the testbed.
        thresholds: the testbed's numbers, of which the events and the doubts come.
    """

    format: Literal[1]
    software: str
    competition: str
    source: SourceKind
    issue: int
    subject: int
    team: str
    run_number: int
    condition_number: int
    setup: RunSetup
    run_id: str = ""
    testbed: str = ""
    thresholds: Thresholds


@dataclass(frozen=True, kw_only=True)
class ResultDocument(Result, Heading):
    """The result of one run of the MADROB benchmark.

    Attributes:
        waivers, false_starts, incidents, rulings, notes: what happened and what the referee said,
            each in the order in which it came.
        closure: how the result was finalised; null = it is not final.
        faults: of the testbed while it was recorded.
        voided: the referee says that the run counts nowhere; null = it counts as `outcome` says.
        corrections: of the set-up, which is as it is after them; the folder and the files in it are
            named after the first one's `before`.
        accepted_doubts: which doubts on the indicators the referee lets stand.
        protests: of teams against the result, open and closed ones, by their numbers.
        taken_back: what the referee decided and took back.
        reissues: why the result has more than one issue, oldest first; of each earlier issue
            `result_issue_N.json` has what it said.
        remark: on the times.
        robot_start: when the robot said that it set out, s since the epoch, by reception; null = it
            did not say so.
        files: name -> digest and size, of the recording and the data files.
        files_left_out: which of them have no digest and why, in words.
        journal: of what journal it was made; a result that another journal lies beside is out of
            date.
        flags: what a decision on the run hangs on, and what is undecided, the heaviest first.
        evidence: what was recorded beside the testbed's topics, and what was lost of it; nothing is
            scored from it. null = nothing was wanted.
        zero_samples: those behind `handle_zero`, by the time of reception; null where it was never
            set.
        mappings: where the testbed published each signal, and how its messages were read.
        libraries: what computed it; the last digits hang on them (section 11).
    """

    waivers: tuple[Waiver, ...]
    false_starts: tuple[FalseStart, ...]
    incidents: tuple[Incident, ...]
    rulings: tuple[Ruling, ...]
    notes: tuple[Note, ...]
    closure: Closure | None
    remark: str
    flags: tuple[Flag, ...]
    faults: tuple[TestbedFault, ...] = ()
    voided: Voiding | None = None
    corrections: tuple[Correction, ...] = ()
    accepted_doubts: tuple[AcceptedDoubts, ...] = ()
    protests: tuple[Protest, ...] = ()
    taken_back: tuple[TakenBack, ...] = ()
    reissues: tuple[Reissuing, ...] = ()
    files: dict[str, FileDigest] = field(default_factory=dict)
    files_left_out: tuple[str, ...] = ()
    journal: JournalMark
    evidence: Evidence | None = None
    zero_samples: HandleRest | None = None
    robot_start: float | None = None
    mappings: tuple[TopicMapping, ...]
    libraries: Libraries

    @property
    def steps_done(self) -> dict[Step, float]:
        return {step.step: step.final for step in self.steps if step.final is not None}

    @property
    def rate(self) -> float | None:
        """Sampling rate of the door's angle, Hz; None where it does not say."""
        return next(
            (signal.rate for signal in self.quality.signals if signal.signal is Signal.DOOR), None
        )

    @property
    def open_protest(self) -> Protest | None:
        return next(iter(open_protests(self.protests)), None)

    @property
    def instant_in_question(self) -> float | None:
        """The instant of the open protest, else of the last one, s from the start."""
        of = self.open_protest or (self.protests[-1] if self.protests else None)
        return None if of is None or of.at is None else of.at - self.start

    @property
    def valid(self) -> bool:
        """Whether its indicators count (protocol section 2)."""
        return self.outcome in VALID_OUTCOMES and self.voided is None

    @property
    def why_invalid(self) -> str:
        """The referee's or the machine's reason; empty where it is valid."""
        if self.voided is not None:
            return self.voided.reason
        return "" if self.valid else self.outcome_reason

    @property
    def practice(self) -> bool:
        """Whether it counts for nothing; of a simulated testbed only a rehearsal's runs count."""
        simulated = self.source is SourceKind.SIMULATED and not is_rehearsal(self.competition)
        return self.setup.practice or simulated


def result_schema() -> dict[str, Any]:
    """Return the JSON schema (draft 2020-12) of `result.json`."""
    return msgspec.json.schema(ResultDocument)


def schema_text(schema: dict[str, Any]) -> bytes:
    """Return a schema as a file has it."""
    return msgspec.json.format(msgspec.json.encode(schema), indent=2) + b"\n"
