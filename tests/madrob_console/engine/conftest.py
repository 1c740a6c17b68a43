from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from scoring.kinematics import load_filters
from tests.madrob_console.engine.drive import FaultyDrive


@pytest.fixture(autouse=True, scope="session")
def _filters_are_loaded() -> None:
    """As in an engine that has run for a second: their import would hold up the others' threads."""
    load_filters()


@pytest.fixture
def hall(tmp_path: Path) -> Iterator[FaultyDrive]:
    hall = FaultyDrive(tmp_path)
    yield hall
    hall.engine.close()
