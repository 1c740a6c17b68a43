"""A console with settings, results and an engine of its own, in a terminal that takes the time."""

from __future__ import annotations

import os
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from tests.benchmarks.programs import MADROB
from tests.benchmarks.wire import ROOT, SMALL, STARTING, Size, Wire
from tests.readme_console import ENTER, F5, F6, F7


@contextmanager
def console(testbed: Sequence[str], size: Size = SMALL, *, blind: bool = True) -> Iterator[Wire]:
    """The console on a testbed, as the command line names it; its engine ends with it."""
    with tempfile.TemporaryDirectory(prefix="madrob-", ignore_cleanup_errors=True) as folder:
        env = {"XDG_STATE_HOME": folder}
        settings = Path(folder, "madrob.toml")
        settings.write_text("[run]\ncountdown = 2\n")
        own = ["--settings", str(settings), "--results", str(Path(folder, "results"))]
        try:
            with Wire([*MADROB, "console", *testbed, *own], size, blind=blind, env=env) as wire:
                yield wire
        finally:
            stop = [*MADROB, "engine", "stop", "--force", *own]
            subprocess.run(
                stop, env=os.environ | env, cwd=ROOT, capture_output=True, timeout=60, check=False
            )


def start_run(wire: Wire) -> None:
    """From the set-up to the run."""
    for key, text in (
        (ENTER, "is set up"),
        (F7, "Done: zero the handle"),
        (F6, "all passed or waived"),
        (F5, "RUNNING"),
    ):
        wire.send(key)
        wire.wait_for(text, timeout=STARTING)
