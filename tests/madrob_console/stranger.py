"""A process of another user that takes names of engines and answers nobody."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from madrob_console.engine.engine_lock import address_of

NOBODY = 65534

_PROGRAM = f"""
import os, socket, sys
os.setuid({NOBODY})
backlog, kept = int(sys.argv[1]), []
for name in sys.argv[2:]:
    address = name.replace("@", chr(0))
    taken = socket.socket(socket.AF_UNIX)
    taken.bind(address)
    taken.listen(backlog)
    kept.append(taken)
    while not backlog:  # until it is full
        caller = socket.socket(socket.AF_UNIX)
        caller.setblocking(False)
        kept.append(caller)
        try:
            caller.connect(address)
        except BlockingIOError:
            break
print("there", flush=True)
sys.stdin.read()
"""


@contextmanager
def stranger(*names: str, full: bool) -> Iterator[subprocess.Popen[bytes]]:
    """It has these names of this user while inside; `full`: it accepts no more connections."""
    if os.getuid() != 0:
        pytest.skip("only root can be another user")
    addresses = [address_of(name).replace("\0", "@") for name in names]
    with subprocess.Popen(
        [sys.executable, "-c", _PROGRAM, "0" if full else "9", *addresses],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        assert process.stdout.readline() == b"there\n"
        try:
            yield process
            assert process.poll() is None  # it is not ours to be ended
        finally:
            process.stdin.close()
