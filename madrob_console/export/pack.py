"""Runs in one zip, with reports, checksums and a README: those of a team, or a dossier's."""

from __future__ import annotations

import os
import posixpath
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self

from madrob_console.archive.folders import (
    FRAMES_FOLDER,
    JOURNAL_FILE,
    PICTURES_FOLDER,
    REPORT_FILE,
    RESULT_FILE,
    RunPath,
)
from madrob_console.archive.result_document import SCHEMA_FILE, schema_text
from madrob_console.archive.run_journal import evidence_removed
from madrob_console.archive.table_columns import SAMPLE_TABLES
from madrob_console.archive.table_rows import SampledRun, TableWriter
from madrob_console.common.errors import MadrobError
from madrob_console.common.files import stamp_of, whole_file
from madrob_console.common.names import REHEARSAL, SourceKind, is_rehearsal, terminal_safe
from madrob_console.export.foxglove_layout import LAYOUT_FILE
from madrob_console.export.zip_file import SUMS_FILE, Archive
from madrob_console.referee.flags import FlagKind, weighty
from madrob_console.referee.run_summary import VOID, RunSummary
from recorder.bag import METADATA_FILE, is_evidence, is_left_of_evidence
from recorder.survey import listing

EXPORTS_FOLDER = "exports"
"""Default folder of zips, in the results folder."""

README_FILE = "README.txt"
PROTESTS_FILE = "PROTESTS.txt"
"""In a dossier: who protested about what, the decision, and missing evidence."""

Rendering = Callable[[Path], tuple[Mapping[str, bytes], Sequence[str]]]
"""Renders a run's report: files by name, and in words why there is none."""


@dataclass(frozen=True, slots=True)
class BagParts:
    """Parts of bags to pack: the scored recording, without which a bag is left out; evidence.

    Evidence is cameras and other topics.
    """

    recording: bool = True
    evidence: bool = True


WHOLE_BAGS = BagParts()


@dataclass(frozen=True, slots=True)
class Contents:
    """What a zip holds of its runs, and beside them.

    Attributes:
        title: the first lines of its README.
        time: of the files that are made for it, s since the epoch.
        parts: of the recordings.
        problems: what is left out and why.
        other_names: of the team, with their runs.
        first: files before the runs, by name.
        last: files after them.
        dossier: with a report though none was made before, and with the samples as tables.
    """

    title: str
    time: float
    parts: BagParts = WHOLE_BAGS
    problems: Sequence[str] = ()
    other_names: Sequence[str] = ()
    first: Mapping[str, bytes] = field(default_factory=dict)
    last: Mapping[str, bytes] = field(default_factory=dict)
    dossier: bool = False


@dataclass(frozen=True, slots=True)
class Export:
    """A finished zip; `size` in bytes.

    `problems` say what is missing and why, and which results cannot be used. `other_names` are the
    team's, with their runs.
    """

    path: Path
    runs: int
    files: int
    size: int
    problems: tuple[str, ...]
    other_names: tuple[str, ...] = ()


def pack(
    runs: Mapping[Path, RunSummary],
    what: Contents,
    target: Path,
    report: Rendering,
    *,
    tell: Callable[[int, int], None] = lambda _done, _total: None,
    tell_size: Callable[[int, int], None] = lambda _size, _evidence: None,
) -> Export:
    """Packs runs; what cannot be read is named, and the rest is there.

    Args:
        runs: their folders, each with a name of its own, in the order in which they are packed.
        what: of these runs, and beside them.
        target: the zip.
        report: renders the report of a run as it is now; that in its folder is never packed.
        tell: told how many runs are packed, and of how many.
        tell_size: told before packing: bytes in all, and bytes of evidence among them.

    Raises:
        MadrobError: the zip cannot be written.
    """
    bags = {run: PackedBag.of(run, what.parts) for run in runs}
    sizes = [size_of(run, bag) for run, bag in bags.items()]
    tell_size(sum(size for size, _ in sizes), sum(evidence for _, evidence in sizes))
    with folder_for(target), whole_file(target) as file, Archive(file) as archive:
        archive.problems += what.problems
        for name, data in what.first.items():
            archive.add_file(name, data, what.time)
        for number, (run, bag) in enumerate(bags.items()):
            tell(number, len(runs))
            _add_run(archive, run, bag, what, report)
        for name, data in {SCHEMA_FILE: schema_text(), **what.last}.items():
            archive.add_file(name, data, what.time)
        told = [f"{run.name}: {_run_words(found)}" for run, found in runs.items()]
        evidence = any(bag.has_evidence for bag in bags.values())
        text = _readme(archive, what, told, _left_out(runs, what.parts, evidence=evidence))
        archive.add_file(README_FILE, text.encode(), what.time)
        archive.finish(what.time)
        size = file.tell()
    damaged = (f"{run.name}: {found.problem}" for run, found in runs.items() if found.problem)
    problems = (*damaged, *archive.problems)
    return Export(target, len(runs), len(archive.sums), size, problems, tuple(what.other_names))


def _add_run(
    archive: Archive, run: Path, bag: PackedBag, what: Contents, report: Rendering
) -> None:
    before = stamp_of(str(run / RESULT_FILE))
    wanted = what.dossier or stamp_of(str(run / REPORT_FILE)) is not None
    rendered, problems = report(run) if wanted else ({}, ())
    made = {**rendered, **bag.made}
    archive.problems += [f"{run.name}/{problem}" for problem in (*problems, *bag.problems)]

    def without(path: str) -> bool:  # anybody may have written the report in the folder
        return path in made or path == REPORT_FILE or bag.without(posixpath.basename(path))

    archive.add_folder(run, run.name, without)
    for name, data in made.items():
        archive.add_file(f"{run.name}/{name}", data, what.time)
    if what.dossier:
        _add_samples(archive, run, what.time)
    if stamp_of(str(run / RESULT_FILE)) != before:
        archive.problems.append(f"{run.name}: its result changed meanwhile: export again")


def _add_samples(archive: Archive, run: Path, at: float) -> None:
    try:
        sampled = SampledRun.of(RunPath(run))
    except MadrobError as error:
        archive.problems.append(f"tables of the samples: {error}")
        return
    for table in SAMPLE_TABLES:
        name = f"tables/{run.name}_{table.name}.csv"
        with (
            archive.new_file(name, at) as file,
            closing(TableWriter(file, table)) as writer,
        ):
            writer.write_cells(sampled.columns_of(table))


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


# The files of a bag that are packed: evidence is large and not always wanted.


@dataclass(frozen=True, slots=True)
class PackedBag:
    """A bag as it is packed.

    Attributes:
        without: whether a file of this name of the run's folder is left out.
        made: the `metadata.yaml` of what is packed, where it is not the folder's.
        has_evidence: whether there is some, packed or not.
        problems: evidence that is missing and why, in words.
    """

    without: Callable[[str], bool]
    made: Mapping[str, bytes] = field(default_factory=dict)
    has_evidence: bool = False
    problems: tuple[str, ...] = ()

    @classmethod
    def of(cls, run: Path, parts: BagParts) -> Self:
        """Evidence that nobody could open is not packed."""
        try:
            return cls._of(run, parts)
        except OSError:  # what cannot be read is named when it is packed
            return cls(lambda _name: False)

    @classmethod
    def _of(cls, run: Path, parts: BagParts) -> Self:
        names = os.listdir(run)  # noqa: PTH208  of the names only
        # a file that was made just before a power cut holds nothing
        evidence = {name for name in filter(is_evidence, names) if (run / name).lstat().st_size}
        there = bool(evidence)
        if not parts.recording:
            return cls(lambda name: ".mcap" in name or METADATA_FILE in name, has_evidence=there)
        if not any(map(is_left_of_evidence, names)):
            return cls(lambda _name: False)
        folder_fd = os.open(run, os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            found = listing(folder_fd, None, () if parts.evidence else evidence)
        finally:
            os.close(folder_fd)
        # without a listing the recording is torn: then no evidence is listed
        packed = set() if found is None else {file.file_name for file in found.more}
        made = {} if found is None else {METADATA_FILE: found.metadata_yaml().encode()}
        problems = _not_whole(evidence - packed) if parts.evidence else ()
        return cls(
            lambda name: is_left_of_evidence(name) and name not in packed, made, there, problems
        )


def _not_whole(evidence: Iterable[str]) -> tuple[str, ...]:
    words = "is evidence that is not whole: `madrob recover` repairs it, then export again"
    return tuple(f"{name}: {words}" for name in sorted(evidence))


def size_of(run: Path, bag: PackedBag) -> tuple[int, int]:
    """Bytes of a run's packed files, and how many of these are evidence."""
    total = evidence = 0
    for path in run.rglob("[!.]*"):
        if not bag.without(path.name) and (stamp := stamp_of(str(path))) is not None:
            total += stamp.size
            evidence += stamp.size if is_evidence(path.name) else 0
    return total, evidence


# The README of a zip: what is in it, what is not, and what opens each kind of file.


_ABOUT: Mapping[str, str] = {
    PROTESTS_FILE: "the protests and what was decided: begin here",
    f"/{REPORT_FILE}": "the report: open it in any browser, also on a phone; it prints well",
    f"/{RESULT_FILE}": f"the result that counts; {SCHEMA_FILE} describes every key",
    "/result_issue_": "an earlier version of the result",
    f"/{JOURNAL_FILE}": "all that was done and said, a line each",
    f"/{PICTURES_FOLDER}/": "what the cameras saw at each event, larger than in the report",
    f"/{FRAMES_FOLDER}/": "what the cameras saw at an instant that somebody asked for",
    "tables/": "what the sensors said, as tables; `madrob table samples --columns` explains them",
    "_evidence_": "evidence: cameras and other topics; nothing is scored from it",
    ".mcap": "the recording (MCAP): open it in Foxglove, or with ROS 2: ros2 bag play {folder}",
    METADATA_FILE: "makes a rosbag2 bag of the recording and its evidence",
    "_jointState.csv": "the panel: time (s since 1970), position (rad), velocity, acceleration",
    "_wrench.csv": "the handle: time (s), force_x (N)",
    ".csv": "EUROBENCH's data file",
    ".yaml": "EUROBENCH's file of an indicator (none in an aborted run), a condition or the run",
    SCHEMA_FILE: "the keys of result.json",
    LAYOUT_FILE: "a layout of Foxglove for the recordings: import it there",
    "": "of the run's folder",
}
"""Meaning of a file by a part of its path; the first match counts."""

_PANDAS = """\
IN PYTHON

import pandas as pd
motion = pd.read_csv("{table}")
print(motion.describe())"""


def _readme(archive: Archive, what: Contents, runs: Sequence[str], left_out: Sequence[str]) -> str:
    examples: dict[str, str] = {}
    for name in archive.sums:
        examples.setdefault(next(part for part in _ABOUT if part in name), name)
    about = ((examples[kind], words) for kind, words in _ABOUT.items() if kind in examples)
    files = (
        f"{posixpath.basename(name)}: {words.format(folder=name.partition('/')[0])}"
        for name, words in about
    )
    sections: Mapping[str, Iterable[str]] = {
        "RUNS": runs,
        "OTHER NAMES OF THE TEAM, IN SOME OF ITS RUNS": what.other_names,
        "NOT IN THIS ARCHIVE": [*left_out, *archive.problems],
        "IS EVERYTHING WHOLE?": [
            f"sha256sum -c {SUMS_FILE}",
            f"(Mac: shasum -a 256 -c {SUMS_FILE})",
        ],
        "A FILE OF EACH KIND, AND WHAT IT IS": files,
    }
    texts = [what.title]
    for head, lines in sections.items():
        if told := [f"  {terminal_safe(line)}" for line in lines]:
            texts.append("\n".join([head, *told]))
    if (table := examples.get("_jointState.csv")) is not None:
        texts.insert(-1, _PANDAS.format(table=table))
    return "\n\n".join(texts) + "\n"


def _left_out(runs: Iterable[Path], parts: BagParts, *, evidence: bool) -> list[str]:
    """What is missing by somebody's will, in words; `evidence` = there was some to pack."""
    words = [] if parts.recording else ["the recording was left out on demand"]
    if evidence and parts != WHOLE_BAGS:
        words.append("the evidence was left out on demand")
    gone = ((run, evidence_removed(run)) for run in runs)
    return words + [f"{run.name}: its evidence was {removed}" for run, removed in gone if removed]


# A run in the README.


_UNOFFICIAL = {SourceKind.SIMULATED: "PRACTICE, simulated", SourceKind.REPLAY: "a REPLAY"}


def _run_words(run: RunSummary) -> str:
    """How a run ended and what it is worth, or why its result cannot be used."""
    if run.problem is not None or run.outcome is None:
        return run.problem or "no result, it was cut off"
    final = f"final, {run.team_word}" if run.final else "not final"
    if run.protest_filed is not None:
        final = "NOT FINAL, a PROTEST is open"
    practice = "PRACTICE" if run.practice else ""
    void = f"{VOID} ({run.reason})" if run.voided else ""
    told = (FlagKind.VOID, FlagKind.PROTEST)  # by the words before them
    flagged = [flag.words for flag in weighty(run.flags) if flag.kind not in told]
    ended = f"condition {run.condition}, run {run.run_number}: {run.outcome}"
    unofficial = next((told for kind, told in _UNOFFICIAL.items() if run.source == kind), practice)
    if is_rehearsal(run.competition):
        unofficial = f"{REHEARSAL} {practice}".rstrip()
    words = ", ".join(filter(None, (ended, void, final, unofficial, *flagged)))
    return "; ".join(filter(None, (words, run.testbed, run.run_id)))
