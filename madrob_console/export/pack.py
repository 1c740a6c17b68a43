"""All runs of a team in one zip (protocol section 10, and what opens the files)."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import msgspec

from madrob_console.archive.collection import Collection, demand_competition, the_competition
from madrob_console.archive.folders import (
    JOURNAL_FILE,
    PRACTICE_FOLDER,
    REPORT_FILE,
    RESULT_FILE,
)
from madrob_console.archive.history import VOID, RunSummary, of_competition
from madrob_console.archive.listed_result import ListedResult
from madrob_console.archive.result_document import SCHEMA_FILE, schema_text
from madrob_console.archive.result_reader import UnusableResultError, read_result, read_setup
from madrob_console.archive.run_journal import evidence_removed
from madrob_console.archive.unfinished import is_held
from madrob_console.errors import MadrobError
from madrob_console.export.foxglove_layout import LAYOUT_FILE, HandleZero, foxglove_layout
from madrob_console.export.packed_bag import WHOLE_BAGS, BagParts, PackedBag, add_run, size_of
from madrob_console.export.packed_report import packed_report
from madrob_console.export.readme import README_FILE, PackedRun, readme
from madrob_console.export.zip_file import Archive
from madrob_console.files.bounded import stamp_of
from madrob_console.files.whole import whole_file
from madrob_console.kinds import SourceKind
from madrob_console.messages.codec import TopicMapping
from madrob_console.names import terminal_safe
from madrob_console.referee.amounts import listed as first_of
from madrob_console.referee.flags import FlagKind, weighty
from madrob_console.referee.teams import TeamName
from scoring.protocol import Thresholds

EXPORTS_FOLDER = "exports"
"""In the results folder, for zips that are given no other place."""

Rendering = Callable[[Path], tuple[Mapping[str, bytes], Sequence[str]]]
"""Renders the report of a run: files by name, and why there is none, in words."""

_LONGEST_TEAM = 40  # characters of it in a file name
_UNOFFICIAL = {SourceKind.SIMULATED: "PRACTICE, simulated", SourceKind.REPLAY: "a REPLAY"}


@dataclass(frozen=True, slots=True)
class Export:
    """A zip that was made.

    Attributes:
        path: of the zip.
        runs, files: how many are in it.
        size: of the zip, bytes.
        problems: what is not in it and why, and which results cannot be used, in words.
        renamed: what is called otherwise in it, in words.
        other_names: of the team, and in which runs.
    """

    path: Path
    runs: int
    files: int
    size: int
    problems: tuple[str, ...]
    renamed: tuple[str, ...] = ()
    other_names: tuple[str, ...] = ()


def export_team(  # noqa: PLR0913  what is packed, and how
    found: Collection,
    subject: int,
    mappings: Sequence[TopicMapping],
    now: float,
    *,
    competition: str | None = None,
    practice: bool = False,
    target: Path | None = None,
    parts: BagParts = WHOLE_BAGS,
    team: str = "",
    thresholds: Thresholds | None = None,
    report: Rendering = lambda _run: ({}, []),
    tell: Callable[[int, int], None] = lambda _done, _total: None,
    tell_size: Callable[[int, int], None] = lambda _size, _evidence: None,
) -> Export:
    """Pack all official runs of a team; the one that goes on is left out and named.

    Args:
        found: all runs; of those that are there twice one is packed.
        subject: the team's number.
        mappings: which topic carries which signal, for the layout.
        now: s since the epoch.
        competition: of the team; None = it has runs of only one.
        practice: its practice runs instead.
        target: the zip; in the folder `exports` of the results folder if not given.
        parts: what is packed of the recordings.
        team: its name in the list of teams; empty = the name that its latest run carries.
        thresholds: the testbed's, for the layout; None = the protocol's.
        report: renders the report of a run where one was made before.
        tell: is told how many runs are packed, and of how many.
        tell_size: is told before anything is packed how many bytes are to be, and how many of these
            are evidence.

    Raises:
        MadrobError: the team has no such runs or is of several competitions, or the zip cannot be
            written.
    """
    runs, left_out = _runs_of(found, subject, competition, practice=practice)
    known = {run: KnownRun.of(run) for run in runs}
    called = TeamName.of(team, (known[run].team for run in runs))
    name = file_name(subject, called.name, now, practice=practice)
    path = target or found.root / EXPORTS_FOLDER / name
    names_in = _names_in_archive(runs)
    bags = {run: (names_in[run], PackedBag.of(run, parts)) for run in runs}
    sizes = [size_of(run, bag) for run, (_, bag) in bags.items()]
    tell_size(sum(size for size, _ in sizes), sum(evidence for _, evidence in sizes))
    with folder_for(path), whole_file(path) as file, Archive(file) as archive:
        archive.problems += left_out
        packed: list[PackedRun] = []
        for run in runs:
            tell(len(packed), len(runs))
            added = _add_run(archive, run, bags, report)
            packed.append(PackedRun(names_in[run], terminal_safe(known[run].words), added))
        archive.add(SCHEMA_FILE, schema_text(), now)
        zeros = [known[run].zero for run in runs if known[run].zero is not None]
        layout = foxglove_layout(mappings, thresholds, zeros[-1] if zeros else None)
        text = msgspec.json.format(msgspec.json.encode(layout).decode(), indent=2)
        archive.add(LAYOUT_FILE, f"{text}\n".encode(), now)
        gone = ((run, evidence_removed(run)) for run in runs)
        removed = [f"{run.name}: its evidence was {words}" for run, words in gone if words]
        problems = [terminal_safe(words) for words in (*archive.problems, *removed)]
        renamed = [terminal_safe(words) for words in archive.renamed]
        kind = "PRACTICE runs" if practice else "runs"
        title = terminal_safe(f"MADROB: {kind} of subject {subject} {called.name}".rstrip())
        named = {
            one: [names_in[run] for run in runs if known[run].team == one] for one in called.others
        }
        names = [terminal_safe(f"{one}: {first_of(where)}") for one, where in named.items()]
        title += time.strftime(
            "\nAs of %Y-%m-%d %H:%M:%S UTC: all decisions until then", time.gmtime(now)
        )
        text = readme(
            title,
            packed,
            problems,
            renamed,
            names,
            bags=parts.recording,
            evidence_left_out=any(bag.evidence_left_out for _, bag in bags.values()),
        )
        archive.add(README_FILE, text.encode(), now)
        archive.finish(now)
        size = file.tell()
    damaged = (f"{run.name}: {known[run].words}" for run in runs if known[run].damaged)
    said = (*damaged, *archive.problems), tuple(archive.renamed), tuple(names)
    return Export(path, len(runs), archive.count, size, *said)


def file_name(subject: int, team: str, now: float, *, practice: bool = False) -> str:
    """The name of a team's zip: `team_SSS_<team>_YYYYMMDD_HHMMSS.zip`, of letters and digits.

    Args:
        subject: the team's number.
        team: its name; what is neither letter nor digit becomes `_`.
        now: s since the epoch; stands in it in local time.
        practice: of practice runs; it says so.
    """
    words = "".join(char if char.isalnum() or char == "-" else " " for char in team).split()
    name = "_".join(words)[:_LONGEST_TEAM].rstrip("_")
    date = time.strftime("%Y%m%d_%H%M%S", time.localtime(now))
    kind = "practice" if practice else ""
    return "_".join(part for part in (f"team_{subject:03d}", name, kind, date) if part) + ".zip"


@dataclass(frozen=True, slots=True)
class KnownRun:
    """What is known of a run without its recording.

    Attributes:
        team: its name; empty = it has none.
        words: how it ended and what it is worth, for people.
        practice: whether it counts for nothing.
        zero: its handle zero; None = none was set.
        damaged: whether its result cannot be used; `words` says why.
    """

    team: str
    words: str
    practice: bool = False
    zero: HandleZero | None = None
    damaged: bool = False

    @classmethod
    def of(cls, run: Path) -> KnownRun:
        """What result and journal in its folder say; what is wrong with them stands in `words`."""
        folder, practice = str(run), run.parent.name == PRACTICE_FOLDER
        try:
            result, _ = read_result(folder)
        except FileNotFoundError:
            setup = read_setup(f"{folder}/{JOURNAL_FILE}")
            words = "no result, it was cut off"
            if setup is None:
                return cls("", words, practice)
            return cls(setup.team, words, practice or setup.practice)
        except UnusableResultError as problem:
            return cls("", str(problem), practice, damaged=True)
        return cls(result.team, _outcome(result), practice or result.practice, _zero(result))


def _zero(result: ListedResult) -> HandleZero | None:
    """The handle zero of a run, where one was set."""
    if result.zero_samples is None:
        return None
    whose = f"run {result.run_number} of condition {result.condition_number}"
    return HandleZero(result.zero_samples.mean, whose)


def _outcome(result: ListedResult) -> str:
    """How a run ended, for people."""
    final = "not final" if result.closure is None else f"final, {result.closure.team_word}"
    unofficial = [words for kind, words in _UNOFFICIAL.items() if result.source == kind]
    if not unofficial and result.practice:
        unofficial = ["PRACTICE"]
    condition = f"condition {result.condition_number}, run {result.run_number}"
    void = [f"{VOID} ({result.why_invalid})"] if result.voided else []
    told = (FlagKind.VOID, FlagKind.PROTEST)  # by the words before them
    flagged = [flag.words for flag in weighty(result.flags or ()) if flag.kind not in told]
    words = ", ".join([f"{condition}: {result.outcome}", *void, final, *unofficial, *flagged])
    return "; ".join(filter(None, (words, result.testbed, result.run_id)))


def _names_in_archive(runs: Iterable[Path]) -> dict[Path, str]:
    """What the folders of runs are called there: of two testbeds' with one name one is another."""
    names: dict[Path, str] = {}
    taken: Counter[str] = Counter()
    for run in runs:
        taken[run.name] += 1
        number = taken[run.name]
        names[run] = run.name if number == 1 else f"{run.name}_{number}"
    return names


def _runs_of(
    found: Collection, subject: int, competition: str | None, *, practice: bool
) -> tuple[list[Path], list[str]]:
    """The official or the practice runs of a team, oldest first.

    Returns:
        Those to be packed, and what is left out and why, in words.

    Raises:
        MadrobError: there is none to be packed, they are of several competitions, or the folder
            cannot be read.
    """
    teams: dict[int, list[RunSummary]] = {}
    for run in found.runs:  # a folder keeps its name when its subject is corrected
        if not run.twin:
            teams.setdefault(run.subject, []).append(run)
    own = sorted(teams.get(subject, ()), key=lambda run: (run.folder[-15:], run.folder))
    of_kind = [run for run in own if run.practice == practice]
    chosen, unsure = _of_one_competition(of_kind, competition)
    left_out = [f"{run.folder}: does not say of which competition it is" for run in unsure]
    packed: list[Path] = []
    for place in (found.root / run.folder for run in chosen):
        if is_held(place / JOURNAL_FILE) and stamp_of(str(place / RESULT_FILE)) is None:
            left_out.append(f"{place.name}: this run goes on: export again after it")
        else:
            packed.append(place)
    if packed:
        return packed, left_out
    if left_out:
        raise MadrobError(f"the only run of subject {subject} goes on: export it after its end")
    if own:
        raise MadrobError(_all_of_the_other_kind(subject, len(own), practice=practice))
    others = ", ".join(map(str, sorted(teams)))
    there = f"there are runs of subject {others}" if teams else "it holds no runs at all"
    where = "here" if found.root == Path() else f"in {found.root}"
    raise MadrobError(f"subject {subject} has no runs {where}: {there}; name other folders")


def _of_one_competition(
    runs: Sequence[RunSummary], competition: str | None
) -> tuple[Sequence[RunSummary], Sequence[RunSummary]]:
    """Those of one competition, and those that may be of another one.

    Raises:
        MadrobError: there are several and none was chosen, or none is of the one that was.
    """
    known = {run.competition for run in runs if run.competition is not None}
    if competition is not None and known:
        demand_competition(competition, known)
    title = the_competition(runs, competition)
    unsure = [run for run in runs if run.competition is None and len(known) > 1]
    return [run for run in of_competition(runs, title) if run not in unsure], unsure


def _all_of_the_other_kind(subject: int, count: int, *, practice: bool) -> str:
    if practice:
        return f"subject {subject} has no practice runs: leave --practice out ({count} official)"
    return f"subject {subject} has no official runs: --practice packs the others ({count})"


def _add_run(
    archive: Archive, run: Path, packed: Mapping[Path, tuple[str, PackedBag]], report: Rendering
) -> list[str]:
    result = str(run / RESULT_FILE)
    before = stamp_of(result)
    called, bag = packed[run]
    made: Mapping[str, bytes] = {}
    if stamp_of(f"{run}/{REPORT_FILE}") is not None:
        made, problems = report(run)
        archive.problems += [f"{called}/{problem}" for problem in problems]
    added = add_run(archive, run, called, bag, packed_report(run, packed, made))
    if called != run.name:
        archive.renamed.append(f"{called}: was {run}")
    if stamp_of(result) != before:
        archive.problems.append(f"{run.name}: its result changed meanwhile: export again")
    return added


@contextmanager
def folder_for(file: Path) -> Iterator[None]:
    """The folder of a file is there while inside; where nothing comes of it, it is as before."""
    folder = file.parent
    missing = not folder.exists()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise MadrobError(
            f"{folder}: cannot be made ({error.strerror}): choose another --output"
        ) from None
    try:
        yield
    except BaseException:
        if missing:
            with suppress(OSError):  # somebody else has put something there
                folder.rmdir()
        raise
