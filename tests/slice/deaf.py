"""`python -m tests.slice.deaf SOCKET COUNT`: screens that attach and never read."""

from __future__ import annotations

import signal
import socket
import sys

from tests.slice.wire import Hello, Role, frame

if __name__ == "__main__":
    screens = []
    for _ in range(int(sys.argv[2])):
        screen = socket.socket(socket.AF_UNIX)
        screen.connect(sys.argv[1])
        screen.sendall(frame(Hello(Role.WATCH, "deaf")))
        screens.append(screen)
    signal.pause()
