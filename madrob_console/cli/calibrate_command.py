"""`madrob calibrate`: recordings of a new testbed to settings."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from madrob_console.cli import options
from madrob_console.cli.command_line import Argument, MadrobCommand, command
from madrob_console.cli.output import complain
from madrob_console.cli.parsing import as_path, number_within
from madrob_console.cli.progress import progress
from madrob_console.common.names import terminal_safe
from scoring.protocol import Side

if TYPE_CHECKING:
    from madrob_console.cli.testbed_calibration import CalibrationRecording

_RECORD = """\

How to record: `ros2 bag record -s mcap -o NAME --all`, or start a run, move the door and abort \
it: its folder holds the recording. Topics, types and units are those of the settings."""


_FILES = (
    Argument("--output", type=as_path, metavar="FILE", help="file for the settings"),
    options.SETTINGS,
)


@command(
    "masks",
    "the ten masks and the lintel height, as settings",
    "Swing the panel slowly, at about 0.2 rad/s, from closed to wide open on both sides and back, "
    "at least twice, brake off, with nobody within the sensors' reach: push it by a stick. Several "
    "recordings count together, one a side for example." + _RECORD,
    options=(
        Argument("paths", nargs="+", type=as_path, metavar="PATH", help="a bag or a run folder"),
        *_FILES,
    ),
    examples=("madrob calibrate masks sweep_cw sweep_ccw --output masks.toml",),
)
def _masks(arguments: argparse.Namespace) -> int:
    from madrob_console.cli.testbed_calibration import masks_of, masks_toml, sweep_recordings
    from madrob_console.config import load_settings

    settings = load_settings(arguments.settings)
    with progress("recordings"):
        recordings = sweep_recordings(arguments.paths, settings)
        proposal = masks_of(recordings, settings)
    _note_problems(recordings)
    return _propose(masks_toml(proposal), arguments.output)


@command(
    "handle",
    "zero and scale of the handle's force, as settings",
    "Record some seconds at rest, then some seconds with a known weight that pulls at the handle "
    "over a pulley, straight to one side, door blocked." + _RECORD,
    options=(
        Argument("rest", type=as_path, metavar="REST", help="recording without the weight"),
        Argument("weight", type=as_path, metavar="WEIGHT", help="recording with the weight"),
        Argument(
            "--mass",
            type=number_within(0.01, 1000),
            required=True,
            metavar="KG",
            help="of the weight",
        ),
        options.choice("--towards", Side, "side to which the weight pulls the handle", Side.CCW),
        *_FILES,
    ),
    examples=("madrob calibrate handle rest weight --mass 2 --towards ccw",),
)
def _handle(arguments: argparse.Namespace) -> int:
    from madrob_console.cli.testbed_calibration import (
        forces_of,
        handle_mapping,
        handle_recording,
        handle_toml,
    )
    from madrob_console.config import load_settings
    from scoring.calibration import propose_handle

    mapping = handle_mapping(load_settings(arguments.settings))
    paths = (arguments.rest, arguments.weight)
    with progress("recordings"):
        recordings = [handle_recording(path, mapping) for path in paths]
        rest, weight = map(forces_of, recordings)
    _note_problems(recordings)
    proposal = propose_handle(rest, weight, arguments.mass, arguments.towards)
    return _propose(handle_toml(proposal, mapping), arguments.output)


calibrate = MadrobCommand(
    "calibrate",
    "masks, lintel height and handle of a new testbed",
    examples=("madrob calibrate masks --help", "madrob calibrate handle --help"),
    parts=(_masks, _handle),
)


def _note_problems(recordings: Iterable[CalibrationRecording]) -> None:
    for recording in recordings:
        if recording.problem is not None:
            complain(f"note: {recording.problem}")


def _propose(toml: str, output: Path | None) -> int:
    from madrob_console.common.files import atomic_write

    if output is not None:
        atomic_write(output, toml.encode())
    print("\n".join(terminal_safe(line) for line in toml.splitlines()))
    if output is not None:
        print(f"written to {terminal_safe(str(output))}", file=sys.stderr)
    return 0
