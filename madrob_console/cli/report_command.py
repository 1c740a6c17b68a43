"""`madrob report`: a page of recorded runs; of old ones too."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from madrob_console.cli import options
from madrob_console.cli.command_line import Argument, command
from madrob_console.cli.output import BAD_INPUT, Complaints
from madrob_console.cli.parsing import as_path
from madrob_console.cli.progress import counted_off
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import terminal_safe

if TYPE_CHECKING:
    from madrob_console.pages.related_runs import RelatedRuns


@command(
    "report",
    "a run's page for its team",
    "The page is report.html in the run folder.",
    options=(
        options.PATHS,
        Argument(
            "--output",
            type=as_path,
            metavar="FOLDER",
            help="folder for all pages, <run>_report.html each",
        ),
    ),
    examples=(
        "madrob report my_run",
        "madrob report --output pages ~/madrob_runs",
    ),
)
def report(arguments: argparse.Namespace) -> int:
    from madrob_console.archive.run_paths import all_runs_at
    from madrob_console.pages.related_runs import RelatedRuns

    around = RelatedRuns()
    written: set[Path] = set()
    runs = list(dict.fromkeys(run.path for run in all_runs_at(arguments.paths)))
    with Complaints() as bad:
        for run in counted_off(runs, "runs"):
            with bad.complaining(run):
                _make(run, arguments.output, written, around)
    return BAD_INPUT if bad.count else 0


def _make(path: Path, output: Path | None, written: set[Path], around: RelatedRuns) -> None:
    from madrob_console.common.files import atomic_write, make_folder

    target, page = _page(path, output, around)
    if target in written:
        raise MadrobError(f"{path}: {target} is another run's already: choose another --output")
    make_folder(target.parent, "choose another --output")
    atomic_write(target, page)
    written.add(target)
    print(terminal_safe(str(target)))


def _page(path: Path, output: Path | None, around: RelatedRuns) -> tuple[Path, bytes]:
    from madrob_console.archive.folders import REPORT_FILE
    from madrob_console.archive.pictures import pictures_of
    from madrob_console.archive.scored import score_opened
    from madrob_console.common.version import software_version
    from madrob_console.pages.related_runs import NOWHERE
    from madrob_console.pages.report import report_html

    if _published(path):
        raise MadrobError(
            f"{path}: published files tell nothing of the referee: `result.figures()` of the "
            "library draws them"
        )
    scored = score_opened(path)
    target = _target(path, output, REPORT_FILE)
    place = around.place_of(path, scored) if output is None else NOWHERE
    pictures = pictures_of(path, scored)
    return target, report_html(scored, software_version(), place, pictures).encode()


def _published(path: Path) -> bool:
    return any(path.glob("*_event.csv")) and not any(path.glob("*.mcap"))


def _target(path: Path, output: Path | None, name: str) -> Path:
    """In the run's folder, or in `output` under the run's name; beside a bag that is a file."""
    whole = path.absolute()
    if whole.is_dir():
        return whole / name if output is None else output / f"{whole.name}_{name}"
    return (output or whole.parent) / f"{whole.stem}_{name}"
