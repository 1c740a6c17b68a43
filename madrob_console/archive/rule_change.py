"""Re-issues results after a rule change.

A worker makes the next issue and writes nothing. The writer holds the run, checks that the
journal is unchanged, and writes the journal's line first. If it is killed, `madrob recover`
makes the result again from that line; there is no second issue.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from madrob_console.archive.appeal import distinct_texts
from madrob_console.archive.check import Difference, Grade, compare
from madrob_console.archive.folders import JOURNAL_FILE, RESULT_FILE
from madrob_console.archive.issuing import has_content
from madrob_console.archive.repair import issue_in
from madrob_console.archive.result_files import result_files
from madrob_console.archive.result_reader import UnusableResultError, read_whole_result
from madrob_console.archive.run_journal import journal_held
from madrob_console.archive.run_paths import RunPath
from madrob_console.archive.scored import Scored, open_run
from madrob_console.archive.unfinished_runs import is_held
from madrob_console.common.errors import MadrobError
from madrob_console.referee.journal import Entry, Origin, read_journal
from madrob_console.referee.rebuild import Change, after, mark_of
from madrob_console.referee.records import TeamWord
from madrob_console.referee.run import Phase
from scoring.indicator_table import IndicatorName, RulesetName
from scoring.protocol import Outcome

_WHOSE = ("run_id", "subject", "condition_number", "run_number")
_RECORDING = re.compile(r"files\..*\.mcap\b")
_SAMPLES = re.compile(r"quality\.signals(\[\d+\]\.samples)?")


@dataclass(frozen=True, slots=True)
class RuleChange:
    """Why results are re-issued, and by which rules; `time` in s since the epoch.

    `rules` None = those of each result, as this version of the program has them.
    """

    reason: str
    rules: RulesetName | None
    referee: str
    time: float

    @property
    def entry(self) -> Entry:
        details = {} if self.rules is None else {"ruleset": self.rules.value}
        return Entry(self.time, Origin.REFEREE, Change.REISSUED, self.referee, self.reason, details)


@dataclass(frozen=True, slots=True, eq=False)
class NextIssue:
    """The next issue of a changed result, to be written.

    Attributes:
        values: the indicators that the rule change changes.
        others: the number of differences beside `values`.
        signed: the team's word on the issue before; None = that was not final.
        made_of: the lines of the journal that it was made of.
        entry: the journal's next line.
    """

    folder: Path
    number: int
    values: Mapping[IndicatorName, Difference]
    others: int
    signed: TeamWord | None
    made_of: tuple[Entry, ...]
    entry: Entry
    files: Mapping[str, bytes] = field(default_factory=dict)

    @property
    def words(self) -> str:
        parts = [
            f"{name.words} {' -> '.join(distinct_texts(value.stored, value.recomputed))}"
            for name, value in self.values.items()
        ]
        if self.others:
            parts.append(f"{self.others} {'others' if parts else 'beside the values'}")
        signed = "" if self.signed is None else f" (was final, {self.signed}: not final any more)"
        return f"version {self.number}{signed}: {', '.join(parts)}"


def next_issue(run: RunPath, change: RuleChange, *, files: bool = True) -> NextIssue | None:
    """Score a run by changed rules; None = its result stays, or the run was aborted.

    Nothing is written. Without `files` they are not made.

    Raises:
        MadrobError: there is no result, it is not what the journal says, the recording is another
            one, or somebody works on the run.
    """
    folder = run.path
    if run.prefix or not (folder / RESULT_FILE).is_file():
        raise MadrobError(f"{run.name}: has no {RESULT_FILE} to re-issue: name run folders")
    if not (folder / JOURNAL_FILE).is_file():
        raise MadrobError(f"{run.name}: has no {JOURNAL_FILE}, where a re-issue has to stand")
    if is_held(folder / JOURNAL_FILE):
        raise _busy(folder)
    opened = open_run(folder, change.rules)
    before = opened.recorded.run
    if opened.out_of_date:
        raise MadrobError(
            f"{folder}: {RESULT_FILE} is not what the journal says: `madrob recover` makes it again"
        )
    if before.phase not in (Phase.STOPPED, Phase.FINAL):
        raise MadrobError(f"{folder}: was cut off: open it in the console, the referee decides")
    if before.outcome is Outcome.ABORTED:
        return None
    recorded, entry = opened.recorded, change.entry
    differences = _differences(folder, Scored.of(recorded.record, before, opened.assessment))
    if not differences:
        return None
    reissued = replace(after(before, entry), journal=mark_of((*recorded.entries, entry)))
    values = {name: each for each in differences if (name := each.indicator) is not None}
    data: dict[str, bytes] = {}
    if files:
        data = result_files(folder, Scored.of(recorded.record, reissued, opened.assessment))
    return NextIssue(
        folder,
        reissued.issue,
        values,
        len(differences) - len(values),
        None if before.closure is None else before.closure.team_word,
        recorded.entries,
        entry,
        {name: data[name] for name in data if not has_content(folder / name, data[name])},
    )


def write_next_issue(issue: NextIssue, now: float) -> None:
    """Journal and write a next issue; the one before stays under its number.

    `issue` has its files, `now` is in s since the epoch.

    Raises:
        MadrobError: somebody works on the run or did so since, or the disk refuses the line, or
            the result alone.
    """
    folder, path = issue.folder, issue.folder / JOURNAL_FILE
    if is_held(path):
        raise _busy(folder)
    try:
        with journal_held(folder) as journal:
            entries, _ = read_journal(path)
            if entries != issue.made_of:
                raise MadrobError(f"{folder}: the referee went on meanwhile: re-issue it once more")
            issue_in(folder, issue.files, entries, journal, now, issue.entry)
    except BlockingIOError:
        raise _busy(folder) from None
    except OSError as error:
        raise MadrobError(
            f"{path}: cannot be written ({error.strerror}): nothing was re-issued"
        ) from None


def _busy(folder: Path) -> MadrobError:
    return MadrobError(f"{folder}: a console works on this run: leave it there, then try again")


def _differences(folder: Path, scored: Scored) -> Sequence[Difference]:
    try:
        stored = read_whole_result(str(folder))
    except UnusableResultError as error:
        raise MadrobError(f"{folder}: {error}") from None
    differences = compare(stored, scored, folder).differences_of(Grade.DIFFERS)
    lacks = scored.run.unrecorded > 0
    if any(
        _RECORDING.match(each.what) or (lacks and _SAMPLES.fullmatch(each.what))
        for each in differences
    ):
        raise MadrobError(
            f"{folder}: the recording is not the one that its result was made of: put that back, "
            "or decide in the console"
        )
    for each in differences:
        if each.what in _WHOSE and each.stored:
            raise MadrobError(
                f"{folder}: {RESULT_FILE} is of another run than journal and recording "
                f"({each.words}): put its own back, or decide in the console"
            )
    return [each for each in differences if not each.what.startswith("files")]
