"""The `madrob` command."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Sequence

from madrob_console.cli import arguments_preparing as preparing
from madrob_console.cli import arguments_results as results
from madrob_console.cli import arguments_running as running
from madrob_console.cli.arguments_common import BAD_INPUT, Parser
from madrob_console.errors import MadrobError
from madrob_console.names import terminal_safe
from madrob_console.version import software_version
from recorder.errors import RecorderError
from scoring.errors import ScoringError
from scoring.imports import import_kept

_EXIT_CODES = """\
exit codes of `madrob run`: 0 completed, 3 timeout, 4 aborted or invalid, 5 interrupted,
2 bad input or a refusal. Settings: `madrob settings` prints the file with every default."""


class _Version(argparse.Action):
    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        print(f"madrob {software_version()}")
        parser.exit()


def build_parser() -> argparse.ArgumentParser:
    """The command line, complete with help texts."""
    parser = Parser(
        prog="madrob",
        description="Referee console for the MADROB robot-door benchmark.",
        epilog=_EXIT_CODES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="print the version")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    running.add_console(commands)
    running.add_watch(commands)
    running.add_engine(commands)
    running.add_run(commands)
    running.add_testbed(commands)
    results.add_score(commands)
    results.add_report(commands)
    results.add_standings(commands)
    results.add_export(commands)
    results.add_schema(commands)
    results.add_recover(commands)
    preparing.add_calibrate(commands)
    preparing.add_doctor(commands)
    preparing.add_settings(commands)
    return parser


def _with_pose(argv: Sequence[str]) -> list[str]:
    """Tie a pose to its flag: argparse takes `-1.5,0,0` for a flag of its own."""
    tied: list[str] = []
    for argument in argv:
        if tied and tied[-1] == "--start-pose":
            tied[-1] += f"={argument}"
        else:
            tied.append(argument)
    return tied


def main(argv: Sequence[str] | None = None) -> int:
    """Run `madrob`; returns the exit code."""
    arguments = build_parser().parse_args(_with_pose(sys.argv[1:] if argv is None else argv))
    command: Callable[[argparse.Namespace], int] = import_kept(
        f"madrob_console.cli.{arguments.module}"
    ).main
    try:
        return command(arguments)
    except (MadrobError, RecorderError, ScoringError) as error:
        print(f"madrob: {terminal_safe(str(error))}", file=sys.stderr)
        return BAD_INPUT
    except BrokenPipeError:  # `madrob score ... | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0


if __name__ == "__main__":
    sys.exit(main())
