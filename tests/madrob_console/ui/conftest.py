from __future__ import annotations

import asyncio
import inspect
import os
import time
from collections.abc import Iterator

import pytest

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


@pytest.fixture(autouse=True)
def _clock_and_disk_of_the_screens(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """No run here has to outlast its test: nothing waits until it is on the disk."""
    for sync in ("fsync", "fdatasync"):
        monkeypatch.setattr(os, sync, lambda _: None)
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
