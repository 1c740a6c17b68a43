from __future__ import annotations

import os

import pytest
from hypothesis import settings

# textual reads these when it is imported
for name in ("NO_COLOR", "TEXTUAL_THEME", "COLORTERM", "TEXTUAL_COLOR_SYSTEM", "COLUMNS", "LINES"):
    os.environ.pop(name, None)
os.environ["TEXTUAL_ANIMATIONS"] = "none"
os.environ["TERM"] = "xterm-256color"

# a busy machine is not a wrong result
settings.register_profile("madrob", deadline=None)
settings.load_profile("madrob")


def pytest_addoption(parser: pytest.Parser) -> None:
    """How often the slow proofs repeat themselves; whether screens are stored anew."""
    parser.addoption("--runs", type=int, default=20, help="runs of each repeated proof")
    parser.addoption("--update-screens", action="store_true", help="store the screens as they are")
