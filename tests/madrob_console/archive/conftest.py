from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.madrob_console.archive.frames import FRONT, SIDE_CAMERA, film
from tests.madrob_console.recorded_runs import appealed


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A run with an incident, without evidence, that a test may change."""
    return shutil.copytree(appealed(), tmp_path / appealed().name)


@pytest.fixture
def filmed(run: Path) -> Path:
    film(run, FRONT, SIDE_CAMERA)
    return run
