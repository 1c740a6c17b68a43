"""`python -m tests.madrob_console.forking_madrob`: commands, each in a fork that begins at once.

Each line of the input is a JSON object: `arguments` of `madrob`, and the `environment` in which
`each_call.c`, which is preloaded, begins to count. The answer is a line with the exit code.
"""

from __future__ import annotations

import ctypes
import json
import os
import sys

from madrob_console.cli.main import main
from scoring.kinematics import load_filters


def run(arguments: list[str], environment: dict[str, str], log: str) -> None:
    """The fork: leads its group, which a kill ends whole."""
    os.setsid()
    os.environ.update(environment)
    output = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    os.dup2(output, 1)
    os.dup2(output, 2)
    ctypes.CDLL(None).each_call_arm()
    try:
        code = main(arguments)
    except SystemExit as end:
        code = int(end.code or 0)
    sys.stdout.flush()
    os._exit(code)


if __name__ == "__main__":
    load_filters()
    for line in sys.stdin:
        if (child := os.fork()) == 0:
            run(**json.loads(line))
        print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
