"""What a bag says of its run, so that the bag alone can be scored again.

It stands in the bag as the metadata record `madrob_run`; what happens afterwards stands in the
journal, on `/madrob/referee/event`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import msgspec

from madrob_console.archive.digests import run_id_at
from madrob_console.errors import MadrobError
from madrob_console.kinds import SourceKind
from madrob_console.messages.codec import TopicMapping
from madrob_console.referee.run import Run
from madrob_console.referee.run_setup import RunSetup
from scoring.evaluate import Assessment, LiveAssessment
from scoring.protocol import Thresholds
from scoring.rest import HandleRest
from scoring.rulesets import RulesetName, ruleset

RECORD_NAME = "madrob_run"
"""Name of the metadata record."""

_KEY = "run"

A = TypeVar("A", bound=LiveAssessment)


@dataclass(frozen=True, slots=True)
class RunLabel:
    """Whose run it is, and which of all: what tables for programs join by.

    Attributes:
        subject: the robot's number; None = not known.
        team: the team's name; empty where unknown.
        condition: its number.
        run: the repetition; None = not known.
        run_id: which run of all testbeds it is (section 2); empty where unknown.
        testbed: the name of the testbed; empty where it had none.
        competition: its name; empty where none was set.
    """

    subject: int | None
    team: str
    condition: int
    run: int | None
    run_id: str = ""
    testbed: str = ""
    competition: str = ""


@dataclass(frozen=True, slots=True)
class RunRecord:
    """Everything set for a run when its recording was opened.

    Attributes:
        setup: subject, condition, start pose and so on.
        handle_zero: N.
        thresholds: the testbed's numbers.
        mappings: which topic carried which signal.
        source: where the messages came from; `simulated` also where that testbed spoke over ROS.
        competition: its name.
        version: of the software that recorded.
        zero_samples: behind the handle zero; None = it was never set, or by an earlier version.
    """

    setup: RunSetup
    handle_zero: float
    thresholds: Thresholds
    mappings: tuple[TopicMapping, ...]
    source: SourceKind
    competition: str
    version: str
    zero_samples: HandleRest | None = None

    def corrected(self, run: Run) -> RunRecord:
        """With the set-up of the run as it stands, after what was corrected."""
        return self if run.setup is None else replace(self, setup=run.setup)

    def label(self, recording: Path) -> RunLabel:
        """Whose run it is.

        Args:
            recording: its bag or its folder, which identifies a run of an earlier version.
        """
        setup = self.setup
        return RunLabel(
            setup.subject,
            setup.team,
            setup.condition.number,
            setup.run_number,
            setup.run_id or run_id_at(recording),
            setup.testbed,
            self.competition,
        )

    def to_metadata(self) -> dict[str, str]:
        """The record as MCAP metadata."""
        return {_KEY: msgspec.json.encode(self).decode()}

    @classmethod
    def from_metadata(cls, metadata: dict[str, str]) -> RunRecord:
        """The record in a bag's metadata.

        Raises:
            MadrobError: it is damaged, or from a version with other fields.
        """
        try:
            return msgspec.json.decode(metadata[_KEY], type=cls)
        except KeyError:
            raise MadrobError(f"metadata record {RECORD_NAME} has no '{_KEY}'") from None
        except (msgspec.MsgspecError, UnicodeDecodeError) as error:
            raise MadrobError(f"metadata record {RECORD_NAME} is damaged: {error}") from None

    def assessment(self, start: float, rules: RulesetName | None = None) -> Assessment:
        """A new assessment of the run.

        Args:
            start: its (planned) start, s since the epoch.
            rules: another ruleset than the run's.
        """
        return self.assessed_by(Assessment, start, rules)

    def assessed_by(self, kind: type[A], start: float, rules: RulesetName | None = None) -> A:
        """A new assessment of some kind, likewise."""
        return kind(
            self.setup.condition,
            start,
            ruleset=ruleset(rules or self.setup.ruleset),
            thresholds=self.thresholds,
            lock_detection=self.setup.lock_detection,
            handle_zero=self.handle_zero,
            stopped_by=ruleset(self.setup.ruleset),
        )


def demand_record(records: Mapping[str, object], path: Path) -> None:
    """A bag with these metadata records is of a run.

    Raises:
        MadrobError: it is of none.
    """
    if RECORD_NAME not in records:
        raise MadrobError(f"{path}: a bag without a MADROB run cannot be replayed")
