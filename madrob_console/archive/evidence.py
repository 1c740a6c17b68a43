"""The evidence of a run on disk: cameras and other topics, from which nothing is scored."""

from __future__ import annotations

import os
from pathlib import Path

from madrob_console.archive.digests import listed_in
from madrob_console.archive.folders import JOURNAL_FILE
from madrob_console.archive.unfinished import is_held
from madrob_console.errors import MadrobError
from recorder.bag import is_evidence
from recorder.errors import RecorderError


def repair_evidence(folder: Path) -> bool:
    """Repair the evidence of a run that was cut off; a run that goes on is left alone.

    Only evidence that `metadata.yaml` does not list is opened: what is listed is whole.

    Returns:
        Whether anything was written.

    Raises:
        MadrobError: the folder cannot be read or written.
    """
    try:
        names = [name for name in os.listdir(folder) if is_evidence(name)]  # noqa: PTH208
    except OSError:
        return False  # the history says what is wrong with it
    if not names or set(names) <= set(listed_in(folder)) or is_held(folder / JOURNAL_FILE):
        return False
    from recorder.recovery import recover_evidence  # few runs need it

    try:
        return any(file.changed for file in recover_evidence(folder))
    except RecorderError as error:
        raise MadrobError(str(error)) from None
