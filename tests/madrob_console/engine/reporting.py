"""What makes reports, pages and zips, without an engine."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from madrob_console.cli import chore_worker
from madrob_console.engine.runtime.reports import EVERY_REPORT, Reporting, WantedPages
from madrob_console.engine.runtime.supervisor import Supervisor
from tests.watching import until

SHORT_PAUSE = 0.2  # s


def no_reporting(results: Path) -> Reporting:
    """No process makes what an engine asks for."""
    return Reporting((), results)


@contextmanager
def reporting_on(
    results: Path,
    wanted: WantedPages = EVERY_REPORT,
) -> Iterator[Reporting]:
    """Chores that are asked for are done, until the end of the block."""
    reporting = Reporting(chore_worker.COMMAND, results, wanted, SHORT_PAUSE)
    supervisor = Supervisor(*reporting.workers)
    try:
        yield reporting
        reporting.finish()
    finally:
        supervisor.close()


def told_of(reporting: Reporting, words: str) -> str:
    """What is told of what cannot be made, once it holds these words."""
    until(lambda: words in (reporting.problem or ""))
    return str(reporting.problem)
