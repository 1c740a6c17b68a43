"""`madrob pictures`: what a run's cameras saw, at its events or at any instant."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from madrob_console.cli import options
from madrob_console.cli.command_line import Argument, command
from madrob_console.cli.output import BAD_INPUT, Complaints
from madrob_console.cli.parsing import as_path, whole_within
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import terminal_safe
from scoring.imports import imports_kept

if TYPE_CHECKING:
    from madrob_console.archive.run_pictures import RunPictures
    from madrob_console.archive.run_record import Moment
    from madrob_console.archive.scored import Scored

_WIDEST = 6000


@command(
    "pictures",
    "what the cameras saw at each event, or at one instant",
    "Takes the nearest frame of each camera. Without --at it makes the folder `pictures` of the "
    "run anew, as a report does. Each line says how far a frame is from what was asked for, by "
    "its time of reception (-12 ms: it is earlier).",
    options=(
        Argument("run", type=as_path, metavar="RUN", help="the folder of a run, or its name"),
        Argument(
            "--at",
            action="append",
            default=[],
            metavar="INSTANT",
            help=f"{options.INSTANT}; may be given again",
        ),
        Argument("--camera", default="*", metavar="GLOB", help="the topics of these cameras only"),
        Argument(
            "--output",
            type=as_path,
            metavar="FOLDER",
            help="where the files go; with --at else the current folder",
        ),
        Argument(
            "--width",
            type=whole_within(16, _WIDEST),
            metavar="PIXELS",
            help=f"the most pixels in a row and in a column, 16 to {_WIDEST}; 960 if not given",
        ),
    ),
    examples=(
        "madrob pictures my_run",
        "madrob pictures my_run --at door_opens --at 12.5 --camera '*front*' --width 1920",
    ),
)
def pictures(arguments: argparse.Namespace) -> int:
    with imports_kept():
        from madrob_console.archive.run_pictures import (
            difference_words,
            nothing_near,
        )

    run: Path = arguments.run
    with Complaints() as bad:
        try:
            made, folder, begin = _made(run, arguments)
        except MadrobError as error:
            bad.add_complaint(error, run)
            return BAD_INPUT
        for problem in made.index.problems:
            bad.add_complaint(problem, run)
        for entry in made.index.pictures:
            if why := nothing_near(entry):
                bad.add_complaint(f"{run}: {entry.topic} at {entry.since_start:.2f} s: {why}", run)
                continue
            path = folder / f"{begin}{entry.file}"
            told = "; ".join(filter(None, (difference_words(entry), entry.scale)))
            print(terminal_safe(f"{path}: {told}"))
    return 0 if made.files else BAD_INPUT


def _made(run: Path, arguments: argparse.Namespace) -> tuple[RunPictures, Path, str]:
    """The pictures, the folder they were written to, and the prefix of their names."""
    from madrob_console.archive.folders import PICTURES_FOLDER
    from madrob_console.archive.nearest_frames import SIDE, has_evidence
    from madrob_console.archive.run_pictures import moments_in, pictures_of, renewed_pictures
    from madrob_console.archive.scored import score_opened
    from madrob_console.common.files import atomic_writes

    if not run.is_dir():
        raise MadrobError(f"{run}: no such run folder: name the folder of a run")
    if not has_evidence(run):
        raise MadrobError(f"{run}: {_why_no_evidence(run)}")
    output: Path | None = arguments.output
    whole = not arguments.at and output is None
    if whole and (arguments.camera != "*" or arguments.width is not None):
        raise MadrobError(f"{run}: some pictures are not all: say where to by --output FOLDER")
    scored = score_opened(run)
    if whole:
        return _with_cameras(renewed_pictures(run, scored), run, "*"), run / PICTURES_FOLDER, ""
    moments = _asked(run, arguments.at, scored) if arguments.at else moments_in(scored)
    mappings, side = scored.record.mappings, arguments.width or SIDE
    told = bool(arguments.at)
    made = pictures_of(run, moments, mappings, arguments.camera, side, name_distance=told)
    _with_cameras(made, run, arguments.camera)
    folder = output or Path()
    within = folder.resolve().is_relative_to(run.resolve())
    begin = "" if within else f"{run.absolute().name}_"
    if made.files:
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise MadrobError(
                f"{folder}: cannot be made ({error.strerror}): choose another --output"
            ) from None
        atomic_writes(folder, {f"{begin}{name}": data for name, data in made.files.items()})
    return made, folder, begin


def _why_no_evidence(folder: Path) -> str:
    from madrob_console.archive.run_journal import UnusableJournalError, read_run_journal

    choose = "choose the folder of a run that was recorded with cameras"
    try:
        run = read_run_journal(folder).run
    except FileNotFoundError:
        if any(folder.glob("*.mcap")):
            return f"holds no evidence: {choose}"
        return "no run is there: name the folder of a run"
    except UnusableJournalError:
        return f"holds no evidence: {choose}"
    if run.removed_evidence:
        return f"its evidence was removed by `madrob tidy` ({run.removed_evidence[-1].words})"
    if run.evidence is None or not any(topic.messages for topic in run.evidence.topics):
        return f"was recorded without evidence: {choose}"
    return f"its evidence is gone ({run.evidence.words} were recorded): look where its files are"


def _with_cameras(made: RunPictures, run: Path, wanted: str) -> RunPictures:
    if not made:
        raise MadrobError(f"{run}: no camera {wanted} in its evidence: see `ros2 bag info`")
    return made


def _asked(run: Path, at: Sequence[str], scored: Scored) -> list[Moment]:
    from madrob_console.archive.run_pictures import events_of
    from madrob_console.archive.run_record import moments_called

    events, start = events_of(scored), scored.result.start
    try:
        return [one for text in at for one in moments_called(text, events, scored.run, start)]
    except MadrobError as error:
        raise MadrobError(f"{run}: {error}") from None
