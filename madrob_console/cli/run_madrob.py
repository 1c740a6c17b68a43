"""The program `run_madrob`: one run's published files to EUROBENCH's eight, as its scripts do."""

from __future__ import annotations

import argparse
from pathlib import Path

from madrob_console.cli import main as madrob
from madrob_console.cli.parsing import Parser, as_path
from madrob_console.common.names import terminal_safe

_FILES = (
    ("event", "csv: time,event"),
    ("wrench", "csv: time,force_x"),
    ("joint_state", "csv: time,position,velocity,acceleration"),
    ("condition", "YAML: benchmark_type, door_opening_side, robot_approach_side"),
    ("folder", "where the YAML files go; it is made, and what they replace is lost"),
)


def main() -> int:
    parser = Parser(
        prog="run_madrob",
        description="Writes a YAML file for each indicator into FOLDER, by the rules of "
        "eurobench-2020.",
        epilog="example:\n  run_madrob event.csv wrench.csv jointState.csv condition_1.yaml out",
    )
    for name, text in _FILES:
        parser.add_argument(name, type=as_path, metavar=name.upper(), help=text)
    parser.set_defaults(main=_score_files)
    return madrob.main(parser=parser)


def _score_files(arguments: argparse.Namespace) -> int:
    """Score the files, then write the indicators, each file atomically."""
    from madrob_console.cli.result_lines import result_lines
    from madrob_console.common.files import atomic_writes, make_folder
    from scoring.eurobench import evaluate_published, indicator_files, read_files
    from scoring.indicator_table import RulesetName

    run = read_files(arguments.event, arguments.wrench, arguments.joint_state, arguments.condition)
    result, _ = evaluate_published(run)
    folder: Path = arguments.folder
    make_folder(folder, "name another")
    atomic_writes(folder, indicator_files(result.indicators, RulesetName.EUROBENCH_2020))
    for line in result_lines(result):
        print(line)
    print(terminal_safe(f"written to {folder}"))
    return 0
