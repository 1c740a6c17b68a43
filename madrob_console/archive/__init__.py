"""RUNS ON DISK: folders, results, history, pictures, tables, scoring again, checking, repairing.

What goes on now is in engine; what teams take home is in pages and export.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from madrob_console.archive.scored import ScoredPath
    from scoring.rulesets import RulesetName


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
    from madrob_console.archive.folders import runs_at
    from madrob_console.archive.scored import score_run

    return (score_run(run, (rules,))[0] for run in runs_at(Path(path)))
