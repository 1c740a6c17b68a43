from __future__ import annotations

import asyncio
import inspect
import os
import time
from collections.abc import Iterator
from typing import Any

import pytest
from textual._compositor import Compositor
from textual.css.model import RuleSet
from textual.css.stylesheet import Stylesheet

from madrob_console.ui.frame import console_screen
from tests.madrob_console.ui.driver import SMALL, Driver, driving
from tests.madrob_console.ui.inline_engine import HandEngine


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> bool | None:
    """A test may be a coroutine; it runs in the loop of its fixtures."""
    test = pyfuncitem.obj
    if not inspect.iscoroutinefunction(test):
        return None
    given = pyfuncitem.funcargs
    runner = given["runner"]
    assert isinstance(runner, asyncio.Runner)
    runner.run(test(**{name: given[name] for name in inspect.signature(test).parameters}))
    return True


@pytest.fixture(autouse=True)
def runner() -> Iterator[asyncio.Runner]:
    """The loop of a test and its fixtures."""
    with asyncio.Runner() as runner:
        yield runner


def _draw_nothing(compositor: Compositor, **_: object) -> None:
    """No terminal takes the changes: a screen is drawn when a test looks at it."""
    compositor._dirty_regions.clear()


_parse_rules, _parsed = Stylesheet._parse_rules, dict[object, list[RuleSet]]()


def _parse_once(sheet: Stylesheet, *source: Any, **named: Any) -> list[RuleSet]:  # noqa: ANN401
    """All consoles have the same styles."""
    key = (*source, *named.items(), *sheet._variables.items())
    if key not in _parsed:
        _parsed[key] = _parse_rules(sheet, *source, **named)
    return _parsed[key]


@pytest.fixture(autouse=True)
def _clock_and_disk_of_the_screens(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """No run here has to outlast its test: nothing waits until it is on the disk."""
    for sync in ("fsync", "fdatasync"):
        monkeypatch.setattr(os, sync, lambda _: None)
    for period in ("BUSY_PERIOD", "IDLE_PERIOD"):  # the screens look when they are told to
        monkeypatch.setattr(console_screen, period, 3600.0)
    monkeypatch.setattr(Compositor, "render_update", _draw_nothing)
    monkeypatch.setattr(Stylesheet, "_parse_rules", _parse_once)
    monkeypatch.setenv("TZ", "UTC")
    time.tzset()
    yield
    monkeypatch.undo()
    time.tzset()


@pytest.fixture
def engine() -> HandEngine:
    """An engine with a testbed at rest; `driving` ends it."""
    return HandEngine()


@pytest.fixture
def size() -> tuple[int, int]:
    """Columns and rows of the terminal; a test may ask for others."""
    return SMALL


@pytest.fixture
def driver(engine: HandEngine, size: tuple[int, int], runner: asyncio.Runner) -> Iterator[Driver]:
    """The console on the engine."""
    console = driving(engine, size)
    yield runner.run(console.__aenter__())
    runner.run(console.__aexit__(None, None, None))
