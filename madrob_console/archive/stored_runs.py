"""Reads the results of many runs, stored or fresh, one after the other, for tables."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from hashlib import sha256
from pathlib import Path

import msgspec

from madrob_console.archive.folders import PRACTICE_FOLDER, RESULT_FILE, parse_folder_name
from madrob_console.archive.history import misplaced
from madrob_console.archive.journal_agreement import disagreement, out_of_date
from madrob_console.archive.result_document import ResultDocument
from madrob_console.archive.result_reader import UnusableResultError, read_result
from madrob_console.archive.run_journal import UnusableJournalError
from madrob_console.archive.run_paths import RunPath, RunPlace
from madrob_console.archive.run_record import RunLabel
from madrob_console.common.errors import MadrobError
from madrob_console.referee.flags import undecided
from scoring.protocol import Condition

_SHORT = 16
"""Digits of a digest that people compare."""


@dataclass(frozen=True, slots=True)
class StoredRun:
    """A run with its result, as stored or freshly scored; `folder` may be a bag file."""

    folder: Path
    result: ResultDocument

    @property
    def label(self) -> RunLabel:
        result = self.result
        return RunLabel(
            result.subject,
            result.team,
            result.condition_number,
            result.run_number,
            result.run_id,
            result.testbed,
            result.competition,
        )

    @property
    def practice(self) -> bool:
        return self.result.practice or self.folder.parent.name == PRACTICE_FOLDER

    @property
    def condition(self) -> Condition:
        return Condition.from_number(self.result.condition_number)

    def place(self, name: str) -> RunPlace:
        return RunPlace(name, self.result.run_id, self.practice, self.result.issue)

    @property
    def undecided(self) -> int:
        return len(undecided(self.result.flags))

    @property
    def libraries(self) -> str:
        versions = asdict(self.result.libraries)
        return "; ".join(f"{name} {version}" for name, version in versions.items())

    @property
    def thresholds_changed(self) -> str:
        unlike = self.result.thresholds.unlike_protocol
        return "; ".join(f"{name} {value}" for name, value in unlike.items())

    @property
    def mapping_digest(self) -> str:
        """Equal where all signals were read alike."""
        mappings = sorted(self.result.mappings, key=lambda mapping: mapping.signal.value)
        ordered = msgspec.json.encode(mappings)
        return sha256(ordered).hexdigest()[:_SHORT]

    @property
    def recording_digest(self) -> str:
        """As the result has it; empty where it has none."""
        files = self.result.files
        return next((files[name].sha256 for name in sorted(files) if name.endswith(".mcap")), "")


def valid_result(folder: Path) -> ResultDocument:
    """The result of a run, if its journal and its folder agree with it.

    Raises:
        FileNotFoundError: there is none.
        MadrobError: it cannot be used; says why.
    """
    result = read_result(str(folder))
    named = parse_folder_name(folder.name)
    why = None if named is None else misplaced(result, named[0])
    if why is None and (differing := disagreement(result, folder)) is not None:
        why = out_of_date(differing)
    if why is not None:
        raise UnusableResultError(why)
    return result


def stored_run(run: RunPath) -> StoredRun:
    folder = run.path
    try:
        return StoredRun(folder, valid_result(folder))
    except FileNotFoundError:
        why = f"has no {RESULT_FILE}: name folders with runs; the console decides on one cut off"
        why = why if folder.exists() else "no such folder; name folders with runs"
    except (UnusableResultError, UnusableJournalError) as error:
        why = str(error)
    raise MadrobError(f"{run.name}: {why}")
