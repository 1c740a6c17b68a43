from __future__ import annotations

import asyncio
import inspect
import time
from collections.abc import Iterator

import pytest

from madrob_console.engine.requests import Request
from tests.madrob_console.ui.driver import SMALL, Driver, driving
from tests.madrob_console.ui.fake_engine import FakeEngine, SlowEngine


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> bool | None:
    """A test may be a coroutine; it runs in the loop of its fixtures, else in one of its own."""
    if not inspect.iscoroutinefunction(pyfuncitem.obj):
        return None
    names = inspect.signature(pyfuncitem.obj).parameters
    with asyncio.Runner() as own:
        runner = pyfuncitem.funcargs.get("runner", own)
        assert isinstance(runner, asyncio.Runner)
        runner.run(pyfuncitem.obj(**{name: pyfuncitem.funcargs[name] for name in names}))
    return True


@pytest.fixture
def runner() -> Iterator[asyncio.Runner]:
    """The loop of a test and its fixtures."""
    with asyncio.Runner() as runner:
        yield runner


@pytest.fixture(autouse=True)
def _clock_of_the_screens(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("TZ", "UTC")
    time.tzset()
    yield
    monkeypatch.undo()
    time.tzset()


@pytest.fixture
def engine() -> FakeEngine:
    """An engine with a testbed at rest."""
    return FakeEngine()


@pytest.fixture
def slow_engine(monkeypatch: pytest.MonkeyPatch) -> SlowEngine:
    """One that answers when it is told to, however busy the machine is."""
    monkeypatch.setattr(Request, "timeout", 600.0)
    return SlowEngine()


@pytest.fixture
def size() -> tuple[int, int]:
    """Columns and rows of the terminal; a test may ask for others."""
    return SMALL


@pytest.fixture
def driver(engine: FakeEngine, size: tuple[int, int], runner: asyncio.Runner) -> Iterator[Driver]:
    """The console on the engine."""
    console = driving(engine, size)
    yield runner.run(console.__aenter__())
    runner.run(console.__aexit__(None, None, None))


@pytest.fixture
def running(driver: Driver, runner: asyncio.Runner) -> Driver:
    """The console while a run goes on."""
    runner.run(driver.run())
    return driver
