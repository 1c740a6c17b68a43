"""How much evidence the runs of a results folder hold."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

from madrob_console.archive.folders import run_folder_names
from recorder.bag import is_left_of_evidence


def evidence_held(results: Path) -> int:
    """Bytes of all evidence of all runs, practice and official, and of what its repairs have left.

    Raises:
        MadrobError: the results folder cannot be read.
    """
    held = 0
    for name in run_folder_names(results):
        with suppress(OSError), os.scandir(results / name) as entries:
            for entry in entries:
                if is_left_of_evidence(entry.name):
                    held += entry.stat(follow_symlinks=False).st_size
    return held
