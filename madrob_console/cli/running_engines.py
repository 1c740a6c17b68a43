"""Engines that run: status, stop, which one is meant, and what one of them owns."""

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

from madrob_console.cli import options
from madrob_console.cli.attaching import option_words, owned_testbed
from madrob_console.cli.output import BAD_INPUT, complain, print_json, says_yes
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import SourceKind, terminal_safe
from madrob_console.common.version import RELEASE
from madrob_console.engine.ipc import wire
from madrob_console.engine.ipc.discovery import (
    EngineLocks,
    FoundEngine,
    ask,
    has_ended,
    held,
    process_of,
    running_engines,
    send_signals,
)
from madrob_console.engine.ipc.engine_lock import Owned
from madrob_console.engine.ipc.wire import WhoAnswer
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


def _all_the_same(found: FoundEngine) -> str:
    by_itself = found.answer is not None and not found.answer.wire  # `madrob run`
    what = "aborted and does not count" if by_itself else "cut off and kept as interrupted"
    unsaved = found.answer is not None and found.answer.unsaved
    lost = ", and what is not on disk by then is lost" if unsaved else ""
    return f"--force ends it all the same: a run that goes on is {what}{lost}"


def status(*, as_json: bool) -> int:
    """Print one line for each engine of this user; exit code 1 if there is none."""
    found = running_engines()
    if as_json:
        print_json({"engines": [_document(one) for one in found]})
        return 0 if found else 1
    for one in found:
        print(status_line(one))
        for remark in one.answer.remarks if one.answer else ():
            print(f"  {terminal_safe(remark)}")
    if not found:
        print("no engine runs")
    return 0 if found else 1


def _document(found: FoundEngine) -> dict[str, object]:
    """What `madrob engine status --json` says of an engine (`madrob guide data`)."""
    known = found.answer or wire.WhoAnswer(phase="")
    return {
        "pid": found.pid,
        "since": found.since,
        "testbed": found.label,
        "kind": found.kind,
        "domain": found.domain,
        "results": None if found.results is None else str(found.results),
        "version": known.version or None,
        "phase": known.phase or None,
        "run": known.run or None,
        "busy": known.busy,
        "unsaved": known.unsaved,
        "screens": known.screens,
        "remarks": known.remarks,
        "stop": found.stop_line,
    }


def status_line(found: FoundEngine) -> str:
    parts = [found.who.replace(", ", ": ", 1)]
    answer = found.answer
    if answer is None:
        parts.append("there, but silent")
    else:
        known = answer.phase in list(Phase)
        parts.append(PHASES[Phase(answer.phase)] if known else answer.phase)
        if answer.run:
            parts.append(answer.run)
        if answer.screens:
            parts.append("1 screen" if answer.screens == 1 else f"{answer.screens} screens")
    if found.results is not None:
        parts.append(f"runs in {found.results}")
    return terminal_safe(", ".join(parts))


def run_words(snapshot: Snapshot) -> str:
    return ", ".join(filter(None, (PHASES[snapshot.run.phase], wire.run_title(snapshot.run))))


def stop(arguments: argparse.Namespace) -> int:
    """End the named engines, or the only one; exit code 1 if one goes on or none is found."""
    wanted = _wanted(arguments)
    found = running_engines()
    chosen = [one for one in found if all(getattr(one, key) == wanted[key] for key in wanted)]
    if not chosen:
        what = "the engine that is named does not run" if wanted else "no engine runs"
        print(f"{what}; these do:" if found else what)
        _list(found)
        return 1 if wanted else 0
    if len(chosen) > 1 and not arguments.all:
        print(f"{len(chosen)} engines run: name one of them, or end them with --all")
        _list(chosen)
        return 1
    return max(_end(one, force=arguments.force) for one in chosen)


def _list(found: Sequence[FoundEngine]) -> None:
    for one in found:
        print(f"  {status_line(one)}: {one.end_words}")


def _wanted(arguments: argparse.Namespace) -> dict[str, object]:
    """What the command line says of the engine that it names; empty where it names none."""
    wanted: dict[str, object] = {}
    results = arguments.results
    if arguments.rehearsal:
        results = options.results_folder(arguments, options.settings_of(arguments))
    if arguments.pid is not None:
        wanted["pid"] = arguments.pid
    if arguments.testbed is not None:
        settings = options.settings_of(arguments)
        owned = owned_testbed(arguments, settings)
        if owned.kind is SourceKind.SIMULATED:  # whatever is simulated in its results folder
            wanted["kind"] = owned.kind.value
            results = options.results_folder(arguments, settings)
        else:
            wanted["stem"] = owned.stem
    elif arguments.domain is not None:
        wanted["domain"] = arguments.domain
    if results is not None:
        wanted["results"] = results.expanduser().resolve()
    return wanted


def _end(found: FoundEngine, *, force: bool) -> int:
    """End an engine, unless that needs a yes that is not given; 0 if it has ended."""
    try:
        with process_of(found) as process:
            return _end_process(found, process, force=force)
    except ProcessLookupError:
        return _say(found, "ended")


def _end_process(found: FoundEngine, process: int, *, force: bool) -> int:
    answer = found.answer
    against = _UNSEEN if answer is None else answer.against_stopping
    if against and not force:
        if not says_yes(f"{found.who}: {against}. End it all the same? [y/N] "):
            return _say(found, f"goes on, {against}; {_all_the_same(found)}", 1)
        force = True
    patience, told = ENDING_TIME, None
    try:
        if answer is not None:
            told = ask(found.stem, wire.Stop(force))
    except (TimeoutError, MadrobError):
        answer = None
    if isinstance(told, wire.StopAnswer) and told.refused:
        return _say(found, f"goes on, {terminal_safe(told.refused)}; {_all_the_same(found)}", 1)
    if answer is None:
        patience = HANGING_TIME  # one that was stopped has to go on to end in order
        send_signals(process, signal.SIGTERM, signal.SIGCONT)
    if has_ended(process, patience):
        lost = answer is not None and answer.unsaved
        return _say(found, "ended; what it could not write is lost" if lost else "ended")
    _say(found, f"pid {found.pid} has not ended within {patience:g} s, it is killed")
    send_signals(process, signal.SIGKILL)
    if has_ended(process, KILLING_TIME):
        return _say(found, "ended; the next engine asks about a run that went on")
    return _say(found, "goes on: the machine waits for a disk, and ends it when that answers", 1)


def _say(found: FoundEngine, words: str, code: int = 0) -> int:
    print(f"{found.label}: {words}", flush=True)
    return code


# The locks and the answers of a process that is a testbed's engine.


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
        known = WhoAnswer(
            RELEASE,
            wire_version,
            results="" if owned.results is None else str(owned.results),
            console=_console_options(arguments, owned) if wire_version else (),
            remarks=holding.remarks,
        )
        by_itself = wire.Rejected(
            "a `madrob run` has the testbed: wait for its end, or `madrob engine stop --pid "
            f"{os.getpid()}` ends it"
        )
        rejected = STARTING if wire_version else by_itself
        with EngineServer(holding.listening, known, rejected) as server:
            yield server, known, holding


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


# A command line without a testbed: it means the engine that runs.


_NAMING = ("testbed", "domain", "results", "rehearsal", "settings", *options.SIMULATION)
"""Options that name an engine; any one of them is enough."""


def engines_meant(arguments: argparse.Namespace, results: Path) -> tuple[FoundEngine, ...]:
    """Engines to which a command line without a testbed could attach; none for any other.

    If an engine keeps its runs in `results`, the folder of the settings, it is the only one.
    """
    if any(getattr(arguments, name) != arguments.parser.get_default(name) for name in _NAMING):
        return ()
    found = running_engines()
    engines = tuple(one for one in found if one.answer is not None and one.answer.console)
    return tuple(one for one in engines if one.results == results) or engines


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
    for one in engines:
        print(f"  {status_line(one)}\n    {one.attach_line(command)}", file=sys.stderr)
    if command == "console":
        own = shlex.join(["madrob", command, "--results", str(results)])
        print(f"  none yet for the results folder of your settings\n    {own}", file=sys.stderr)
    return BAD_INPUT
