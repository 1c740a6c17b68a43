"""`python -m madrob_console.cli.aside ...`: work that gives way to everything else.

`page FILE` writes the report of the scored run that comes pickled on the standard input, `repair
FOLDER` makes results of a results folder again that are not what their journals say; anything else
is a `madrob` command.
"""

from __future__ import annotations

import os
import pickle
import signal
import sys
from pathlib import Path
from typing import NoReturn

from madrob_console.engine.process.reporting import PAGE, REPAIR

COMMAND = (sys.executable, "-P", "-m", "madrob_console.cli.aside")
"""What a process is started with that does such work."""

NICENESS = 10
"""Added to the niceness of who starts it: the engine, a run, a screen come first."""


def main() -> int:
    """Work with low priority; a TERM leaves no half file behind; returns the exit code."""
    signal.signal(signal.SIGTERM, _end)
    os.nice(NICENESS)
    if sys.argv[1:2] == [PAGE]:
        _page(Path(sys.argv[2]))
        return 0
    if sys.argv[1:2] == [REPAIR]:
        return _repair(Path(sys.argv[2]))
    from madrob_console.cli.main import main as madrob

    return madrob()


def _page(file: Path) -> None:
    """Write a report without reading and scoring the run again, and without SciPy and pandas.

    What its cameras saw is found and decoded here: whatever they sent, it costs this process.
    """
    from madrob_console.cameras.run_pictures import renewed_pictures
    from madrob_console.cli.problems import BAD_INPUT, complain
    from madrob_console.errors import MadrobError
    from madrob_console.files.whole import atomic_write
    from madrob_console.report.page import report_html
    from madrob_console.report.surroundings import Surroundings
    from madrob_console.version import software_version

    try:
        scored = pickle.load(sys.stdin.buffer)
        seen = renewed_pictures(file.parent, scored)
        place = Surroundings().place_of(file.parent, scored)
        atomic_write(file, report_html(scored, software_version(), place, seen).encode())
    except (MadrobError, OSError, MemoryError) as error:
        complain(str(error) or "no memory: end other programs")
        # the disk, file handles or memory may come back; the run's folder does not
        sys.exit(os.EX_TEMPFAIL if file.parent.is_dir() else BAD_INPUT)


def _repair(results: Path) -> int:
    from madrob_console.cli.problems import BAD_INPUT, complain
    from madrob_console.cli.repairing import repair_all
    from madrob_console.errors import MadrobError

    bad = 0
    try:
        for problem in repair_all(results):
            complain(problem)
            bad += 1
    except MadrobError as error:
        complain(error)
        return BAD_INPUT
    return BAD_INPUT if bad else 0


def _end(number: int, _frame: object) -> NoReturn:
    sys.exit(128 + number)


if __name__ == "__main__":
    sys.exit(main())
