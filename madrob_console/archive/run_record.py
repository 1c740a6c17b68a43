"""What a bag says of its run.

It stands in the bag as the metadata record `madrob_run`; what happens afterwards stands in the
journal, on `/madrob/referee/event`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce

import msgspec

from madrob_console.archive.folders import JOURNAL_FILE
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import SourceKind, is_rehearsal
from madrob_console.common.stored_json import decode
from madrob_console.messages.mapping import DEFAULT_MAPPINGS, TopicMapping
from madrob_console.referee.journal import Entry
from madrob_console.referee.rebuild import after
from madrob_console.referee.run import Run
from madrob_console.referee.run_setup import RunSetup
from scoring.assessment import Assessment
from scoring.indicator_table import ruleset
from scoring.protocol import Thresholds
from scoring.rest import HandleRest

RECORD_NAME = "madrob_run"

_KEY = "run"


@dataclass(frozen=True, slots=True)
class RunLabel:
    """Whose run it is, as tables for programs name it; empty or None where unknown.

    `run` is the repetition, `run_id` unique over all testbeds (section 2).
    """

    subject: int | None
    team: str
    condition: int
    run: int | None
    run_id: str = ""
    testbed: str = ""
    competition: str = ""

    @property
    def rehearsal(self) -> bool:
        return is_rehearsal(self.competition)


@dataclass(frozen=True, slots=True)
class RunRecord:
    """Everything set for a run when its recording was opened; `handle_zero` in N.

    `source` is `simulated` also where that testbed spoke over ROS. `version` is the recording
    software's. `zero_samples` None = the zero was never set.
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
        return self if run.setup is None else replace(self, setup=run.setup)

    @property
    def label(self) -> RunLabel:
        setup = self.setup
        return RunLabel(
            setup.subject,
            setup.team,
            setup.condition.number,
            setup.run_number,
            setup.run_id,
            setup.testbed,
            self.competition,
        )

    def to_metadata(self) -> dict[str, str]:
        return {_KEY: msgspec.json.encode(self).decode()}

    @classmethod
    def from_metadata(cls, metadata: dict[str, str]) -> RunRecord:
        try:
            return decode(metadata[_KEY], cls)
        except KeyError:
            raise MadrobError(f"metadata record {RECORD_NAME} has no '{_KEY}'") from None
        except MadrobError as error:
            words = f"metadata record {RECORD_NAME} is damaged: {error}"
            raise MadrobError(f"{words}: use the madrob-console that recorded it") from None

    def assessment(self, start: float, rules: str | None = None) -> Assessment:
        """`start` is the (planned) start, s since the epoch; `rules` None = the run's own."""
        return Assessment(
            self.setup.condition,
            start,
            ruleset=ruleset(rules or self.setup.ruleset),
            thresholds=self.thresholds,
            lock_detection=self.setup.lock_detection,
            handle_zero=self.handle_zero,
        )


_LOST = f"its record {RECORD_NAME} was lost (converted?)"


def record_from(entries: Sequence[Entry]) -> tuple[RunRecord, str]:
    """The record of a run whose bag has lost it, by its journal; and the words that say so.

    Raises MadrobError where no set-up is there.
    """
    if not entries:
        raise MadrobError("a bag without a MADROB run: score and replay need one")
    run = reduce(after, entries, Run())
    if run.setup is None:
        raise MadrobError(f"{_LOST}: score the original bag, or put its {JOURNAL_FILE} here")
    record = RunRecord(
        run.setup,
        run.handle_zero,
        Thresholds(),
        tuple(mapping.limited() for mapping in DEFAULT_MAPPINGS),
        SourceKind.ROS,
        run.setup.competition,
        version="",
        zero_samples=run.zero_samples,
    )
    zero = "" if run.zero_samples else ", no handle zero"
    return record, f"{_LOST}: set-up from its journal, default topics and thresholds{zero}"
