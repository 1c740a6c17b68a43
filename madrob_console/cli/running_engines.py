"""Engines that run: their status, their end, and which one a command line means.

Also the locks and answers of a process that is itself a testbed's engine.
"""

from __future__ import annotations

import argparse
import os
import shlex
import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from madrob_console.cli import option_values, options
from madrob_console.cli.attaching import option_words, owned_testbed
from madrob_console.cli.output import BAD_INPUT, complain, says_yes
from madrob_console.cli.safe_stream import print_json
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import SourceKind, terminal_safe
from madrob_console.common.version import RELEASE
from madrob_console.engine.ipc import greeting
from madrob_console.engine.ipc.discovery import (
    FoundEngine,
    ask,
    has_ended,
    process_of,
    running_engines,
    send_signals,
)
from madrob_console.engine.ipc.engine_lock import Owned
from madrob_console.engine.ipc.greeting import WhoAnswer
from madrob_console.engine.ipc.ownership import EngineLocks, held
from madrob_console.referee.run import Phase
from madrob_console.ui.look.words import PHASES

if TYPE_CHECKING:
    from madrob_console.engine.ipc.server import EngineServer
    from madrob_console.engine.snapshot import Snapshot

ENDING_TIME = 30.0
"""Time for an engine to close its recording and write the result, s."""

HANGING_TIME = 10.0
"""Time for an engine that did not answer to react to a signal, s."""

KILLING_TIME = 5.0
"""Time for a killed process to disappear, unless the kernel waits for a disk, s."""

_UNSEEN = "whether a run goes on cannot be seen"


def _all_the_same(engine: FoundEngine) -> str:
    by_itself = engine.answer is not None and not engine.answer.wire  # `madrob run`
    what = "aborted and does not count" if by_itself else "cut off and kept as interrupted"
    unsaved = engine.answer is not None and engine.answer.unsaved
    lost = ", and what is not on disk by then is lost" if unsaved else ""
    return f"--force ends it all the same: a run that goes on is {what}{lost}"


def status(*, as_json: bool) -> int:
    """Print one line for each engine of this user; exit code 1 if there is none."""
    engines = running_engines()
    if as_json:
        print_json({"engines": [_document(engine) for engine in engines]})
        return 0 if engines else 1
    for engine in engines:
        print(status_line(engine))
        for remark in engine.answer.remarks if engine.answer else ():
            print(f"  {terminal_safe(remark)}")
    if not engines:
        print("no engine runs")
    return 0 if engines else 1


def _document(engine: FoundEngine) -> dict[str, object]:
    """What `madrob engine status --json` says of an engine (`madrob guide data`)."""
    answer = engine.answer or greeting.WhoAnswer(phase="")
    return {
        "pid": engine.pid,
        "since": engine.since,
        "testbed": engine.label,
        "kind": engine.kind,
        "domain": engine.domain,
        "results": None if engine.results is None else str(engine.results),
        "version": answer.version or None,
        "phase": answer.phase or None,
        "run": answer.run or None,
        "busy": answer.busy,
        "unsaved": answer.unsaved,
        "screens": answer.screens,
        "remarks": answer.remarks,
        "stop": engine.stop_line,
    }


def status_line(engine: FoundEngine) -> str:
    parts = [engine.who.replace(", ", ": ", 1)]
    answer = engine.answer
    if answer is None:
        parts.append("there, but silent")
    else:
        is_phase = answer.phase in list(Phase)
        parts.append(PHASES[Phase(answer.phase)] if is_phase else answer.phase)
        if answer.run:
            parts.append(answer.run)
        if answer.screens:
            parts.append("1 screen" if answer.screens == 1 else f"{answer.screens} screens")
    if engine.results is not None:
        parts.append(f"runs in {engine.results}")
    return terminal_safe(", ".join(parts))


def run_words(snapshot: Snapshot) -> str:
    return ", ".join(filter(None, (PHASES[snapshot.run.phase], greeting.run_title(snapshot.run))))


def stop(arguments: argparse.Namespace) -> int:
    """End the named engines, or the only one; exit code 1 if one goes on or none is found."""
    wanted = _wanted(arguments)
    running = running_engines()
    chosen = [
        engine for engine in running if all(getattr(engine, key) == wanted[key] for key in wanted)
    ]
    if not chosen:
        what = "the engine that is named does not run" if wanted else "no engine runs"
        print(f"{what}; these do:" if running else what)
        _list(running)
        return 1 if wanted else 0
    if len(chosen) > 1 and not arguments.all:
        print(f"{len(chosen)} engines run: name one of them, or end them with --all")
        _list(chosen)
        return 1
    return max(_end(engine, force=arguments.force) for engine in chosen)


def _list(engines: Sequence[FoundEngine]) -> None:
    for engine in engines:
        print(f"  {status_line(engine)}: {engine.end_words}")


def _wanted(arguments: argparse.Namespace) -> dict[str, object]:
    """What the command line says of the engine that it names; empty where it names none."""
    wanted: dict[str, object] = {}
    results = arguments.results
    if arguments.rehearsal:
        results = option_values.results_folder(arguments, option_values.settings_of(arguments))
    if arguments.pid is not None:
        wanted["pid"] = arguments.pid
    if arguments.testbed is not None:
        settings = option_values.settings_of(arguments)
        owned = owned_testbed(arguments, settings)
        if owned.kind is SourceKind.SIMULATED:  # whatever is simulated in its results folder
            wanted["kind"] = owned.kind.value
            results = option_values.results_folder(arguments, settings)
        else:
            wanted["stem"] = owned.stem
    elif arguments.domain is not None:
        wanted["domain"] = arguments.domain
    if results is not None:
        wanted["results"] = results.expanduser().resolve()
    return wanted


def _end(engine: FoundEngine, *, force: bool) -> int:
    """End an engine, unless that needs a yes that is not given; 0 if it has ended."""
    try:
        with process_of(engine) as process:
            return _end_process(engine, process, force=force)
    except ProcessLookupError:
        return _say(engine, "ended")


def _end_process(engine: FoundEngine, process: int, *, force: bool) -> int:
    answer = engine.answer
    against = _UNSEEN if answer is None else answer.against_stopping
    if against and not force:
        if not says_yes(f"{engine.who}: {against}. End it all the same? [y/N] "):
            return _say(engine, f"goes on, {against}; {_all_the_same(engine)}", 1)
        force = True
    patience, reply = ENDING_TIME, None
    try:
        if answer is not None:
            reply = ask(engine.stem, greeting.Stop(force))
    except (TimeoutError, MadrobError):
        answer = None
    if isinstance(reply, greeting.StopAnswer) and reply.refused:
        return _say(engine, f"goes on, {terminal_safe(reply.refused)}; {_all_the_same(engine)}", 1)
    if answer is None:
        patience = HANGING_TIME  # one that was stopped has to go on to end in order
        send_signals(process, signal.SIGTERM, signal.SIGCONT)
    if has_ended(process, patience):
        lost = answer is not None and answer.unsaved
        return _say(engine, "ended; what it could not write is lost" if lost else "ended")
    _say(engine, f"pid {engine.pid} has not ended within {patience:g} s, it is killed")
    send_signals(process, signal.SIGKILL)
    if has_ended(process, KILLING_TIME):
        return _say(engine, "ended; the next engine asks about a run that went on")
    return _say(engine, "goes on: the machine waits for a disk, and ends it when that answers", 1)


def _say(engine: FoundEngine, words: str, code: int = 0) -> int:
    print(f"{engine.label}: {words}", flush=True)
    return code


@contextmanager
def owning(
    arguments: argparse.Namespace, owned: Owned, wire_version: int = 0
) -> Iterator[tuple[EngineServer, WhoAnswer, EngineLocks]]:
    """Hold what an engine owns, and answer on its socket, while inside.

    `wire_version` is the version that it will speak with screens; 0 = it accepts none. Yields the
    server, its answer until more is known, and what is held.

    Raises:
        HeldError: another engine has some of it.
    """
    with held(owned) as holding:
        from madrob_console.engine.ipc.server import STARTING, EngineServer

        for remark in holding.remarks:
            complain(remark)
        answer = WhoAnswer(
            RELEASE,
            wire_version,
            results="" if owned.results is None else str(owned.results),
            console=_console_options(arguments, owned) if wire_version else (),
            remarks=holding.remarks,
        )
        by_itself = greeting.Rejected(
            "a `madrob run` has the testbed: wait for its end, or `madrob engine stop --pid "
            f"{os.getpid()}` ends it"
        )
        rejected = STARTING if wire_version else by_itself
        with EngineServer(holding.listening, answer, rejected) as server:
            yield server, answer, holding


def _console_options(arguments: argparse.Namespace, owned: Owned) -> tuple[str, ...]:
    words = ["--testbed", *(arguments.testbed or [owned.kind.value])]
    if owned.domain is not None:
        words.append(f"--domain={owned.domain}")
    if owned.results is not None:
        words.append(f"--results={owned.results}")
    if owned.kind is SourceKind.SIMULATED:
        words += option_words(arguments, options.SIMULATION)
    if arguments.settings is not None:
        words.append(f"--settings={arguments.settings.absolute()}")
    return tuple(words)


_NAMING = ("testbed", "domain", "results", "rehearsal", "settings", *options.SIMULATION)
"""Options that name an engine; any one of them is enough."""


def engines_meant(arguments: argparse.Namespace, results: Path) -> tuple[FoundEngine, ...]:
    """Engines to which a command line without a testbed could attach; none for any other.

    If an engine keeps its runs in `results`, the folder of the settings, it is the only one.
    """
    if any(getattr(arguments, name) != arguments.parser.get_default(name) for name in _NAMING):
        return ()
    running = running_engines()
    engines = tuple(
        engine for engine in running if engine.answer is not None and engine.answer.console
    )
    return tuple(engine for engine in engines if engine.results == results) or engines


def mean(arguments: argparse.Namespace, engine: FoundEngine) -> None:
    assert engine.answer is not None
    # unknown options of a later version are ignored
    typed, _ = arguments.parser.parse_known_args([*engine.answer.console])
    for name in _NAMING:
        setattr(arguments, name, getattr(typed, name))


def ask_which(engines: Sequence[FoundEngine], command: str, results: Path) -> int:
    """List the running engines and what to type for each; a console starts one for `results`."""
    count = "1 engine runs" if len(engines) == 1 else f"{len(engines)} engines run"
    complain(f"{count}: type the line of the one that you mean")
    for engine in engines:
        print(f"  {status_line(engine)}\n    {engine.attach_line(command)}", file=sys.stderr)
    if command == "console":
        own = shlex.join(["madrob", command, "--results", str(results)])
        print(f"  none yet for the results folder of your settings\n    {own}", file=sys.stderr)
    return BAD_INPUT
