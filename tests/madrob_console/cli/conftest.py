from __future__ import annotations

from pathlib import Path

import pytest

from tests.madrob_console.cli.typed import Madrob


@pytest.fixture(autouse=True)
def _own_settings(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))


@pytest.fixture
def madrob(capsys: pytest.CaptureFixture[str]) -> Madrob:
    return Madrob(capsys)
