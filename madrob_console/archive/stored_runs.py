"""The results of any number of runs, stored or fresh, one after the other, for tables."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from madrob_console.archive.agreement import disagreement, out_of_date
from madrob_console.archive.folders import PRACTICE_FOLDER, RESULT_FILE, parse_folder_name
from madrob_console.archive.history import misplaced
from madrob_console.archive.listed_result import TabledResult
from madrob_console.archive.result_reader import (
    UnusableResultError,
    read_tabled_result,
    tabled_result,
)
from madrob_console.archive.run_journal import UnusableJournalError
from madrob_console.archive.run_paths import RunPath
from madrob_console.archive.run_record import RunLabel
from madrob_console.archive.twins import RunPlace, places_that_count
from madrob_console.errors import MadrobError
from madrob_console.referee.flags import FlagKind
from scoring.rulesets import RulesetName

if TYPE_CHECKING:
    from madrob_console.archive.scored import ScoredPath


@dataclass(frozen=True, slots=True)
class StoredRun:
    """A run with its result.

    Attributes:
        folder: where it lies; a bag may be a file.
        result: what its `result.json` says, or would say.
    """

    folder: Path
    result: TabledResult

    @property
    def label(self) -> RunLabel:
        """Whose run it is."""
        told = self.result
        return RunLabel(
            told.subject,
            told.team,
            told.condition_number,
            told.run_number,
            told.run_id,
            told.testbed,
            told.competition,
        )

    @property
    def practice(self) -> bool:
        """Whether it counts for nothing and stands apart (protocol section 2)."""
        return self.result.practice or self.folder.parent.name == PRACTICE_FOLDER


@dataclass(frozen=True, slots=True)
class Counted:
    """Which of the places of each run counts, where it is there several times.

    Attributes:
        places: by `run_id`, the name of the place that counts.
        testbeds, competitions: the names of all.
    """

    places: dict[str, str]
    testbeds: frozenset[str]
    competitions: frozenset[str]

    @classmethod
    def of(cls, runs: Iterable[RunPath]) -> Counted:
        """Look through the results of runs; what cannot be used is passed over."""
        testbeds, competitions = set(), set()

        def places() -> Iterator[RunPlace]:
            for run in runs:
                with suppress(MadrobError):
                    one = stored_run(run)
                    testbeds.add(one.result.testbed)
                    competitions.add(one.result.competition)
                    yield RunPlace(run.name, one.result.run_id, one.practice, one.result.issue)

        return cls(places_that_count(places()), frozenset(testbeds), frozenset(competitions))


def stored_run(run: RunPath) -> StoredRun:
    """The stored result of a run.

    Raises:
        MadrobError: it has none, or one that cannot be used; the message names path and remedy.
    """
    folder = run.path
    try:
        result = read_tabled_result(str(folder))
        named = parse_folder_name(folder.name)
        why = None if named is None else misplaced(result, named[0])
        if why is None and (differing := disagreement(result, folder)) is not None:
            why = out_of_date(differing)
    except FileNotFoundError:
        why = f"has no {RESULT_FILE}: name folders with runs; the console decides on one cut off"
        why = why if folder.exists() else "no such folder; name folders with runs"
    except (UnusableResultError, UnusableJournalError) as error:
        why = str(error)
    if why is not None:
        raise MadrobError(f"{run.name}: {why}")
    return StoredRun(folder, result)


def fresh_runs(run: RunPath, rules: Sequence[RulesetName | None]) -> list[StoredRun]:
    """The same of a run that is scored now, by each of some rulesets; it is read only once.

    Args:
        run: what to score.
        rules: as for `score_run`.

    Raises:
        MadrobError: it cannot be scored; the message names path and remedy.
    """
    # they load numpy and SciPy, which the tables of stored results do without
    from madrob_console.archive.result_document import ResultDocument
    from madrob_console.archive.scored import score_recording, score_run

    if run.prefix:
        documents = [_published_content(one) for one in score_run(run, rules)]
    else:
        scored = score_recording(run.path, rules)
        documents = [msgspec.to_builtins(ResultDocument.of(one, run.path, {})) for one in scored]
    return [
        StoredRun(run.path, tabled_result(str(run.path), msgspec.json.encode(document)))
        for document in documents
    ]


def _published_content(scored: ScoredPath) -> dict[str, Any]:
    """What EUROBENCH's files tell of what a `result.json` says."""
    label = scored.label
    return {
        **msgspec.to_builtins(scored.result),
        "subject": label.subject,
        "condition_number": label.condition,
        "run_number": label.run,
        "team": label.team,
        "issue": 0,
        "flags": msgspec.to_builtins(scored.flags),
        "setup": {"practice": any(flag.kind == FlagKind.PRACTICE for flag in scored.flags)},
    }
