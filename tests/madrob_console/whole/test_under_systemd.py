"""An engine as a service: it fails so that it is started again, and systemd takes its unit."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.madrob_console.engine_process import ROOT, STARTING, start_madrob
from tests.watching import until

FAILING = """
import os
from madrob_console.engine.runtime.testbed_engine import Engine
step = Engine.step

def failing(self, *arguments):
    if os.path.exists("{}"):
        raise MemoryError("no memory")
    return step(self, *arguments)

Engine.step = failing
"""
"""An engine whose core fails once a file is there."""


def test_an_engine_that_fails_ends_with_the_code_that_restarts_it(tmp_path: Path) -> None:
    fail, log, results = tmp_path / "fail", tmp_path / "log", tmp_path / "results"
    log.touch()
    serve = ("engine", "serve", "--testbed", "simulated", f"--results={results}")
    service = start_madrob(*serve, before=FAILING.format(fail), output=log)
    try:
        until(results.is_dir, STARTING)
        fail.touch()
        assert service.wait(STARTING) == 1  # Restart=on-failure
    finally:
        service.kill()
        service.wait()
    assert "MemoryError: no memory" in log.read_text()


@pytest.mark.needs("systemd-analyze")
def test_systemd_takes_the_unit_of_the_guide(tmp_path: Path) -> None:
    guide = (ROOT / "madrob_console" / "guide" / "testbed.md").read_text()
    (unit,) = re.findall(r"^```ini\n(.*?)^```$", guide, re.MULTILINE | re.DOTALL)
    path = tmp_path / "madrob.service"
    path.write_text(unit.replace("%h/.local/bin/madrob", sys.executable))
    done = subprocess.run(
        ["systemd-analyze", "verify", path], check=False, capture_output=True, text=True
    )
    assert (done.returncode, done.stderr) == (0, "")
