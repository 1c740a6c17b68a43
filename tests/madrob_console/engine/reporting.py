"""What makes reports, pages and zips, without an engine."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from madrob_console.cli import aside
from madrob_console.engine.disk import DiskJobs
from madrob_console.engine.reports import EVERY_REPORT, QUEUE_FOLDER, Reporting, WantedPages
from madrob_console.engine.supervisor import Supervisor

SHORT_PAUSE = 0.2  # s


@contextmanager
def reporting_on(
    results: Path,
    wanted: WantedPages = EVERY_REPORT,
    busy: Callable[[], bool] = lambda: False,
) -> Iterator[Reporting]:
    """Chores that are asked for are done, until the end of the block."""
    write = DiskJobs().submit_job
    queue = results / QUEUE_FOLDER
    reporting = Reporting(aside.COMMAND, queue, results, busy, write, wanted, SHORT_PAUSE)
    supervisor = Supervisor(*reporting.workers)
    try:
        yield reporting
        reporting.finish()
    finally:
        supervisor.close()
