"""`python -m madrob_console.engine.runtime.scoring_worker HANDLE`: scores for an engine.

It reads questions from the socket with this handle and ends when the engine closes its end. It
writes no file: what it makes, the engine writes.
"""

from __future__ import annotations

import gc
import pickle
import signal
import socket
import sys
from contextlib import suppress
from pathlib import Path

from madrob_console.common.errors import MadrobError
from madrob_console.engine.core.scored_run import ToScore
from madrob_console.engine.ipc.wire import frame
from madrob_console.engine.runtime.scorer import ScoringDesk
from madrob_console.engine.runtime.scoring_protocol import Answered, Failed, Ready, ToEngine
from scoring.kinematics import load_filters

FIRST_TO_GO = 500
"""Out-of-memory score (of 1000): the kernel ends this process rather than the engine."""


def _answer(desk: ScoringDesk, number: int, what: ToScore | Path) -> ToEngine:
    try:
        if isinstance(what, ToScore):
            return Answered(number, desk.score(what))
        earlier = desk.read(what)
        return Answered(number, earlier.scored, earlier.entries, earlier.out_of_date)
    except (MadrobError, OSError) as error:
        return Failed(number, str(error))


def main() -> None:
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # of a whole group: the engine still needs its result
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(str(FIRST_TO_GO))
    link = socket.socket(fileno=int(sys.argv[1]))
    load_filters()
    gc.freeze()  # what was imported stays
    desk = ScoringDesk()
    ended = (ConnectionError, EOFError, pickle.UnpicklingError)
    with suppress(*ended), link.makefile("rb") as questions:
        link.sendall(frame(Ready()))
        while True:
            link.sendall(frame(_answer(desk, *pickle.load(questions))))


if __name__ == "__main__":
    main()
