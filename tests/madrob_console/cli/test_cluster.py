"""`--scheduler`: the runs go to a Dask cluster, and what happens to it costs little."""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from madrob_console.archive.run_paths import all_runs_at
from madrob_console.cli.cluster import on_cluster
from madrob_console.cli.main import main
from madrob_console.cli.sharing import lost_words, shared
from madrob_console.errors import MadrobError
from madrob_console.testbeds.simulated import Scenario
from tests.madrob_console.recorded_runs import copy_run

if TYPE_CHECKING:
    from distributed import LocalCluster

ROOT = Path(__file__).parents[3]


def test_without_distributed_one_line_names_the_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert main(["score", "--scheduler", "tcp://10.0.0.5:8786", str(tmp_path)]) == 2
    told = capsys.readouterr()
    assert told.out == ""
    assert told.err == (
        "madrob: --scheduler needs distributed: install madrob-console with its extra `cluster`, "
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
    distributed = pytest.importorskip("distributed", reason="the extra `cluster`")
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
    options = ("--nthreads", "1", "--no-nanny", "--no-dashboard", "--death-timeout", "60")
    command = (sys.executable, "-m", "distributed.cli.dask_worker", address, *options)
    with tempfile.TemporaryDirectory() as folder:
        while not ended.is_set():
            with subprocess.Popen(
                (*command, "--local-directory", folder),
                env={**os.environ, "PYTHONPATH": str(ROOT)},
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            ) as worker:
                while worker.poll() is None and not ended.wait(0.05):
                    pass
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

    # no more is out than is wanted in memory, of a command that says how much
    with monkeypatch.context() as patch:
        assert _most_out(address, root, patch) == 2

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

    monkeypatch.setattr("madrob_console.version.software_version", lambda: "0.0.1")
    with pytest.raises(MadrobError, match=r"has other versions \(.* there, 0\.0\.1 here\)"):
        spread(abs, [-1, -2])


def _most_out(address: str, root: Path, patch: pytest.MonkeyPatch) -> int:
    """How many of all runs are handed out and not taken, where two are wanted at most."""
    import distributed

    out, most, submit = 0, 0, distributed.Client.submit

    def counted(client: object, *call: object, **how: object) -> object:
        nonlocal out, most
        out += 1
        most = max(most, out)
        return submit(client, *call, **how)

    patch.setattr(distributed.Client, "submit", counted)
    arguments = argparse.Namespace(scheduler=address, paths=[root])
    runs = all_runs_at([root])
    assert len(runs) > 2
    for _ in shared(arguments, attrgetter("name"), runs, lost_words, at_once=2):
        out -= 1
    return most


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
