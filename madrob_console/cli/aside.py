"""`python -m madrob_console.cli.aside ...`: work that gives way to everything else.

`page FILE` writes the report of the run in whose folder this file is, `repair FOLDER` makes results
of a results folder again that are not what their journals say, `renew FOLDER` reports that tell of
other runs than there are now, and what stands behind it is a `madrob` command that is carried out
first; anything else is a `madrob` command.
"""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path
from typing import NoReturn

from madrob_console.engine.reports import OLDER, PAGE, RENEW, REPAIR

COMMAND = (sys.executable, "-P", "-m", "madrob_console.cli.aside")
"""Command line that starts a process for such work."""

NICENESS = 10
"""Added to the niceness of the caller: the engine, a run, a screen come first."""


def main() -> int:
    """Work with low priority; SIGTERM leaves no half-written file behind."""
    signal.signal(signal.SIGTERM, _end)
    os.nice(NICENESS)
    if sys.argv[1:2] == [PAGE]:
        _page(Path(sys.argv[2]))
        return 0
    from madrob_console.cli.main import main as madrob

    if sys.argv[1:2] not in ([REPAIR], [RENEW]):
        return madrob()
    chore, results, *command = sys.argv[1:]
    code = madrob(command) if command else 0
    if (older := _all_of(Path(results), repair=chore == REPAIR)) != 0:
        print(OLDER)
    return code or older


def _page(file: Path) -> None:
    from madrob_console.archive.scored import score_opened
    from madrob_console.cli.output import BAD_INPUT, complain
    from madrob_console.cli.repairing import write_report
    from madrob_console.common.errors import MadrobError
    from madrob_console.pages.surroundings import Surroundings

    try:
        write_report(file.parent, score_opened(file.parent), Surroundings())
    except (MadrobError, OSError, MemoryError) as error:
        complain(str(error) or "no memory: end other programs")
        # the disk, file handles or memory may come back; the run's folder does not
        sys.exit(os.EX_TEMPFAIL if file.parent.is_dir() else BAD_INPUT)


def _all_of(results: Path, *, repair: bool) -> int:
    from madrob_console.cli.output import BAD_INPUT, complain
    from madrob_console.cli.repairing import renew_all, repair_all
    from madrob_console.common.errors import MadrobError

    bad = 0
    try:
        for problem in repair_all(results) if repair else renew_all(results):
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
