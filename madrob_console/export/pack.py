"""A team's runs in one zip, with reports and a README."""

from __future__ import annotations

import os
import posixpath
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
    PICTURES_FOLDER,
    PICTURES_INDEX,
    PRACTICE_FOLDER,
    REPORT_FILE,
    RESULT_FILE,
)
from madrob_console.archive.history import VOID, RunSummary, of_competition
from madrob_console.archive.result_document import SCHEMA_FILE, ResultDocument, schema_text
from madrob_console.archive.result_reader import UnusableResultError, read_result, read_setup
from madrob_console.archive.run_journal import evidence_removed, is_held
from madrob_console.common.errors import MadrobError
from madrob_console.common.files import stamp_of, whole_file
from madrob_console.common.formatting import listed as first_of
from madrob_console.common.names import SourceKind, terminal_safe
from madrob_console.export.foxglove_layout import LAYOUT_FILE, HandleZero, foxglove_layout
from madrob_console.export.zip_file import (
    SUMS_FILE,
    WHOLE_BAGS,
    Archive,
    BagParts,
    PackedBag,
    add_run,
    led_elsewhere,
    size_of,
)
from madrob_console.messages.codec import TopicMapping
from madrob_console.referee.flags import FlagKind, weighty
from madrob_console.referee.lists import TeamName
from recorder.bag import is_evidence
from scoring.protocol import Thresholds

# The README of a zip: how to open each file.


README_FILE = "README.txt"


@dataclass(frozen=True, slots=True)
class PackedRun:
    """A run in an export; `words` say how it ended, `files` are names in the archive."""

    folder: str
    words: str
    files: Sequence[str]

    @property
    def table(self) -> str:
        """Its file of the panel's motion, named like the folder without date and time."""
        return self.folder[: -len("_YYYYMMDD_HHMMSS")] + "_jointState.csv"

    def has(self, name: str) -> bool:
        return f"{self.folder}/{name}" in self.files


def readme(
    title: str,
    runs: Sequence[PackedRun],
    problems: Sequence[str],
    renamed: Sequence[str] = (),
    other_names: Sequence[str] = (),
    *,
    bags: bool,
    evidence_left_out: bool = False,
) -> str:
    """The README.

    `problems` say what is missing. `renamed` says what has another name here than in the
    run's folder. `other_names` are the team's names in some of the runs.
    `evidence_left_out` = the runs have evidence that is not packed.
    """
    texts = [title, _runs(runs)]
    if other_names:
        texts.append("OTHER NAMES OF THE TEAM, IN SOME OF ITS RUNS\n" + _lines(other_names))
    if problems:
        texts.append("NOT IN THIS ARCHIVE\n" + _lines(problems))
    if renamed:
        texts.append("UNDER ANOTHER NAME\n" + _lines(renamed))
    texts.append(_WHOLE.format(sums=SUMS_FILE))
    if any(run.has("report.html") for run in runs):
        pictured = any(run.has(f"{PICTURES_FOLDER}/{PICTURES_INDEX}") for run in runs)
        texts.append(_REPORT + (_PICTURES if pictured else ""))
    if computed := [run for run in runs if run.has(run.table)]:
        texts.append(_PANDAS.format(table=f"{computed[0].folder}/{computed[0].table}"))
    texts.append(_RESULT.format(schema=SCHEMA_FILE))
    if recorded := [run.folder for run in runs if run.has(f"{run.folder}_0.mcap")]:
        texts.append(_BAG.format(bag=recorded[0], layout=LAYOUT_FILE))
    elif not bags:
        texts.append("RECORDINGS\nThey were left out of this archive; ask the referee for them.")
    if evidence_left_out:
        texts.append(_NO_EVIDENCE)
    elif evidence := [name for run in runs for name in run.files if is_evidence(name)]:
        texts.append(_EVIDENCE.format(file=evidence[0]))
    return "\n\n".join(texts) + "\n"


def _runs(runs: Sequence[PackedRun]) -> str:
    return "RUNS\n" + _lines(f"{run.folder}: {run.words}" for run in runs)


def _lines(texts: Iterable[str]) -> str:
    return "\n".join(f"  {text}" for text in texts)


_WHOLE = """\
IS EVERYTHING WHOLE?
  sha256sum -c {sums}
(on a Mac: shasum -a 256 -c {sums})"""

_REPORT = """\
THE REPORT
Open report.html of a run in any browser, also on a phone; it prints well."""

_PICTURES = f"""
The folder {PICTURES_FOLDER} has what the cameras saw at each event, larger than the page."""

_PANDAS = """\
THE DATA, IN PYTHON

import pandas as pd
motion = pd.read_csv("{table}")
print(motion.describe())

..._jointState.csv: time (s since 1970), position (rad), velocity (rad/s), acceleration (rad/s^2)
..._wrench.csv: time (s), force_x (N, on the handle)
..._event.csv: time (s), event
One .yaml for each indicator (none in an aborted run), condition_N.yaml and run_info_....yaml
say the rest in EUROBENCH's words."""

_RESULT = """\
THE WHOLE RESULT
result.json: values with their units or the reason why there is none, times of the steps as the
sensors and the referee have them, data quality, the referee's decisions. {schema}
describes every key. journal.jsonl: everything that was done, a line each."""

_BAG = """\
THE RECORDING
Each run folder is a rosbag2 bag (MCAP). With ROS 2 and ros-jazzy-rosbag2-storage-mcap:
  ros2 bag info {bag}
  ros2 bag play {bag}
With Foxglove (foxglove.dev): open the .mcap file of the run, then import the layout
{layout}."""

_EVIDENCE = """\
THE EVIDENCE
Files called ..._evidence_N.mcap hold cameras and other topics, as {file}.
Nothing is scored from them. They belong to the bag: ros2 bag and Foxglove open them like the
recording, and metadata.yaml lists them."""

_NO_EVIDENCE = """\
EVIDENCE
Cameras and other topics of some runs were left out of this archive; ask the referee for them."""


# A report in a zip: its links lead to files of the zip, or nowhere.


_NOT_HERE = " (not in this zip)"


def packed_report(
    run: Path,
    packed: Mapping[Path, tuple[str, PackedBag]],
    made: Mapping[str, bytes],
) -> dict[str, bytes]:
    """The report of a run by its name, as it is packed; empty if none was made.

    `packed` has each run's name in the zip and its bag. `made` has by name the files that
    are not in the run's folder, or differ from those there.
    """
    if REPORT_FILE not in made:
        return {}
    here, _ = packed[run]
    folders = {Path(os.path.normpath(folder)): folder for folder in packed}

    def place(target: str) -> str | None:
        path = Path(os.path.normpath(run / target))
        within = next((one for one in path.parents if one in folders), None)
        if within is None:
            return None
        (called, bag), name = packed[folders[within]], path.relative_to(within).as_posix()
        is_made = folders[within] == run and name in made
        if not (is_made or (bag.has(path.name) and path.is_file())):
            return None
        return posixpath.relpath(f"{called}/{name}", here)

    return {REPORT_FILE: led_elsewhere(made[REPORT_FILE].decode(), place, _NOT_HERE).encode()}


EXPORTS_FOLDER = "exports"
"""Default folder of zips, in the results folder."""

Rendering = Callable[[Path], tuple[Mapping[str, bytes], Sequence[str]]]
"""Renders a run's report: files by name, and in words why there is none."""

_LONGEST_TEAM = 40  # characters of it in a file name
_UNOFFICIAL = {SourceKind.SIMULATED: "PRACTICE, simulated", SourceKind.REPLAY: "a REPLAY"}


@dataclass(frozen=True, slots=True)
class Export:
    """A finished zip; `size` in bytes.

    `problems` say what is missing and why, and which results cannot be used. `renamed` says
    what has another name in it. `other_names` are the team's, with their runs.
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
    """Packs all official runs of a team; a run that still goes on is left out and named.

    Args:
        found: all runs; duplicates are packed once.
        subject: the team's number.
        mappings: for the layout.
        now: s since the epoch.
        competition: of the team; None = its runs are of only one.
        practice: pack its practice runs instead.
        target: the zip; None = in the folder `exports` of the results folder.
        parts: of the recordings.
        team: its name in the list of teams; empty = the name in its latest run.
        thresholds: the testbed's, for the layout; None = the protocol's.
        report: renders the report of a run where one was made before.
        tell: told how many runs are packed, and of how many.
        tell_size: told before packing: bytes in all, and bytes of evidence among them.

    Raises:
        MadrobError: no such runs, several competitions, or the zip cannot be written.
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
        archive.add_file(SCHEMA_FILE, schema_text(), now)
        zeros = [known[run].zero for run in runs if known[run].zero is not None]
        layout = foxglove_layout(mappings, thresholds, zeros[-1] if zeros else None)
        text = msgspec.json.format(msgspec.json.encode(layout).decode(), indent=2)
        archive.add_file(LAYOUT_FILE, f"{text}\n".encode(), now)
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
        archive.add_file(README_FILE, text.encode(), now)
        archive.finish(now)
        size = file.tell()
    damaged = (f"{run.name}: {known[run].words}" for run in runs if known[run].damaged)
    said = (*damaged, *archive.problems), tuple(archive.renamed), tuple(names)
    return Export(path, len(runs), archive.count, size, *said)


def file_name(subject: int, team: str, now: float, *, practice: bool = False) -> str:
    """A team's zip: `team_SSS_<team>_YYYYMMDD_HHMMSS.zip`, local time; practice is named in it.

    In the team's name all but letters and digits becomes `_`. `now` is in s since the epoch.
    """
    words = "".join(char if char.isalnum() or char == "-" else " " for char in team).split()
    name = "_".join(words)[:_LONGEST_TEAM].rstrip("_")
    date = time.strftime("%Y%m%d_%H%M%S", time.localtime(now))
    kind = "practice" if practice else ""
    return "_".join(part for part in (f"team_{subject:03d}", name, kind, date) if part) + ".zip"


@dataclass(frozen=True, slots=True)
class KnownRun:
    """What is known of a run without its recording.

    `words` say how it ended and what it is worth, or why its result cannot be used.
    """

    team: str
    words: str
    practice: bool = False
    zero: HandleZero | None = None
    damaged: bool = False

    @classmethod
    def of(cls, run: Path) -> KnownRun:
        """Reads result and journal in its folder; what is wrong with them stands in `words`."""
        folder, practice = str(run), run.parent.name == PRACTICE_FOLDER
        try:
            result = read_result(folder)
        except FileNotFoundError:
            setup = read_setup(f"{folder}/{JOURNAL_FILE}")
            words = "no result, it was cut off"
            if setup is None:
                return cls("", words, practice)
            return cls(setup.team, words, practice or setup.practice)
        except UnusableResultError as problem:
            return cls("", str(problem), practice, damaged=True)
        return cls(result.team, _outcome(result), practice or result.practice, _zero(result))


def _zero(result: ResultDocument) -> HandleZero | None:
    if result.zero_samples is None:
        return None
    whose = f"run {result.run_number} of condition {result.condition_number}"
    return HandleZero(result.zero_samples.mean, whose)


def _outcome(result: ResultDocument) -> str:
    final = "not final" if result.closure is None else f"final, {result.closure.team_word}"
    unofficial = [words for kind, words in _UNOFFICIAL.items() if result.source == kind]
    if not unofficial and result.practice:
        unofficial = ["PRACTICE"]
    condition = f"condition {result.condition_number}, run {result.run_number}"
    void = [f"{VOID} ({result.why_invalid})"] if result.voided else []
    told = (FlagKind.VOID, FlagKind.PROTEST)  # by the words before them
    flagged = [flag.words for flag in weighty(result.known_flags) if flag.kind not in told]
    words = ", ".join([f"{condition}: {result.outcome}", *void, final, *unofficial, *flagged])
    return "; ".join(filter(None, (words, result.testbed, result.run_id)))


def _names_in_archive(runs: Iterable[Path]) -> dict[Path, str]:
    """Folder names in the archive; of two testbeds' runs with one name, one is renamed."""
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
    """Runs to pack, oldest first, and in words what is left out and why."""
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
    """Makes the folder of `file`; if the block fails, a new folder is removed again."""
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
