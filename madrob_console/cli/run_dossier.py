"""`madrob export --run RUN --dossier`: page and tables are made for it, the rest lies there."""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from madrob_console.errors import MadrobError
from scoring.imports import imports_kept

if TYPE_CHECKING:
    from madrob_console.export.pack import Export
    from madrob_console.report.surroundings import Surroundings


def check_options(arguments: argparse.Namespace) -> None:
    """A dossier is of one run, all else of a team.

    Raises:
        MadrobError: what is given does not belong together.
    """
    of_run = arguments.run is not None
    if of_run is not arguments.dossier:
        raise MadrobError("one run is packed as a dossier: give --run RUN with --dossier")
    if not of_run and arguments.subject is None:
        raise MadrobError("whose runs? give --subject N, or --run RUN --dossier for one run")
    of_team = arguments.subject is not None or arguments.practice or arguments.paths
    if of_run and (of_team or arguments.competition is not None):
        raise MadrobError(
            "--run names the run: leave out --subject, --practice, --competition and PATH"
        )


def make_dossier(arguments: argparse.Namespace, tell_size: Callable[[int, int], None]) -> Export:
    """Make the zip of the run that is named.

    Raises:
        MadrobError: there is no such run, it goes on, or the zip cannot be written.
    """
    with imports_kept():
        from madrob_console.archive.folders import JOURNAL_FILE
        from madrob_console.export.dossier import check_dossier, dossier_target, export_dossier
        from madrob_console.export.packed_bag import BagParts
        from madrob_console.report.surroundings import Surroundings

    run: Path = arguments.run.absolute()
    check_dossier(run)
    made, problems = rendered_report(run, Surroundings())
    with _tables(run, (run / JOURNAL_FILE).stat().st_mtime) as (tables, why):
        return export_dossier(
            run,
            arguments.output or dossier_target(run),
            time.time(),
            made=made,
            tables=tables,
            problems=(*problems, *why),
            parts=BagParts(not arguments.without_bags, not arguments.without_evidence),
            tell_size=tell_size,
        )


def rendered_report(run: Path, around: Surroundings) -> tuple[dict[str, bytes], list[str]]:
    """The report of a run as it is now, with its pictures where there are none; and what is wrong.

    Only the zip has it. The files are named as in the run's folder.
    """
    with imports_kept():
        from madrob_console.archive.folders import PICTURES_FOLDER, REPORT_FILE
        from madrob_console.archive.scored import score_opened
        from madrob_console.cameras.run_pictures import run_pictures, stored_pictures
        from madrob_console.report.page import report_html
        from madrob_console.version import software_version

    try:
        scored = score_opened(run)
    except MadrobError as error:
        return {}, [f"{REPORT_FILE}: cannot be made: {error}"]
    place = around.place_of(run, scored)
    seen, new = stored_pictures(run), {}
    if not seen:
        seen = run_pictures(run, scored)
        new = {f"{PICTURES_FOLDER}/{name}": data for name, data in seen.files.items()}
    page = report_html(scored, software_version(), place, seen).encode()
    return {REPORT_FILE: page, **new}, []


@contextmanager
def _tables(run: Path, at: float) -> Iterator[tuple[Path | None, list[str]]]:
    """A folder with the samples as tables while inside; and why there are none.

    Args:
        run: its folder.
        at: what the tables are stamped with, s since the epoch.
    """
    with imports_kept():
        from madrob_console.archive.run_paths import RunPath
        from madrob_console.cli.table_command import write_samples
        from madrob_console.tidy.tidy_table import TableFormat

    try:
        folder = TemporaryDirectory(prefix="madrob_dossier_")
    except OSError as error:
        yield None, [f"tables of the samples: no room for them ({error.strerror})"]
        return
    with folder as name:
        output = Path(name)
        written = write_samples(RunPath(run), output=output, rules=None, kind=TableFormat.CSV)
        for file in written.files:
            os.utime(file, (at, at))
        problem = written.problem
        yield output, [] if problem is None else [f"tables of the samples: {problem}"]
