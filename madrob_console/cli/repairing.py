"""Completes results and reports of a results folder after a power cut."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from madrob_console.archive.folders import JOURNAL_FILE, REPORT_FILE, run_folder_names
from madrob_console.archive.history import History
from madrob_console.archive.unfinished_runs import is_held
from madrob_console.common.errors import MadrobError
from madrob_console.common.files import atomic_write
from madrob_console.common.plain_files import OpenFolder, stamp_of
from madrob_console.pages.related_runs import RelatedRuns, has_report, report_is_old
from recorder.bag import METADATA_FILE

if TYPE_CHECKING:
    from madrob_console.archive.scored import Scored


def repair_run(folder: Path, *, restore: bool = False) -> bool:
    """Remake result and report of a run if they contradict its journal; returns whether it wrote.

    `restore`: see `repair`.
    """
    # they load numpy and SciPy, which most looks at a results folder do without
    from madrob_console.archive.repair import repair
    from madrob_console.archive.scored import score_opened

    scored = repair(folder, restore=restore)
    if scored is None and report_is_old(folder):
        scored = score_opened(folder)
    if scored is None:
        return False
    if has_report(folder):
        write_report(folder, scored, RelatedRuns())
    return True


def renew_report(folder: Path, around: RelatedRuns) -> None:
    from madrob_console.archive.scored import score_once

    write_report(folder, score_once(folder), around)


def write_report(folder: Path, scored: Scored, around: RelatedRuns) -> None:
    from madrob_console.archive.pictures import pictures_of
    from madrob_console.common.version import software_version
    from madrob_console.pages.report import report_html

    pictures = pictures_of(folder, scored)
    page = report_html(scored, software_version(), around.place_of(folder, scored), pictures)
    try:
        with OpenFolder(folder) as opened:
            atomic_write(opened.inside / REPORT_FILE, page.encode())
    except OSError as error:
        raise MadrobError(f"{folder}: no folder of a run ({error.strerror})") from None


def repair_all(root: Path) -> Iterator[str]:
    """Remake results and reports that are out of date; yields in words what cannot be."""
    repairable = {root / run.folder for run in History(root).refresh() if run.repairable}
    for name in run_folder_names(root):
        folder = root / name
        if is_held(folder / JOURNAL_FILE):
            continue  # an engine works on it
        try:
            if folder in repairable or report_is_old(folder):
                repair_run(folder)
        except MadrobError as error:
            yield str(error)
    yield from renew_all(root)


def renew_all(root: Path) -> Iterator[str]:
    """Remake the reports that name other runs of their team than there are now.

    Yields what could not be remade, in words.
    """
    around = RelatedRuns()
    yield from renew_reports(around.old_reports(root), around)


def renew_reports(folders: Iterable[Path], around: RelatedRuns) -> Iterator[str]:
    """Remake the reports of runs; yields what could not be remade, in words."""
    for folder in folders:
        try:
            renew_report(folder, around)
        except MadrobError as error:
            yield str(error)


def without_report(root: Path) -> list[Path]:
    """Folders of runs with a result and a recording, but no report; the newest run first."""
    runs = [root / run.folder for run in History(root).refresh() if run.outcome is not None]
    bags = [run for run in reversed(runs) if stamp_of(str(run / METADATA_FILE)) is not None]
    return [run for run in bags if not has_report(run)]
