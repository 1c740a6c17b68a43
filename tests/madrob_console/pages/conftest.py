from __future__ import annotations

from pathlib import Path

import pytest

from tests.madrob_console.pages.competition_runs import RUNS, publish
from tests.madrob_console.run_folders import write


@pytest.fixture
def results(tmp_path: Path) -> Path:
    """A results folder with the runs and a plan beside it."""
    root = tmp_path / "results"
    for run in RUNS:
        write(root, run)
    (tmp_path / "plan.csv").write_text("subject,condition,attempts\n1,7,2\n3,12,2\n9,7,1\n")
    return root


@pytest.fixture
def site(results: Path) -> Path:
    return publish(results)
