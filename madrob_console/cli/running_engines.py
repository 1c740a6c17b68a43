"""`madrob engine status` and `stop`: all engines of this user, and the end of one of them."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path

from madrob_console.cli import options
from madrob_console.cli.asking import says_yes
from madrob_console.cli.attaching import owned_testbed
from madrob_console.cli.problems import complain
from madrob_console.config import load_settings
from madrob_console.engine.process.control import Inquiry, WhoAnswer, ask, stop_answer_in
from madrob_console.engine.process.ending import EngineHandle
from madrob_console.engine.process.engines import FoundEngine, all_engines
from madrob_console.engine.process.owned import results_name
from madrob_console.engine.shown import wire
from madrob_console.engine.shown.snapshot import Snapshot
from madrob_console.errors import MadrobError
from madrob_console.kinds import SourceKind
from madrob_console.names import terminal_safe
from madrob_console.referee.run import Phase
from madrob_console.ui.look.words import PHASES

ENDING_TIME = 30.0
"""An engine that ends in order has so long to close its recording and write the result, s."""

HANGING_TIME = 10.0
"""One that did not answer has so long to heed a signal, s."""

KILLING_TIME = 5.0
"""What is killed is gone by then, unless the kernel waits for a disk, s."""

_UNSEEN = "whether a run goes on cannot be seen"


def _all_the_same(found: FoundEngine) -> str:
    """What --force does to a run that goes on, and to one that is not on disk."""
    by_itself = found.presence is not None and not found.presence.wire  # `madrob run`
    what = "aborted and does not count" if by_itself else "cut off and kept as interrupted"
    unsaved = found.presence is not None and found.presence.unsaved
    lost = ", and what is not on disk by then is lost" if unsaved else ""
    return f"--force ends it all the same: a run that goes on is {what}{lost}"


def status() -> int:
    """One line for each engine of this user; exit code 1 if there is none."""
    found, unseen = all_engines()
    for one in found:
        print(status_line(one))
        for remark in one.presence.remarks if one.presence else ():
            print(f"  {terminal_safe(remark)}")
    _complain_of(unseen)
    if not found:
        print("no engine runs")
    return 0 if found else 1


def status_line(found: FoundEngine) -> str:
    """What is known of an engine."""
    parts = [f"{found.label}: {found.process}"]
    presence = found.presence
    if presence is None:
        parts += [_without_answer(found)]
        if (folder := found.locked_folder) is not None:
            parts.append(f"runs in {terminal_safe(str(folder))}")
        if found.killed:
            parts.append("killed: it ends when a disk answers")
    else:
        known = presence.phase in list(Phase)
        parts.append(PHASES[Phase(presence.phase)] if known else terminal_safe(presence.phase))
        if presence.run:
            parts.append(terminal_safe(presence.run))
        if presence.screens:
            parts.append("1 screen" if presence.screens == 1 else f"{presence.screens} screens")
        if presence.results:
            parts.append(f"runs in {terminal_safe(presence.results)}")
        if presence.wire not in (0, wire.VERSION):
            parts.append(f"of another version ({terminal_safe(presence.version)})")
        if presence.socket and not Path(presence.socket).exists():
            parts.append("its socket is lost, it is made again at once")
    return ", ".join(parts)


def _without_answer(found: FoundEngine) -> str:
    """What is known of an engine that does not say what it does."""
    if found.silent:
        return "there, but silent"
    if found.speaks == wire.VERSION:
        where = "in another network namespace, " if found.pid else ""
        return f"{where}more is not seen from here"
    version = "" if found.speaks is None else f" (it speaks {found.speaks}, not {wire.VERSION})"
    return f"of another version, which says no more{version}"


def run_words(snapshot: Snapshot) -> str:
    """How far the run is, for people."""
    run = WhoAnswer().of(snapshot.run, busy=False).run
    return ", ".join(filter(None, (PHASES[snapshot.run.phase], run)))


def stop(arguments: argparse.Namespace) -> int:
    """End the engines that are named, or the only one.

    Returns:
        The exit code: 1 if one of them goes on, or none runs that is named.

    Raises:
        MadrobError: what is named does not exist.
    """
    is_meant = _Named(arguments)
    found, unseen = all_engines(is_meant.names)
    chosen = [one for one in found if is_meant(one)]
    _complain_of(unseen)
    if not chosen:
        what = "the engine that is named does not run" if is_meant.named else "no engine runs"
        print(f"{what}; these do:" if found else what)
        _list(found)
        return 1 if is_meant.named else 0
    if len(chosen) > 1 and not arguments.all:
        print(f"{len(chosen)} engines run: name one of them, or end them with --all")
        _list(chosen)
        return 1
    codes = [_end(one, force=arguments.force) for one in chosen]
    return max(codes)


def _list(found: Sequence[FoundEngine]) -> None:
    for one in found:
        print(f"  {status_line(one)}: {one.end_words}")


def _complain_of(unseen: Sequence[str]) -> None:
    for problem in unseen:
        complain(problem)


class _Named:
    """What the engines must be that are meant; a console's options mean the one it would show.

    Args:
        arguments: the command line.

    Attributes:
        names: under which they may be found.

    Raises:
        MadrobError: there is no such testbed.
    """

    def __init__(self, arguments: argparse.Namespace) -> None:
        self.names: list[str] = []
        self._tests: list[Callable[[FoundEngine], bool]] = []
        domain, results = arguments.domain, arguments.results
        if (pid := arguments.pid) is not None:
            self._tests.append(lambda one: one.pid == pid)
        if arguments.testbed is not None:
            settings = load_settings(arguments.settings)
            owned = owned_testbed(arguments, settings)
            self._tests.append(lambda one: one.kind == owned.kind)
            match owned.kind:
                case SourceKind.ROS:
                    domain = owned.domain
                case SourceKind.SIMULATED if results is None:
                    results = options.results_folder(arguments, settings)
                case SourceKind.REPLAY:
                    self._tests.append(lambda one: one.testbed == owned.testbed)
                    self.names.append(owned.testbed)
        if domain is not None:
            self._tests.append(lambda one: one.domain == domain)
            self.names.append(f"domain/{domain}")
        if results is not None:
            self._add_results(results.expanduser().resolve())

    @property
    def named(self) -> bool:
        """Whether anything is named."""
        return bool(self._tests)

    def _add_results(self, folder: Path) -> None:
        name = results_name(folder)
        self._tests.append(lambda one: name in one.names or one.results == folder)
        if name is not None:
            self.names.append(name)

    def __call__(self, found: FoundEngine) -> bool:
        """Whether it is meant."""
        return all(is_so(found) for is_so in self._tests)


def _end(found: FoundEngine, *, force: bool) -> int:
    """End an engine, unless that needs a yes that is not given; 0 if it has ended."""
    try:
        with EngineHandle(found) as handle:
            return _end_process(found, handle, force=force)
    except ProcessLookupError:
        return _say(found, "ended")
    except MadrobError as error:
        complain(error)
        return 1


def _end_process(found: FoundEngine, handle: EngineHandle, *, force: bool) -> int:
    presence = found.presence
    against = _UNSEEN if presence is None else presence.against_stopping
    if against and not force:
        if not says_yes(f"{found.who}: {against}. End it all the same? [y/N] "):
            return _say(found, f"goes on, {against}; {_all_the_same(found)}", 1)
        force = True
    told, hangs = False, found.silent
    if presence is not None:
        heard = ask(found.names[0], Inquiry("stop", force))
        answer = stop_answer_in(heard.line if heard else b"")
        if answer.refused:
            return _say(
                found, f"goes on, {terminal_safe(answer.refused)}; {_all_the_same(found)}", 1
            )
        told = answer.ends or heard is None
        hangs = heard is not None and not heard.line
    if not told:
        handle.terminate()
    patience = HANGING_TIME if hangs else ENDING_TIME
    if handle.ended(patience):
        lost = presence is not None and presence.unsaved
        return _say(found, "ended; what it could not write is lost" if lost else "ended")
    _say(found, f"{found.process} has not ended within {patience:g} s, it is killed")
    handle.kill()
    if handle.ended(KILLING_TIME):
        return _say(found, "ended; the next engine asks about a run that went on")
    return _say(found, "goes on: the machine waits for a disk, and ends it when that answers", 1)


def _say(found: FoundEngine, words: str, code: int = 0) -> int:
    print(f"{found.label}: {words}", flush=True)
    return code
