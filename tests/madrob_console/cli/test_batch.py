"""The same work on many things: in order, wherever it is done."""

from __future__ import annotations

import errno
import os
import random
import shutil
import signal
import threading
from collections.abc import Sequence
from itertools import count
from pathlib import Path
from unittest.mock import Mock

import pytest
from hypothesis import given
from hypothesis import strategies as st

from madrob_console.cli.sharing import (
    AgainError,
    DeadWorkerError,
    children_spared,
    in_order,
)
from madrob_console.cli.sharing import results as results_of
from tests.madrob_console.archive.frames import film
from tests.madrob_console.cli.typed import Madrob
from tests.madrob_console.recorded_runs import completed


class Chance:
    """Workers that are done in any order, and some of which die."""

    def __init__(self, seed: int, deadly: frozenset[int] = frozenset(), unlucky: int = 0) -> None:
        self.random = random.Random(seed)
        self.deadly = deadly
        self.unlucky = unlucky
        self.numbers = count()
        self.out: dict[object, int] = {}
        self.cancelled = False
        self.most_out = 0

    def hand_out(self, item: int) -> object:
        handle = next(self.numbers)
        self.out[handle] = item
        self.most_out = max(self.most_out, len(self.out))
        return handle

    def wait(self, handles: Sequence[int]) -> Sequence[int]:
        assert sorted(handles) == sorted(self.out)  # type: ignore[type-var]
        return self.random.sample(handles, self.random.randint(0, len(handles)))

    def answer(self, handle: int) -> int | str:
        item = self.out.pop(handle)
        if self.unlucky and self.random.random() < 0.3:
            self.unlucky -= 1
            raise AgainError
        if item in self.deadly:
            raise DeadWorkerError("it died")
        return -item

    def cancel(self, handles: Sequence[int]) -> None:
        assert sorted(handles) == sorted(self.out)  # type: ignore[type-var]
        self.cancelled = True


def lost(item: int, why: str) -> int | str:
    return f"{item}: {why}"


@given(
    st.integers(0, 1000),
    st.integers(0, 30),
    st.integers(1, 9),
    st.frozensets(st.integers(0, 29), max_size=3),
)
def test_results_come_in_order_and_what_a_worker_dies_of_costs_its_own(
    seed: int, items: int, ahead: int, deadly: frozenset[int]
) -> None:
    workers = Chance(seed, deadly, unlucky=5)
    done = list(results_of(workers, range(items), lost, ahead))
    assert done == [f"{one}: it died" if one in deadly else -one for one in range(items)]
    assert workers.cancelled
    assert workers.out == {}
    assert workers.most_out <= ahead


def die(number: int) -> int | str:
    """What a machine without memory does to a process."""
    if number == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return number


@pytest.mark.machine
def test_a_process_that_dies_costs_its_own_run_and_who_leaves_early_hears_nothing(
    capfd: pytest.CaptureFixture[str],
) -> None:
    told = "3: the process died that worked on it: too little memory, or a fault of it"
    assert list(in_order(die, range(8), lost, jobs=2)) == [0, 1, 2, told, 4, 5, 6, 7]
    done = in_order(die, range(4, 12), lost, jobs=2)
    assert next(done) == 4
    done.close()
    assert capfd.readouterr().err == ""


def test_without_shared_memory_the_work_goes_on_in_this_process(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    no_memory = Mock(side_effect=OSError(errno.EROFS, "Read-only file system"))
    monkeypatch.setattr("concurrent.futures.ProcessPoolExecutor", no_memory)
    assert list(in_order(abs, range(-8, 0), lost, jobs=2)) == [*range(8, 0, -1)]
    told = "madrob: no processes beside this one: Read-only file system; it goes on alone\n"
    assert capfd.readouterr().err == told


@pytest.fixture
def results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The results folder of the settings; nothing is in it."""
    results = tmp_path / "results"
    results.mkdir()
    settings = tmp_path / "config" / "madrob" / "madrob.toml"
    settings.parent.mkdir(parents=True)
    settings.write_text(f'[results]\nfolder = "{results}"\n')
    monkeypatch.chdir(tmp_path)
    return results


def put(results: Path, *places: str) -> str:
    """Put a run there; returns its name."""
    for place in places:
        film(Path(shutil.copytree(completed(), results / place / completed().name)), "/camera/a")
    return completed().name


COMMANDS = (
    "report {}",
    "score {}",
    "recover {}",
    "export --dossier --run {}",
    "table samples --output tables {}",
    "table runs {}",
)


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_finds_a_run_by_its_name(results: Path, command: str, madrob: Madrob) -> None:
    madrob(command.format(put(results, "practice")))


@pytest.mark.parametrize("command", ["score {}", "export --dossier --run {}"])
def test_a_name_that_two_runs_have_is_refused_with_both(
    results: Path, command: str, madrob: Madrob
) -> None:
    name = put(results, ".", "practice")
    both = f"give {results / name} or {results / 'practice' / name}"
    told = f"madrob: {name}: two runs are called so: {both}\n"
    assert madrob.refusal(command.format(name)) == told
    madrob(command.format(f"practice/{name}"))


def test_the_results_folder_that_is_named_is_looked_in(
    results: Path, tmp_path: Path, madrob: Madrob
) -> None:
    name, other = put(tmp_path / "other", "practice"), tmp_path / "other"
    line = f"export --run {name} --dossier"
    assert f"{results / name}: no such run folder" in madrob.refusal(line)
    madrob(line, "--results", other)
    assert (other / "exports" / f"dossier_practice_{name}.zip").is_file()


def test_ctrl_c_waits_until_a_child_has_begun() -> None:
    """A thread of a library may get it though the main thread blocks it."""
    begins = threading.Event()

    def receive() -> None:
        begins.wait()
        signal.pthread_kill(threading.get_ident(), signal.SIGINT)

    thread = threading.Thread(target=receive)
    thread.start()
    done = []

    def begin_child() -> None:
        with children_spared():
            begins.set()
            thread.join()
            done.append("child")

    with pytest.raises(KeyboardInterrupt):
        begin_child()
    assert done == ["child"]
