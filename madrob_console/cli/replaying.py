"""`madrob run --testbed replay`: a recorded run once more, without screens."""

from __future__ import annotations

from madrob_console.cli.log_printer import LogPrinter
from madrob_console.cli.score_table import result_lines
from madrob_console.engine.live.core import Engine
from madrob_console.engine.live.replay import Replay
from madrob_console.errors import MadrobError
from scoring.protocol import Outcome

STEP = 0.02
"""Between two looks at the log, s."""


def print_replay(engine: Engine, replay: Replay) -> Outcome:
    """Print a replay to its end and what it differs in from the stored result; nothing is written.

    Raises:
        MadrobError: it was interrupted from the keyboard.
    """
    log = LogPrinter(engine.log)
    engine.open()
    try:
        print(f"testbed: {engine.source.label}", flush=True)
        for problem in replay.problems:
            print(f"note: {problem}", flush=True)
        log.print_new()
        while engine.scored is None:
            engine.step(STEP)
            log.print_new()
    except KeyboardInterrupt:
        raise MadrobError("the replay was stopped before its end") from None
    finally:
        engine.close()
    result = engine.scored.result
    for line in result_lines(result):
        print(line)
    print(f"replay: {replay.view(result).comparison}; nothing was recorded")
    print(f"run folder: {engine.folder}", flush=True)
    return result.ending.outcome
