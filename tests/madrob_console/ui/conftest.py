from __future__ import annotations

import pytest

from madrob_console.engine.shown.requests import Request
from tests.madrob_console.ui.fake_engine import FakeEngine, SlowEngine


@pytest.fixture
def engine() -> FakeEngine:
    """An engine with a testbed at rest."""
    return FakeEngine()


@pytest.fixture
def slow_engine(monkeypatch: pytest.MonkeyPatch) -> SlowEngine:
    """One that answers when it is told to, however busy the machine is."""
    monkeypatch.setattr(Request, "timeout", 600.0)
    return SlowEngine()
