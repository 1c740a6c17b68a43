"""What a process does that is the engine of a testbed: it owns that, and answers for it."""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager

from madrob_console.cli import options
from madrob_console.cli.problems import complain
from madrob_console.engine.process.control import ControlPort, WhoAnswer
from madrob_console.engine.process.holding import Holding, held
from madrob_console.engine.process.owned import Owned
from madrob_console.kinds import SourceKind
from madrob_console.version import RELEASE


@contextmanager
def owning(
    arguments: argparse.Namespace, owned: Owned, wire_version: int = 0
) -> Iterator[tuple[ControlPort, WhoAnswer, Holding]]:
    """Hold what an engine owns and answer whoever asks for it, while inside.

    Args:
        arguments: the command line.
        owned: by this engine.
        wire_version: what it will speak with screens; 0 = it takes none.

    Yields:
        What answers, what it says until more is known, and what is held.

    Raises:
        HeldError: another engine has some of it.
    """
    lock_testbed = bool(wire_version) or owned.domain is not None
    with held(owned, lock_testbed=lock_testbed) as holding:
        for remark in holding.remarks:
            complain(remark)
        presence = WhoAnswer(
            os.getpid(),
            RELEASE,
            wire_version,
            kind=owned.kind.value,
            domain=owned.domain,
            results="" if owned.results is None else str(owned.results),
            started=time.time(),
            console=_console_options(arguments, owned) if wire_version else (),
            remarks=holding.remarks,
        )
        with ControlPort(holding.listening, lambda: presence) as control:
            yield control, presence, holding


def _console_options(arguments: argparse.Namespace, owned: Owned) -> tuple[str, ...]:
    """The options with which a console attaches to the engine of these arguments."""
    words = ["--testbed", *(arguments.testbed or [owned.kind.value])]
    if owned.domain is not None:
        words += ["--domain", str(owned.domain)]
    if owned.results is not None:
        words += ["--results", str(owned.results)]
    if owned.kind is SourceKind.SIMULATED:
        for name in options.SIMULATION:
            if (value := getattr(arguments, name)) != arguments.parser.get_default(name):
                words += [f"--{name}", f"{value:g}" if isinstance(value, float) else str(value)]
    if arguments.settings is not None:
        words += ["--settings", str(arguments.settings.absolute())]
    return tuple(words)
