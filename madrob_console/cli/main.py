"""The `madrob` command."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from importlib import import_module

from madrob_console.cli import options
from madrob_console.cli.problems import BAD_INPUT, complain
from madrob_console.errors import MadrobError
from recorder.errors import RecorderError
from scoring.errors import ScoringError

COMMANDS = (
    *("console", "watch", "engine", "run", "testbed"),
    *("score", "report", "standings", "export", "schema", "recover"),
    *("calibrate", "doctor", "settings"),
)
"""In the order of the help; each is a file beside this one, `<name>_command.py`."""

_EXIT_CODES = """\
exit codes of `madrob run`: 0 completed, 3 timeout, 4 aborted or invalid, 5 interrupted,
2 bad input or a refusal. Settings: `madrob settings` prints the file with every default."""


class _Version(argparse.Action):
    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from madrob_console.version import software_version

        print(f"madrob {software_version()}")
        parser.exit()


def build_parser(names: Sequence[str] = COMMANDS) -> argparse.ArgumentParser:
    """The command line with its help texts, of all commands or of some."""
    parser = options.Parser(
        prog="madrob",
        description="Referee console for the MADROB robot-door benchmark.",
        epilog=_EXIT_CODES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="print the version")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for name in names:
        import_module(f"madrob_console.cli.{name}_command").add(commands)
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
    words = _with_pose(sys.argv[1:] if argv is None else argv)
    named = words[:1] if words[:1] and words[0] in COMMANDS else COMMANDS
    arguments = build_parser(named).parse_args(words)
    command: options.Main = arguments.main
    try:
        return command(arguments)
    except (MadrobError, RecorderError, ScoringError) as error:
        complain(error)
        return BAD_INPUT
    except BrokenPipeError:  # `madrob score ... | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0


if __name__ == "__main__":
    sys.exit(main())
