"""How long commands take that hand runs out, beside a program that only puts the bytes there."""

from __future__ import annotations

import sys
import zipfile
from collections import defaultdict
from pathlib import Path
from tempfile import TemporaryDirectory

from madrob_console.testbeds.simulated import Scenario
from tests.benchmarks import bare_files
from tests.benchmarks.commands import MADROB, in_turns
from tests.benchmarks.report import Figure
from tests.madrob_console.recorded_runs import copy_run

RUNS = 8
GOALS = {"publish": 1.0, "export": 1.0, "report": 1.0}
MOST = 3


def outputs(repeats: int) -> list[Figure]:
    """The pages of a competition, a team's zip, the report of a run; each made anew."""
    ours, others = defaultdict[str, list[float]](list), defaultdict[str, list[float]](list)
    for sample in range(1 + min(repeats, MOST)):
        with TemporaryDirectory() as folder:
            for name, (argv, made) in _commands(Path(folder)).items():
                took = in_turns({name: (*MADROB, *argv)}, 1, warm_up=0)[name]
                again = made.with_name(f"copy_{made.name}")
                source = _unpacked(made) if made.suffix == ".zip" else made
                bare = (sys.executable, "-m", bare_files.__name__, str(source), str(again))
                if sample:
                    ours[name] += took
                    others[name] += in_turns({name: bare}, 1, warm_up=0)[name]
    beside = {
        "publish": "copies its files",
        "export": "zips its files",
        "report": "copies its file",
    }
    return [
        Figure(f"madrob {name}", "s", ours[name], beside[name], others[name], goal)
        for name, goal in GOALS.items()
    ]


def _commands(folder: Path) -> dict[str, tuple[tuple[str, ...], Path]]:
    """Arguments of the commands, and what they make."""
    runs, site, packed, pages = (folder / name for name in ("runs", "site", "runs.zip", "pages"))
    copies = [copy_run(runs, 1 + number, Scenario.NOMINAL) for number in range(RUNS)]
    which = ("--practice", f"--results={runs}")
    return {
        "publish": (("publish", *which, str(site)), site),
        "export": (("export", *which, "--subject=3", f"--output={packed}"), packed),
        "report": (("report", f"--output={pages}", str(copies[0])), pages),
    }


def _unpacked(packed: Path) -> Path:
    with zipfile.ZipFile(packed) as file:
        file.extractall(packed.with_suffix(""))
    return packed.with_suffix("")
