"""The `madrob` program: Ctrl+C is heeded from its first line on."""

from __future__ import annotations

import atexit
import os
import signal
import sys

REFUSED = 255
"""Exit code of `run_madrob` for a run that cannot be scored: -1, as a shell shows it."""


def main(eurobench: bool = False) -> int:
    stopped: list[int] = []
    atexit.register(_die, stopped)  # the first that is registered comes last
    try:
        if eurobench:
            from madrob_console.cli.run_madrob import main as program
        else:
            from madrob_console.cli.main import main as program
        code = program()
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # what was asked for is done: it only ends
    except KeyboardInterrupt:
        sys.stderr.write("madrob: stopped\n")
        code = 128 + signal.SIGINT
    if code == 128 + signal.SIGINT:
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # once more ends it at once
        stopped.append(code)
    return code


def run_madrob() -> int:
    """Score named files as the published scripts do, for EUROBENCH's runner."""
    code: object
    try:
        code = main(eurobench=True)
    except SystemExit as end:  # argparse
        code = end.code
    return REFUSED if code else 0


def _die(stopped: list[int]) -> None:
    """Die of the signal (shells report 130), so that a calling script stops, too."""
    if stopped:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
        os.kill(os.getpid(), signal.SIGINT)


if __name__ == "__main__":
    sys.exit(main())
