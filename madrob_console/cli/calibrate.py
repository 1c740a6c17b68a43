"""`madrob calibrate`: recordings of a new testbed to settings."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable

from madrob_console.cli.arguments_common import BAD_INPUT
from madrob_console.config import load_settings
from madrob_console.errors import MadrobError
from madrob_console.files.whole import atomic_write
from madrob_console.names import terminal_safe
from madrob_console.preparing.testbed_calibration import (
    Recording,
    handle_mapping,
    handle_recording,
    handle_toml,
    level_of,
    masks_of,
    masks_toml,
    sweep_recordings,
)
from recorder.errors import RecorderError
from scoring.calibration.handle_scale import propose_handle
from scoring.errors import ScoringError


def main(arguments: argparse.Namespace) -> int:
    """Propose settings; a recording that cannot be trusted is refused in one line."""
    try:
        text = _masks(arguments) if arguments.part == "masks" else _handle(arguments)
        if arguments.output is not None:
            atomic_write(arguments.output, text.encode())
    except (MadrobError, RecorderError, ScoringError) as error:
        print(f"madrob: {terminal_safe(str(error))}", file=sys.stderr)
        return BAD_INPUT
    print("\n".join(terminal_safe(line) for line in text.splitlines()))
    if arguments.output is not None:
        print(f"written to {terminal_safe(str(arguments.output))}", file=sys.stderr)
    return 0


def _masks(arguments: argparse.Namespace) -> str:
    settings = load_settings(arguments.settings)
    recordings = sweep_recordings(arguments.paths, settings)
    found = masks_of(recordings, settings)
    _tell_problems(recordings)
    return masks_toml(found)


def _handle(arguments: argparse.Namespace) -> str:
    mapping = handle_mapping(load_settings(arguments.settings))
    recordings = [handle_recording(path, mapping) for path in (arguments.rest, arguments.weight)]
    rest, weight = map(level_of, recordings)
    _tell_problems(recordings)
    return handle_toml(propose_handle(rest, weight, arguments.mass, arguments.towards), mapping)


def _tell_problems(recordings: Iterable[Recording]) -> None:
    for recording in recordings:
        if recording.problem is not None:
            print(f"madrob: note: {terminal_safe(recording.problem)}", file=sys.stderr)
