"""Text to the clipboard of the referee's own machine, through SSH and tmux (OSC 52)."""

from __future__ import annotations

import asyncio
import base64
from collections.abc import Mapping
from contextlib import suppress

TMUX_TIME = 2.0
"""tmux has so long to take a text, s."""

_MULTIPLEXED = "tmux"


def clipboard_sequences(text: str, environ: Mapping[str, str]) -> str:
    """What to write to the terminal so that it takes `text`.

    A tmux passes on neither by itself: the plain sequence with `set-clipboard on`, the wrapped one
    with `allow-passthrough on`.

    Args:
        text: of any length that the terminal takes; most take 70 kB.
        environ: of this process; TERM crosses SSH.
    """
    plain = f"\x1b]52;c;{base64.b64encode(text.encode()).decode()}\x07"
    if not in_tmux(environ):
        return plain
    doubled = plain.replace("\x1b", "\x1b\x1b")
    return f"{plain}\x1bP{_MULTIPLEXED};{doubled}\x1b\\"


def in_tmux(environ: Mapping[str, str]) -> bool:
    """Whether the terminal is a tmux, here or at the other end of SSH."""
    return bool(environ.get("TMUX")) or environ.get("TERM", "").startswith(_MULTIPLEXED)


async def give_to_tmux(text: str, environ: Mapping[str, str]) -> bool:
    """Hand a text to the tmux of this machine, which hands it to its terminal (`load-buffer -w`).

    That works with the settings that tmux comes with. Returns whether there is one that took it.
    """
    if not environ.get("TMUX"):
        return False
    try:
        process = await asyncio.create_subprocess_exec(
            _MULTIPLEXED, "load-buffer", "-w", "-",
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.DEVNULL,
            stderr=asyncio.subprocess.DEVNULL,
            env=dict(environ),
        )  # fmt: skip
    except OSError:
        return False
    try:
        await asyncio.wait_for(process.communicate(text.encode()), TMUX_TIME)
    except TimeoutError:
        with suppress(ProcessLookupError):
            process.kill()
        return False
    return process.returncode == 0
