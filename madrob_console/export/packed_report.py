"""A run's report as it is packed: its links lead to what is in the zip, or nowhere."""

from __future__ import annotations

import os
import posixpath
from collections.abc import Mapping
from pathlib import Path

from madrob_console.archive.folders import REPORT_FILE
from madrob_console.archive.report_links import led_elsewhere
from madrob_console.export.packed_bag import PackedBag

_NOT_HERE = " (not in this zip)"


def packed_report(
    run: Path,
    packed: Mapping[Path, tuple[str, PackedBag]],
    made: Mapping[str, bytes],
) -> dict[str, bytes]:
    """The report of a run by its name, as it is packed; nothing where none was made.

    Args:
        run: its folder.
        packed: all runs in the zip: how the folder is called there, and the bag as it is packed.
        made: what is packed of the run that is not in its folder, or not so; by name.
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
