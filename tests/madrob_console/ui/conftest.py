from __future__ import annotations

import pytest

from tests.madrob_console.ui.fake_engine import FakeEngine


@pytest.fixture
def engine() -> FakeEngine:
    """An engine with a testbed at rest."""
    return FakeEngine()
