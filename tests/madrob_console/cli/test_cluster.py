"""`--scheduler`: the runs go to a Dask cluster, and what happens to it costs little."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from madrob_console.cli import cluster as cluster_module
from madrob_console.cli.cluster import on_cluster
from madrob_console.cli.main import main
from madrob_console.common.errors import MadrobError
from madrob_console.common.version import software_version
from madrob_console.testbeds.simulated import Scenario
from tests.madrob_console.cli.typed import Madrob
from tests.madrob_console.recorded_runs import copy_run

if TYPE_CHECKING:
    from distributed import LocalCluster

ROOT = Path(__file__).parents[3]


def test_without_distributed_one_line_names_the_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, madrob: Madrob
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert madrob.refusal("score --scheduler tcp://10.0.0.5:8786", tmp_path) == (
        "madrob: --scheduler needs Dask: install the package `distributed`, "
        "here and on the workers\n"
    )


def die_of_three(number: int) -> int:
    """What a run does that needs more memory than there is."""
    if number == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return -number


def die_once(marker: tuple[int, str]) -> int:
    """What a machine does that goes down once."""
    number, path = marker
    if number == 5 and not Path(path).exists():
        Path(path).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return -number


def fail(number: int) -> int:
    """What a fault of ours does."""
    raise ValueError(f"number {number}")


def linger(mark: tuple[int, str]) -> None:
    """Say that it was begun, and work on until somebody says that it is enough."""
    number, folder = mark
    Path(folder, f"begun_{number}").touch()
    while not Path(folder, "enough").exists():
        time.sleep(0.02)


@pytest.fixture(scope="module")
def cluster() -> Iterator[LocalCluster]:
    """A scheduler, and two workers in processes of their own that are made anew when they die.

    Dask's nannies would do that too, but give up for good where a worker dies before its nanny has
    heard that it is up, as it does on a busy machine with a run that kills workers.
    """
    distributed = pytest.importorskip("distributed", reason="the package distributed")
    ended = threading.Event()
    with distributed.LocalCluster(n_workers=0, dashboard_address=None, silence_logs=50) as running:
        keepers = [
            threading.Thread(target=_keep_a_worker, args=(running.scheduler_address, ended))
            for _ in range(2)
        ]
        for keeper in keepers:
            keeper.start()
        yield running
        ended.set()
        for keeper in keepers:
            keeper.join()


def _keep_a_worker(address: str, ended: threading.Event) -> None:
    """One worker after the other, until it is the end."""
    while not ended.is_set():
        with one_worker(address) as worker:
            while worker.poll() is None and not ended.wait(0.05):
                pass


@contextmanager
def one_worker(address: str, *options: str) -> Iterator[subprocess.Popen[bytes]]:
    """A worker in a process of its own, which is ended at last."""
    usual = ("--nthreads", "1", "--no-nanny", "--no-dashboard", "--death-timeout", "60")
    command = (sys.executable, "-m", "distributed.cli.dask_worker", address, *usual, *options)
    with (
        tempfile.TemporaryDirectory() as folder,
        subprocess.Popen(
            (*command, "--local-directory", folder),
            env={**os.environ, "PYTHONPATH": str(ROOT)},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        ) as worker,
    ):
        try:
            yield worker
        finally:
            worker.kill()


@pytest.mark.machine
@pytest.mark.timeout(300)
@pytest.mark.filterwarnings("default")  # of distributed's own threads and processes
def test_a_cluster_gives_what_one_process_gives_and_its_faults_cost_one_run(
    cluster: LocalCluster,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    address, root = cluster.scheduler_address, tmp_path / "results"
    for number in range(1, 5):
        copy_run(root, number, Scenario.TOUCH_ONLY)
    (root / "subject_009_cond_001_run_001_20231114_221323").mkdir()
    assert main(["score", "--jobs", "1", str(root)]) == 2
    alone = capsys.readouterr()
    monkeypatch.chdir(tmp_path)
    cluster.wait_for_workers(2)
    assert main(["score", "--scheduler", address, "results"]) == 2
    assert capsys.readouterr() == alone

    def spread(work: Callable[[Any], Any], items: Sequence[Any]) -> list[Any]:
        cluster.wait_for_workers(2)
        return list(on_cluster(work, items, address, [], lambda item, why: f"{item}: {why}"))

    # a worker that dies costs nothing but the time of its runs
    marked = [(number, str(tmp_path / "died")) for number in range(20)]
    assert spread(die_once, marked) == [-number for number in range(20)]
    assert (tmp_path / "died").exists()
    # a run that takes every worker with it is one row with its reason
    done = spread(die_of_three, range(20))
    assert done.pop(3).startswith("3: every worker died that worked on it")
    assert done == [-number for number in range(20) if number != 3]
    assert spread(fail, [7]) == ["7: the cluster could not do it (ValueError: number 7)"]

    # what is closed is cancelled: nothing more is begun
    lingering = tmp_path / "lingering"
    lingering.mkdir()
    marks = [(number, str(lingering)) for number in range(30)]
    results = on_cluster(linger, marks, address, [], lambda item, _why: None)
    with pytest.raises(KeyboardInterrupt):
        _interrupted(results, lingering, monkeypatch)
    while cluster.scheduler.tasks:
        time.sleep(0.02)
    (lingering / "enough").touch()
    assert spread(abs, [-1, -2]) == [1, 2]
    assert len(list(lingering.glob("begun_*"))) < 10

    monkeypatch.setattr("madrob_console.common.version.software_version", lambda: "0.0.1")
    with pytest.raises(MadrobError, match=r"has other versions \(.* there, 0\.0\.1 here\)"):
        spread(abs, [-1, -2])


OTHER = "0.0.1"


def versioned(mark: tuple[int, str]) -> tuple[int, str]:
    """Say which version works on it; all but the first wait for the other version's worker."""
    number, folder = mark
    version, go = software_version(), Path(folder, "go")
    if version == OTHER:
        go.touch()
    while number and not go.exists():
        time.sleep(0.02)
    return number, version


@contextmanager
def cluster_of() -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """A scheduler's address and its one worker."""
    distributed = pytest.importorskip("distributed", reason="the package distributed")
    with (
        distributed.LocalCluster(n_workers=0, dashboard_address=":0", silence_logs=50) as running,
        one_worker(running.scheduler_address) as worker,
    ):
        running.wait_for_workers(1)
        yield running.scheduler_address, worker


@pytest.mark.machine
@pytest.mark.timeout(300)
@pytest.mark.filterwarnings("default")  # of distributed's own threads and processes
@pytest.mark.parametrize("others", [True, False])
def test_what_a_late_worker_of_another_version_gets_is_done_by_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, others: bool
) -> None:
    own, told = software_version(), list[str]()
    words = rf"^worker \S+ has other versions \({OTHER} there, {re.escape(own)} here\), which "
    faked = tmp_path / "faked.py"
    faked.write_text(
        f"from madrob_console.common import version\nversion.software_version = lambda: {OTHER!r}\n"
    )
    with cluster_of() as (address, fitting):

        def hear(problem: str) -> None:
            told.append(problem)
            if others:
                Path(tmp_path, "go").touch()
            else:
                fitting.kill()

        monkeypatch.setattr(cluster_module, "complain", hear)
        marks = [(number, str(tmp_path)) for number in range(20)]
        results = on_cluster(versioned, marks, address, [], lambda item, why: (item[0], why))
        assert next(results) == (0, own)
        with one_worker(address, "--preload", str(faked)):
            if others:
                assert list(results) == [(number, own) for number in range(1, 20)]
            else:
                with pytest.raises(MadrobError, match=f"^no worker is left that fits: {words[1:]}"):
                    list(results)
    (problem,) = told
    assert re.search(words, problem)


def _interrupted(results: Iterator[None], folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Take results until work has begun; then Ctrl+C is pressed."""
    import distributed

    wait = distributed.wait

    def pressed(futures: list[object], **_how: object) -> object:
        if any(folder.iterdir()):
            raise KeyboardInterrupt
        return wait(futures, timeout=0.1, return_when="FIRST_COMPLETED")

    with monkeypatch.context() as patch:
        patch.setattr(distributed, "wait", pressed)
        next(results)
