"""The same work on many things: in order, wherever it is done."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Iterator

import joblib
import pytest

from madrob_console.cli.batch import WORTH_A_PROCESS, in_order
from madrob_console.errors import MadrobError
from tests.watching import PATIENCE


class SlowerFirst:
    """The first is not done before another one is, where they are done side by side."""

    def __init__(self) -> None:
        self._another = threading.Event()

    def __call__(self, number: int) -> int:
        if number > 0:
            self._another.set()
        elif threading.current_thread() is not threading.main_thread():
            assert self._another.wait(PATIENCE)
        return -number


def die(number: int) -> int:
    """What a machine without memory does to a process."""
    if number == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return number


@pytest.fixture
def no_joblib(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "joblib", None)


@pytest.mark.parametrize("backend", ["threading", "sequential"])
def test_results_come_in_the_order_of_the_items(backend: str) -> None:
    done = in_order(SlowerFirst(), range(20), jobs=4, backend=backend)
    assert list(done) == [-number for number in range(20)]


def test_a_backend_that_somebody_registered_can_be_named() -> None:
    used = []

    class Cluster(joblib._parallel_backends.ThreadingBackend):  # type: ignore[misc]
        def configure(self, *arguments: object, **named: object) -> int:
            used.append(self)
            return int(super().configure(*arguments, **named))

    joblib.register_parallel_backend("a cluster", Cluster)
    assert list(in_order(abs, [-1, -2], backend="a cluster")) == [1, 2]
    assert used


@pytest.mark.parametrize("name", ["no such thing", "dask", ""])
def test_a_backend_that_is_not_there_is_named_on_one_line(name: str) -> None:
    with pytest.raises(MadrobError, match=f"--backend {name}: ") as refused:
        in_order(abs, [1, 2], backend=name)
    assert "\n" not in str(refused.value)


@pytest.mark.usefixtures("no_joblib")
@pytest.mark.parametrize(("count", "jobs"), [(0, None), (1, 8), (30, 1), (WORTH_A_PROCESS, None)])
def test_one_item_one_job_or_few_items_need_no_process(count: int, jobs: int | None) -> None:
    assert list(in_order(abs, range(count), jobs)) == list(range(count))


def test_a_backend_that_is_named_serves_few_items_too() -> None:
    assert list(in_order(abs, [-1, -2], backend="loky")) == [1, 2]


def test_a_result_is_there_before_the_next_item_is_begun() -> None:
    begun: list[int] = []
    done = in_order(begun.append, range(3), jobs=1)
    next(iter(done))
    assert begun == [0]


def test_leaving_early_says_nothing(capfd: pytest.CaptureFixture[str]) -> None:
    done = in_order(SlowerFirst(), range(20), jobs=2, backend="threading")
    assert isinstance(done, Iterator)
    assert next(done) == 0
    del done
    assert capfd.readouterr().err == ""


@pytest.mark.machine
@pytest.mark.slow
def test_a_process_that_dies_is_told_on_one_line() -> None:
    with pytest.raises(MadrobError, match="a worker process died: make memory free"):
        list(in_order(die, range(8), jobs=2))
    assert list(in_order(abs, range(-8, 0), jobs=2)) == [*range(8, 0, -1)]
