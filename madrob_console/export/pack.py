"""Runs in one zip, with reports, tables, checksums and a README."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from madrob_console.archive.folders import INDEX_PAGE, REPORT_FILE, RESULT_FILE
from madrob_console.archive.result_document import (
    SCHEMA_FILE,
    result_schema,
    schema_text,
)
from madrob_console.archive.run_journal import UnusableJournalError, read_run_journal
from madrob_console.archive.run_paths import RunPath
from madrob_console.archive.stored_runs import StoredRun, stored_run
from madrob_console.archive.table_columns import RUN_TABLES, SAMPLE_TABLES, TidyTable, rows_of
from madrob_console.archive.table_rows import SampledRun, TableWriter
from madrob_console.common.errors import MadrobError
from madrob_console.common.files import whole_file
from madrob_console.common.plain_files import stamp_of
from madrob_console.export.papers import (
    COLUMNS_FILE,
    PROTESTS_FILE,
    README_FILE,
    columns_text,
    index_page,
    protests_text,
    readme,
)
from madrob_console.export.zip_file import Archive
from madrob_console.referee.run import Run
from madrob_console.referee.run_summary import RunSummary
from recorder.bag import EVIDENCE, METADATA_FILE

EXPORTS_FOLDER = "exports"
"""Default folder of zips, in the results folder."""

Rendering = Callable[[Path], tuple[Mapping[str, bytes], Sequence[str]]]
"""Renders a run's report: files by name, and in words why there is none."""


@dataclass(frozen=True, slots=True)
class BagParts:
    """Parts of bags to pack: the scored recording, without which a bag is left out; evidence."""

    recording: bool = True
    evidence: bool = True

    @property
    def left_out(self) -> list[str]:
        """What is left out on demand, in words."""
        if not self.recording:
            return ["the recordings were left out on demand, with their evidence"]
        return [] if self.evidence else ["the evidence was left out on demand"]

    def is_without(self, path: str) -> bool:
        """Whether a file of a run's folder is left out."""
        folder, slash, _ = path.partition("/")
        if slash and EVIDENCE in folder:
            return not (self.recording and self.evidence)
        return not self.recording and (".mcap" in path or METADATA_FILE in path)


@dataclass(frozen=True, slots=True)
class Contents:
    """The runs of a zip, and what it says of them.

    Attributes:
        runs: by their folders, each with a name of its own, in the order in which they are packed.
        title: the first lines of its README and its page.
        time: of the files that are made for it, s since the epoch.
        target: the zip, where nobody names another one.
        problems: what is left out and why.
        other_names: of the team, with their runs.
        dossier: with a report though none was made before, and with all samples as tables.
    """

    runs: Mapping[Path, RunSummary]
    title: Sequence[str]
    time: float
    target: Path
    problems: Sequence[str] = ()
    other_names: Sequence[str] = ()
    dossier: bool = False


@dataclass(frozen=True, slots=True)
class Export:
    """A finished zip; `size` in bytes.

    `problems` say what is missing and why, and which results cannot be used.
    """

    path: Path
    runs: int
    files: int
    size: int
    problems: tuple[str, ...]


def pack(
    what: Contents,
    report: Rendering,
    *,
    target: Path | None = None,
    parts: BagParts = BagParts(),
    tell: Callable[[int, int], None] = lambda _done, _total: None,
) -> Export:
    """Packs runs; what cannot be read is named, and the rest is there.

    Args:
        what: the runs.
        report: renders the report of a run as it is now; that in its folder is never packed.
        target: the zip; None = that of `what`.
        parts: of the recordings.
        tell: told how many runs are packed, and of how many.

    Raises:
        MadrobError: the zip cannot be written.
    """
    runs, path = what.runs, target or what.target
    with folder_for(path), whole_file(path) as file, closing(Archive(file)) as archive:
        archive.problems += what.problems
        if protested := [run for run in runs if what.dossier or runs[run].protested]:
            text = protests_text([(_state(run, archive.problems), run.name) for run in protested])
            archive.add_file(PROTESTS_FILE, text, what.time)
        for number, run in enumerate(runs):
            tell(number, len(runs))
            _add_run(archive, run, parts, what, report)
        _add_tables(archive, [*_stored(runs)], what)
        archive.add_file(INDEX_PAGE, index_page(what.title, runs, archive.sums), what.time)
        archive.add_file(SCHEMA_FILE, schema_text(result_schema()), what.time)
        left_out = [*parts.left_out, *archive.problems]
        text = readme(what.title, runs, archive.sums, what.other_names, left_out)
        archive.add_file(README_FILE, text, what.time)
        archive.finish(what.time)
        size = file.tell()
    damaged = (f"{run.name}: {summary.problem}" for run, summary in runs.items() if summary.problem)
    problems = (*damaged, *archive.problems)
    return Export(path, len(runs), len(archive.sums), size, problems)


def _add_run(
    archive: Archive, run: Path, parts: BagParts, what: Contents, report: Rendering
) -> None:
    before = stamp_of(str(run / RESULT_FILE))
    wanted = what.dossier or stamp_of(str(run / REPORT_FILE)) is not None
    rendered, problems = report(run) if wanted else ({}, ())
    archive.problems += [f"{run.name}/{words}" for words in problems]

    def without(path: str) -> bool:  # anybody may have written the report in the folder
        return path in rendered or path == REPORT_FILE or parts.is_without(path)

    archive.add_folder(run, run.name, without)
    for name, data in rendered.items():
        archive.add_file(f"{run.name}/{name}", data, what.time)
    if what.dossier:
        _add_samples(archive, run, what.time)
    if stamp_of(str(run / RESULT_FILE)) != before:
        archive.problems.append(f"{run.name}: its result changed meanwhile: export again")


def _state(run: Path, problems: list[str]) -> Run | str:
    """A run with its protests, or in words why they are not known."""
    try:
        return read_run_journal(run).run
    except (UnusableJournalError, OSError) as error:
        problems.append(f"{run.name}: its protests are not known: {error}")
        return str(error)


def _add_samples(archive: Archive, run: Path, at: float) -> None:
    try:
        sampled = SampledRun.of(RunPath(run))
    except MadrobError as error:
        archive.problems.append(f"tables of the samples: {error}")
        return
    for table in SAMPLE_TABLES:
        with _new_table(archive, f"tables/{run.name}_{table.name}.csv", table, at) as writer:
            writer.write_cells(sampled.columns_of(table))


def _add_tables(archive: Archive, stored: Sequence[StoredRun], what: Contents) -> None:
    for table in RUN_TABLES:
        with _new_table(archive, f"{table.name}.csv", table, what.time) as writer:
            for run in stored:
                place = {"place": run.folder.name}  # no path of this machine
                writer.write_rows({**row, **place} for row in rows_of(table, run))
    archive.add_file(COLUMNS_FILE, columns_text(samples=what.dossier), what.time)


@contextmanager
def _new_table(archive: Archive, name: str, table: TidyTable, at: float) -> Iterator[TableWriter]:
    with archive.new_file(name, at) as file, closing(TableWriter(file, table)) as writer:
        yield writer


def _stored(runs: Iterable[Path]) -> Iterator[StoredRun]:
    for run in runs:
        with suppress(MadrobError):  # the list of runs says why
            yield stored_run(RunPath(run))


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
