"""The `madrob` command."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module

from madrob_console.cli.chosen_runs import find_runs
from madrob_console.cli.command_line import Argument, MadrobCommand, Main, TellAction, print_help
from madrob_console.cli.interruption import interruptible, say_stopped
from madrob_console.cli.output import BAD_INPUT, StoppedError, complain
from madrob_console.cli.parsing import Parser
from madrob_console.cli.safe_stream import forget, safe_output
from madrob_console.common.errors import MadrobError
from recorder import RecorderError
from scoring.protocol import ScoringError

COMMANDS = (
    *("console", "watch", "engine", "run", "testbed"),
    *("score", "report", "plan", "standings", "publish", "export"),
    *("table", "recover", "calibrate", "doctor", "settings", "guide"),
)
"""In the order of the help; each is a file beside this one, `<name>_command.py`."""

_MORE = """\
`madrob run --help` has its exit codes, `madrob settings` prints the settings with every default. \
Whatever takes a run takes its name, too: it is looked for in the results folder."""


_FAILED = 1
"""Exit code of an unexpected error; Python's."""


def _version() -> str:
    from madrob_console.common.version import software_version

    return f"madrob {software_version()}"


_VERSION = Argument(
    "--version", action=TellAction, const=_version, nargs=0, help="print the version"
)


def build_parser(names: Sequence[str] = COMMANDS) -> Parser:
    parser = Parser(
        prog="madrob",
        description="Referee console for the MADROB robot-door benchmark.",
        epilog=_MORE,
    )
    parser.set_defaults(main=print_help)
    _VERSION.add_to(parser)
    commands = parser.add_subparsers(dest="command", metavar="COMMAND")
    for name in names:
        declared: MadrobCommand = getattr(import_module(f"madrob_console.cli.{name}_command"), name)
        declared.add_to(commands)
    return parser


def main(argv: Sequence[str] | None = None, parser: Parser | None = None) -> int:
    """Carry out a command, or what another program's parser reads; returns the exit code."""
    with safe_output(), interruptible() as interruption:
        try:
            return _main(sys.argv[1:] if argv is None else argv, parser)
        except KeyboardInterrupt:
            return say_stopped()
        except Exception:
            if interruption.raised:
                return say_stopped()
            if argv is not None:
                raise
            import traceback

            traceback.print_exc()  # here, where what it quotes is made safe
            return _FAILED


def _main(words: Sequence[str], parser: Parser | None) -> int:
    named = words[:1] if words[:1] and words[0] in COMMANDS else COMMANDS
    try:
        try:
            arguments = (parser or build_parser(named)).parse_args(words)
            find_runs(arguments)
            command: Main = arguments.main
            code = command(arguments)
        finally:
            if sys.stdout is not None:  # it is where the program was started without
                sys.stdout.flush()
    except StoppedError as error:
        complain(error)
        return error.exit_code
    except (MadrobError, RecorderError, ScoringError) as error:
        complain(error)
        return BAD_INPUT
    except BrokenPipeError:  # `madrob score ... | head`
        forget(sys.stdout)
        return 0
    return code


if __name__ == "__main__":
    sys.exit(main())
