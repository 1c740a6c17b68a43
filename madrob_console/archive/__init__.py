"""RUNS ON DISK: folders, results, history, pictures, tables, scoring again, checking, repairing.

What goes on now is in engine; what teams take home is in pages and export. What stands in `__all__`
is the interface for programs, and nothing else is:

    from madrob_console.archive import score, tables

    for run in score("my_run"):
        print(run.path.name, run.result.indicators["execution_time"].text)
    levels = tables("my_results")["indicators"].query("indicator == 'capability_level'")
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from madrob_console.common.errors import MadrobError

if TYPE_CHECKING:
    from pandas import DataFrame

    from madrob_console.archive.scored import ScoredPath
    from scoring.indicator_table import RulesetName

__all__ = ["MadrobError", "result_schema", "score", "tables"]


def score(path: Path | str, rules: RulesetName | None = None) -> Iterator[ScoredPath]:
    """Score a bag or every run of a folder, one after the other, each when it is asked for.

    Args:
        path: a bag, a run folder, a folder with runs at any depth, or one of published
            EUROBENCH files.
        rules: None = the run's own; `protocol` for EUROBENCH files whose run info names none.

    Raises:
        MadrobError: a run cannot be scored; the message names path and remedy.
    """
    # lists of runs do without numpy and SciPy
    from madrob_console.archive.run_paths import runs_at
    from madrob_console.archive.scored import score_run

    return (score_run(run, (rules,))[0] for run in runs_at(Path(path)))


def tables(path: Path | str) -> Mapping[str, DataFrame]:
    """The tables of the runs below a folder, each run once; `madrob table` tells their columns.

    `runs`, `indicators`, `events` and `steps` are of the stored results, `run`, `door`, `handle`,
    `passage` and `latch` of the recordings; `samples` has all readings of the sensors, one below
    the other. Each is made when it is first asked for. Runs that cannot be read are warned of.

    Raises:
        MadrobError: there is no such folder.
    """
    from madrob_console.archive.table_rows import Frames

    return Frames(Path(path))


def result_schema() -> dict[str, Any]:
    """Return the JSON schema (draft 2020-12) of `result.json`."""
    from madrob_console.archive import result_document

    return result_document.result_schema()
