from __future__ import annotations

import pytest

from scoring.kinematics import load_filters


@pytest.fixture(autouse=True, scope="session")
def _filters_are_loaded() -> None:
    """As in an engine that has run for a second: their import would hold up the others' threads."""
    load_filters()
