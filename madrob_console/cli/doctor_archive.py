"""What `madrob doctor --archive` says: whether the runs below a folder may be handed in."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, suppress
from functools import partial
from pathlib import Path
from typing import NamedTuple, TypeAlias

from madrob_console.archive.check import CheckedRun, Grade, check_run
from madrob_console.archive.collection import LEFT_OUT_LINK, NO_RUN, Collection, collected
from madrob_console.archive.folders import (
    JOURNAL_FILE,
    PRACTICE_FOLDER,
    RESULT_FILE,
    parse_folder_name,
)
from madrob_console.archive.result_reader import lacks_line
from madrob_console.archive.run_paths import RunPath
from madrob_console.archive.stored_runs import stored_run
from madrob_console.archive.table_columns import RUNS, Row
from madrob_console.cli.batch import Tried, tried
from madrob_console.cli.finding import Finding, Severity
from madrob_console.cli.progress import Tell
from madrob_console.cli.sharing import in_order
from madrob_console.common.errors import MadrobError
from madrob_console.common.formatting import counted, listed
from madrob_console.common.names import is_rehearsal, terminal_safe
from madrob_console.referee.flags import FlagKind, undecided
from madrob_console.referee.run_summary import RunSummary
from scoring.protocol import Thresholds

_WIDTH = 58
"""Columns of a finding's words, in a line of 80."""

_LONGEST_REMEDY = 44

Whys: TypeAlias = Sequence[tuple[RunSummary, str]]
"""Runs, each with what is wrong with it in words."""


class _Rule(NamedTuple):
    """What no run of an archive may be; `why` is empty for a run that is not so."""

    subject: str
    remedy: str
    why: Callable[[RunSummary], str]


class _Clash(NamedTuple):
    """What runs with one `key` must have in common: the `value`."""

    severity: Severity
    subject: str
    remedy: str
    key: Callable[[RunSummary], object]
    value: Callable[[RunSummary], object]


def _why_without_result(run: RunSummary) -> str:
    waits = run.outcome is None and run.problem is None and not run.never_ran
    return "no result: it goes on, or it was cut off" * waits


def _why_misplaced(run: RunSummary) -> str:
    apart = Path(run.folder).parent.name == PRACTICE_FOLDER
    return "practice among official runs" * (run.practice and not apart)


def _why_undecided(run: RunSummary) -> str:
    waiting = [flag.words for flag in undecided(run.flags) if flag.kind is not FlagKind.PROTEST]
    return "; ".join(waiting) * run.official


_RULES = (
    _Rule("no result", "open the console, it asks", _why_without_result),
    _Rule("twice", "take one of the two folders away", lambda run: run.why_twin * bool(run.twin)),
    _Rule(
        "rehearsal",
        "take it out, it never counts",
        lambda run: "of a rehearsal" * is_rehearsal(run.competition),
    ),
    _Rule("practice", "move it to the folder `practice`", _why_misplaced),
    _Rule(
        "protest",
        "decide it (Enter, P)",
        lambda run: "a protest is open" * (run.official and run.protest_filed is not None),
    ),
    _Rule("undecided", "decide what waits (Enter)", _why_undecided),
    _Rule(
        "not signed",
        "sign it (Enter, f)",
        lambda run: "not final" * (run.official and run.valid and not run.final),
    ),
)

_CLASHES = (
    _Clash(
        Severity.ERROR,
        "run number",
        "void repeats of one hall",
        lambda run: (run.competition, run.testbed, run.subject, run.condition, run.run_number),
        lambda run: run.folder,
    ),
    _Clash(
        Severity.WARNING,
        "folder name",
        "keep the halls apart",
        lambda run: Path(run.folder).name,
        lambda run: run.folder,
    ),
    _Clash(
        Severity.WARNING,
        "team name",
        "say which name counts",
        lambda run: (run.competition, run.subject),
        lambda run: run.team,
    ),
    _Clash(
        Severity.WARNING,
        "subject",
        "correct it if it is one team (Enter, c)",
        lambda run: (run.competition, run.team or run.subject),
        lambda run: run.subject,
    ),
)

_COLUMNS: Mapping[str, tuple[Severity, str]] = {
    "competition": (Severity.ERROR, "give it an archive of its own"),
    "ruleset": (Severity.ERROR, "`madrob score --reissue` to one"),
    "software": (Severity.WARNING, "say so when it is handed in"),
    "libraries": (Severity.WARNING, "say so when it is handed in"),
    "thresholds_changed": (Severity.WARNING, "compare within one hall only"),
    "mapping_sha256": (Severity.WARNING, "compare within one hall only"),
}
"""Columns of the table of runs in which the runs that count should not differ."""


def archive_findings(path: Path, tell: Tell) -> Iterator[Finding]:
    """Everything that stands between the runs below a folder and handing them in.

    The last step scores each run again. `tell` is told how many are checked, and of how many.

    Raises:
        MadrobError: there is no such folder, or no run in it.
    """
    found = collected([path])
    if not found.runs:
        if path.is_dir() and (unlisted := [one for one in found.unlisted if one.why != NO_RUN]):
            raise MadrobError(f"{unlisted[0].place}: {unlisted[0].why}")
        raise MadrobError(f"{path}: holds no run: name a results folder, or one with several")
    official = [run for run in found.runs if run.official and not (run.voided or run.twin)]
    counting = [run for run in official if run.valid]
    how = "named subject/condition/run" if counting else "name the folder of a competition"
    text = f"{len(counting)} of {len(found.runs)} count: {how}"
    yield Finding(Severity.OK if counting else Severity.ERROR, "runs", text)
    if left_out := {one.place: one.why for one in found.unlisted} | dict(_links(path)):
        text = f"{counted(len(left_out), 'place')}: --json says where, why and what to do"
        yield Finding(Severity.ERROR, "left out", text, left_out)
    usable = [run for run in found.runs if run.outcome and not run.problem and not run.twin]
    why = f"no line of {JOURNAL_FILE} has the digest of its {RESULT_FILE}"
    unnoted = [(run, why) for run in usable if lacks_line(str(found.root / run.folder))]
    yield from _finding(Severity.ERROR, "not noted", "`madrob recover FOLDER` notes it", unnoted)
    for remedy, whys in _damaged(found.runs).items():
        yield from _finding(Severity.ERROR, "damaged", remedy, whys)
    for rule in _RULES:
        whys = [(run, why) for run in found.runs if (why := rule.why(run))]
        yield from _finding(Severity.ERROR, rule.subject, rule.remedy, whys)
    for clash in _CLASHES:
        yield from _finding(*clash[:3], _clashing(official, clash))
    rows = dict(_rows(found, counting))
    for column, (severity, remedy) in _COLUMNS.items():
        whys = list(_unlike(counting, {place: row[column] for place, row in rows.items()}))
        alike = column == "thresholds_changed" and len({why for _, why in whys}) == 1
        what = f"{_thresholds_words(whys[0][0])}: one hall only" if alike else remedy
        yield from _finding(severity, column.partition("_")[0], what, whys)
    yield from _finding(
        Severity.ERROR,
        "check",
        "`madrob score --check` says what",
        list(_differing(found.root, usable, tell)),
    )


def _links(path: Path) -> Iterator[tuple[str, str]]:
    """Folders, or what is called like a run, that no list follows."""
    for place in sorted(path.rglob("*")):
        if place.is_symlink() and (place.is_dir() or parse_folder_name(place.name) is not None):
            yield str(place), LEFT_OUT_LINK


def archive_verdict(findings: Sequence[Finding]) -> str:
    found = Counter(finding.severity for finding in findings)
    if errors := found[Severity.ERROR]:
        return f"not to be handed in: {counted(errors, 'error')}"
    return f"may be handed in, {counted(found[Severity.WARNING], 'warning')}"


def _finding(severity: Severity, subject: str, remedy: str, whys: Whys) -> Iterator[Finding]:
    if whys:
        names = [f"{run.subject}/{run.condition}/{run.run_number}" for run, _ in whys]
        texts = [f"{listed(names, most)}: {remedy}" for most in (4, 3, 2, 1)]
        if len({*names}) < len(names):  # one number in several folders
            folders = [Path(run.folder) for run, _ in whys]
            places = [f"in {folder.parent.name}" for folder in folders]
            if len({*places}) < len(places):
                places = [f"at {folder.name[-6:]}" for folder in folders]
            placed = [f"{name} {place}" for name, place in zip(names, places, strict=True)]
            texts.insert(0, f"{listed(placed, 4)}: {remedy}")
        text = next((text for text in texts if len(text) <= _WIDTH), texts[-1])
        told = {run.folder: terminal_safe(why) for run, why in whys}
        yield Finding(severity, subject, text, told)


def _damaged(runs: Sequence[RunSummary]) -> Mapping[str, Whys]:
    """By remedy, which the words of a problem end with."""
    found = defaultdict[str, list[tuple[RunSummary, str]]](list)
    for run in runs:
        if run.problem:
            remedy = run.problem.rpartition(": ")[2]
            if run.repairable:
                remedy = "`madrob recover` mends or explains"
            elif len(remedy) > _LONGEST_REMEDY:
                remedy = "--json says what to do"
            found[remedy].append((run, run.problem))
    return found


def _clashing(runs: Sequence[RunSummary], clash: _Clash) -> Whys:
    values = defaultdict[object, dict[object, None]](dict)
    for run in runs:
        values[clash.key(run)][clash.value(run)] = None
    several = [(run, values[clash.key(run)]) for run in runs]
    return [(run, f"one of {', '.join(map(str, of))}") for run, of in several if len(of) > 1]


def _rows(found: Collection, runs: Sequence[RunSummary]) -> Iterator[tuple[str, Row]]:
    for run in runs:
        with suppress(MadrobError):  # an engine works on it: the check says so
            yield run.folder, RUNS.row_of(stored_run(RunPath(found.root / run.folder)))


def _thresholds_words(run: RunSummary) -> str:
    usual, unlike = Thresholds().numbers, run.thresholds or {}
    words = [f"{name} {value}, protocol {usual.get(name)}" for name, value in unlike.items()]
    return words[0] if len(words) == 1 else "--json names them"


def _unlike(
    runs: Sequence[RunSummary], values: Mapping[str, object]
) -> Iterator[tuple[RunSummary, str]]:
    """Runs with another value than most."""
    for usual, _ in Counter(values.values()).most_common(1):
        for run in runs:
            if (value := values.get(run.folder, usual)) != usual:
                yield run, f"{value or 'none'}, most have {usual or 'none'}"


def _differing(
    root: Path, runs: Sequence[RunSummary], tell: Tell
) -> Iterator[tuple[RunSummary, str]]:
    """Runs that do not give their result again, or whose files are not those of the result."""
    paths = [RunPath(root / run.folder) for run in runs]
    check = partial(tried, work=check_run)
    with closing(in_order(check, paths, lambda _run, why: Tried(problem=why))) as checked:
        for number, (run, one) in enumerate(zip(runs, checked, strict=True), start=1):
            tell(number, len(runs))
            if why := one.problem or _difference(one.done):
                lost = not (root / run.folder / JOURNAL_FILE).exists()
                yield run, f"{JOURNAL_FILE} is missing, {why}" if lost else why


def _difference(checked: CheckedRun | None) -> str:
    if checked is None or checked.grade is not Grade.DIFFERS:
        return ""
    return f"{checked.words}: {checked.differences_of(Grade.DIFFERS)[0].words}"
