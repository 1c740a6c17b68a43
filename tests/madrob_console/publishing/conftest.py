from __future__ import annotations

from pathlib import Path

import pytest

from madrob_console.archive.folders import REPORT_FILE
from tests.madrob_console.publishing.competition_runs import REPORT, RUNS
from tests.madrob_console.run_folders import write


@pytest.fixture
def results(tmp_path: Path) -> Path:
    """A results folder with the runs, their reports and a plan beside it."""
    root = tmp_path / "results"
    for run in RUNS:
        folder = write(root, run).parent
        (folder / REPORT_FILE).write_text(REPORT.format(other=RUNS[1].folder))
    (tmp_path / "plan.csv").write_text("subject,condition,attempts\n1,7,2\n3,12,2\n9,7,1\n")
    return root
