"""Scores of many runs, and the program of EUROBENCH's runner."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator

import pytest

from tests.stories import hands
from tests.stories.hands import Hall
from tests.stories.terminal import wait_until


# Seen red: each process was given the first run.
def test_scores_are_the_same_from_a_pool(hall: Hall) -> None:
    runs = [hands.make_run(hall, "slam"), hands.make_run(hall, "nominal", timeout=4.0)]

    alone = hands.scores_of(hall, jobs=1)
    pooled = hands.scores_of(hall, jobs=2)

    assert pooled == alone
    assert all(run.folder.name in alone for run in runs)


@pytest.fixture
def scheduler(hall: Hall) -> Iterator[str]:
    """The address of a Dask cluster with two workers."""
    pytest.importorskip("distributed", reason="the package distributed")
    address_file = hall.home / "scheduler.json"
    command = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--no-dashboard"]
    local = ["--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(address_file)]
    worker = [sys.executable, "-m", "distributed.cli.dask_worker", "--no-dashboard", "--no-nanny"]
    joined = ["--scheduler-file", str(address_file), "--local-directory", str(hall.home)]
    programs = [
        subprocess.Popen([*words], env=hall.environment, stderr=subprocess.DEVNULL)
        for words in ([*command, *local], [*worker, *joined], [*worker, *joined])
    ]
    yield wait_until(lambda: hands.address_in(address_file), "a scheduler", timeout=60.0)
    for program in programs:
        program.kill()
        program.wait()


# Seen red: each worker was given the first run.
@pytest.mark.machine
def test_scores_are_the_same_from_a_cluster(hall: Hall, scheduler: str) -> None:
    hands.make_run(hall, "slam")
    hands.make_run(hall, "nominal", timeout=4.0)

    alone = hands.scores_of(hall, jobs=1)
    spread = hands.scores_of(hall, scheduler=scheduler)

    assert spread == alone


def test_run_madrob_writes_eight_indicators(hall: Hall) -> None:
    run = hands.make_run(hall, "nominal", *hands.BY_EUROBENCH)
    files, output = hands.eurobench_files(run), hall.home / "output"

    code = hands.run_madrob(hall, files, output)

    written = hands.eurobench_values(output)
    assert (code, len(written)) == (0, 8)
    stored = hands.values_of(run)
    assert {name: float(text) for name, text in written.items()} == pytest.approx(stored, rel=1e-3)
    assert written["capability_level"] == str(run.level())
    assert float(written["passage_time"]) == pytest.approx(stored["passage_time"], rel=1e-6)


# Seen red: every failure had exit code 1.
@pytest.mark.parametrize("spoil", [hands.remove_first, hands.empty_first])
def test_run_madrob_says_what_cannot_be_scored(spoil: hands.Spoil, hall: Hall) -> None:
    run = hands.make_run(hall, "slam")
    files, output = hands.eurobench_files(run), hall.home / "output"

    spoil(files)

    assert hands.run_madrob(hall, files, output) == 255
    assert hands.eurobench_values(output) == {}
