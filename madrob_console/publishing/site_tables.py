"""The tables for programs that lie on the site: of its runs, and of nothing else."""

from __future__ import annotations

from contextlib import closing
from hashlib import sha256
from io import BytesIO

from madrob_console.archive.folders import RESULT_FILE
from madrob_console.archive.history import RunSummary
from madrob_console.archive.run_paths import RunPath
from madrob_console.archive.stored_runs import stored_run
from madrob_console.errors import MadrobError
from madrob_console.files.bounded import stamp_of
from madrob_console.publishing.site_content import SiteContent
from madrob_console.tidy.run_rows import cells_of, rows_of
from madrob_console.tidy.run_tables import RUN_TABLES
from madrob_console.tidy.tidy_table import TableFormat, TidyTable


class RunTables:
    """Makes them of the stored results, which are read once for all tables.

    Args:
        content: of the site.

    Attributes:
        whole: whether every run could be read.
    """

    def __init__(self, content: SiteContent) -> None:
        self.whole = True
        self._content = content
        self._rows: dict[str, list[dict[str, object]]] | None = None

    @property
    def key(self) -> str:
        """Of what they are made: all results, as they are now."""
        content = self._content
        told = [
            f"{run.folder} {stamp_of(f'{content.source(run)}/{RESULT_FILE}')} {run.voided}"
            for run in self._runs()
        ]
        return sha256(
            "\n".join((content.software, *told)).encode(errors="surrogateescape")
        ).hexdigest()

    def csv(self, table: TidyTable) -> bytes:
        """One of the tables."""
        from madrob_console.tidy.table_files import TableWriter  # it loads pandas

        if self._rows is None:
            self._rows = self._read()
        file = BytesIO()
        with closing(TableWriter(file, table, TableFormat.CSV)) as writer:
            writer.add(cells_of(table, self._rows[table.name]))
        return file.getvalue()

    def _runs(self) -> list[RunSummary]:
        return [run for run in self._content.runs if run.folder in self._content.places]

    def _read(self) -> dict[str, list[dict[str, object]]]:
        found: dict[str, list[dict[str, object]]] = {table.name: [] for table in RUN_TABLES}
        for run in self._runs():
            try:
                stored = stored_run(RunPath(self._content.source(run)))
                of_run = {table.name: list(rows_of(table, stored)) for table in RUN_TABLES}
            except MadrobError:
                self.whole = False  # it changes just now: the next time it is there
                continue
            for table in RUN_TABLES:
                place = self._content.places[run.folder]  # no path of this machine
                own = {"place": place} if any(c.name == "place" for c in table.columns) else {}
                found[table.name] += [{**row, **own} for row in of_run[table.name]]
        return found
