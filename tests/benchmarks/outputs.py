"""How long commands take that hand runs out, beside a program that only puts the bytes there."""

from __future__ import annotations

import shutil
import sys
import zipfile
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.benchmarks import bare_files
from tests.benchmarks.commands import MADROB, in_turns
from tests.benchmarks.report import Figure
from tests.madrob_console.recorded_runs import completed

RUNS = 6
MOST = 3


@dataclass(frozen=True, slots=True)
class Output:
    """A command that writes `target` into a new folder; {} = that folder.

    The program beside it imports the same large `libraries`.
    """

    command: str
    arguments: Sequence[str]
    target: str
    beside: str
    libraries: Sequence[str]
    goal: float


_RUNS = ("--practice", "--results={}/runs")
OUTPUTS = (
    Output("publish", (*_RUNS, "{}/site"), "site", "jinja2, copies", ("jinja2", "numpy"), 4.5),
    Output(
        "export",
        (*_RUNS, "--subject=3", "--output={}/runs.zip"),
        "runs.zip",
        "pandas, zips",
        ("jinja2", "pandas"),
        2.0,
    ),
    Output(
        "report",
        ("{}/a_run", "--output={}/page"),
        "page",
        "matplotlib, SciPy, copies",
        ("jinja2", "pandas", "matplotlib.figure", "scipy.signal"),
        2.0,
    ),
)


def outputs(repeats: int) -> list[Figure]:
    """The pages of a competition, a team's zip, the report of a run; each made anew."""
    took = defaultdict[str, list[float]](list)
    for _ in range(1 + min(repeats, MOST)):
        with TemporaryDirectory() as folder:
            for number in range(1, 1 + RUNS):
                run = completed(number)
                shutil.copytree(run, Path(folder, "runs", "practice", run.name))
            shutil.copytree(completed(), Path(folder, "a_run"))
            for output in OUTPUTS:
                argv = [argument.replace("{}", folder) for argument in output.arguments]
                took[output.command] += _once(*MADROB, output.command, *argv)
                files, target = Path(folder, "files"), Path(folder, output.target)
                if target.suffix == ".zip":
                    with zipfile.ZipFile(target) as file:
                        file.extractall(files)
                else:
                    target.rename(files)
                copy = Path(folder, f"again_{target.name}")
                bare = (sys.executable, "-m", bare_files.__name__, str(files), str(copy))
                took[output.beside] += _once(*bare, *output.libraries)
                shutil.rmtree(files)
    return [
        Figure(
            f"madrob {each.command}",
            "s",
            took[each.command][1:],
            each.beside,
            took[each.beside][1:],
            each.goal,
        )
        for each in OUTPUTS
    ]


def _once(*argv: str) -> list[float]:
    return in_turns({"": argv}, 1, warm_up=0)[""]
