"""`madrob report`: a page, or pictures, of recorded runs; of old ones too."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from madrob_console.cli import options
from madrob_console.cli.command_line import Argument, command
from madrob_console.cli.output import BAD_INPUT, Complaints, complain
from madrob_console.cli.parsing import as_path
from madrob_console.cli.progress import counted_off
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import terminal_safe
from madrob_console.pages import PictureFormat
from scoring.imports import imports_kept

if TYPE_CHECKING:
    from madrob_console.pages.related_runs import RelatedRuns
    from scoring.protocol import Condition
    from scoring.result import Result
    from scoring.rows import Rows

NamedFile: TypeAlias = tuple[Path, bytes]


@command(
    "report",
    "a run's page for its team, or its figures alone",
    "The page is report.html in the run folder. Of EUROBENCH folders the figures only.",
    options=(
        options.PATHS,
        options.choice(
            "--figures",
            PictureFormat,
            "figures of this format instead of the page; html: one page that zooms",
        ),
        Argument(
            "--output",
            type=as_path,
            metavar="FOLDER",
            help="folder for all pages, <run>_report.html each",
        ),
    ),
    examples=(
        "madrob report my_run",
        "madrob report --figures svg --output figures my_run",
        "madrob report --figures html my_run      # signals.html: look closely, for a protest",
    ),
)
def report(arguments: argparse.Namespace) -> int:
    with imports_kept():
        from madrob_console.archive.run_paths import all_runs_at
        from madrob_console.pages.related_runs import RelatedRuns

    around = RelatedRuns()
    written: set[Path] = set()
    runs = list(dict.fromkeys(run.path for run in all_runs_at(arguments.paths)))
    with Complaints() as bad:
        for run in counted_off(runs, "runs"):
            with bad.complaining(run):
                _make(run, arguments.figures, arguments.output, written, around)
    return BAD_INPUT if bad.count else 0


def _make(
    path: Path,
    pictures: PictureFormat | None,
    output: Path | None,
    written: set[Path],
    around: RelatedRuns,
) -> None:
    from madrob_console.common.files import atomic_write, make_folder

    files = _page(path, output, around) if pictures is None else _pictures(path, pictures, output)
    for target, data in files:
        if target in written:
            raise MadrobError(f"{path}: {target} is another run's already: choose another --output")
        make_folder(target.parent, "choose another --output")
        atomic_write(target, data)
        written.add(target)
        print(terminal_safe(str(target)))


def _page(path: Path, output: Path | None, around: RelatedRuns) -> Iterator[NamedFile]:
    with imports_kept():
        from madrob_console.archive.folders import REPORT_FILE
        from madrob_console.archive.run_pictures import renewed_pictures, run_pictures
        from madrob_console.archive.scored import score_opened
        from madrob_console.common.version import software_version
        from madrob_console.pages.related_runs import NOWHERE
        from madrob_console.pages.report import report_html

    if _published(path):
        raise MadrobError(
            f"{path}: published files tell nothing of the referee: use `--figures svg` for them"
        )
    scored = score_opened(path)
    target = _target(path, output, REPORT_FILE)
    place = around.place_of(path, scored) if output is None else NOWHERE
    pictures = (renewed_pictures if output is None else run_pictures)(path, scored)
    yield target, report_html(scored, software_version(), place, pictures).encode()


def _pictures(path: Path, pictures: PictureFormat, output: Path | None) -> Iterator[NamedFile]:
    if pictures is PictureFormat.HTML:
        from madrob_console.pages.signal_charts import signals_html

        for run, result, rows, condition, banners in _results(path):
            name = run.rstrip("_") or path.name
            page = signals_html(name, result, rows, condition, banners)
            yield _target(path, output, f"{run}signals.html"), page.encode()
        return
    try:
        with imports_kept():
            from scoring.figures.plots import figures_of, missing_figures, png, svg
    except ModuleNotFoundError:
        from madrob_console.pages.report_pictures import NO_MATPLOTLIB

        raise MadrobError(f"{path}: no figures: {NO_MATPLOTLIB}") from None

    for run, result, rows, condition, _ in _results(path):
        for name, figure in figures_of(result, rows, condition).items():
            data = png(figure) if pictures is PictureFormat.PNG else svg(figure).encode()
            yield _target(path, output, f"{run}{name}.{pictures}"), data
        for name, reason in missing_figures(result, rows).items():
            complain(f"{path}: {run}no figure {name.number}: {reason}")


def _results(path: Path) -> Iterator[tuple[str, Result, Rows, Condition, Sequence[str]]]:
    """The last is why the run is not official; published files do not say it."""
    with imports_kept():
        from madrob_console.archive import score
        from madrob_console.archive.scored import score_opened
        from madrob_console.pages.notes import unofficial_words

    if _published(path):
        for part in score(path):
            yield f"{part.path.name}_", part.result, part.result.rows, part.result.condition, ()
    else:
        scored = score_opened(path)
        record = scored.record
        banners = tuple(unofficial_words(record))
        yield "", scored.result, scored.rows, record.setup.condition, banners


def _published(path: Path) -> bool:
    return any(path.glob("*_event.csv")) and not any(path.glob("*.mcap"))


def _target(path: Path, output: Path | None, name: str) -> Path:
    """In the run's folder, or in `output` under the run's name; beside a bag that is a file."""
    whole = path.absolute()
    if whole.is_dir():
        return whole / name if output is None else output / f"{whole.name}_{name}"
    return (output or whole.parent) / f"{whole.stem}_{name}"
