"""In a real terminal: whatever bytes come, F8 y ends the run and Escape leads back."""

from __future__ import annotations

import random
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, suppress

import pytest

from madrob_console.common.errors import MadrobError
from madrob_console.engine.ipc.client import RemoteEngine
from madrob_console.engine.ipc.discovery import running_engines
from madrob_console.engine.requests import Perform, Role, TakeOver
from madrob_console.referee.acts import Abort, Act, ConfirmPose, SetUp, Start, ZeroHandle
from madrob_console.referee.run import Phase
from tests.madrob_console.engine.drive import make_setup
from tests.madrob_console.engine_process import ROOT, STARTING, Hall
from tests.terminal import KEYS, Terminal, Tmux
from tests.watching import until

SIZES = [(80, 24), (120, 36), (40, 12), (20, 5), (1, 1), (200, 50)]
PIECES = [
    *(KEYS[f"F{number}"].encode() for number in range(1, 10)),
    *(key.encode() for key in ("\x1b", "\r", "\t", " ", "\x1b[A", "\x1b[B", "\x1b[Z", "\x10")),
    *(letter.encode() for letter in "nyyy123456xihpsfdagcPrzvw/?[]"),
    *(b"\x1b[", b"\x1b[1", b"\x1bO", b"\x1b[<0;20;", b"\x1b[200~", b"\x1b[201~"),
    *(b"\x1b[I", b"\x1b[O", b"\xff\xfe\x80", b"\x1b[99m", b"\x1b]0;x\x07", b"1c y" * 200),
    *(b"\x1b[200~1c2d\x1b[31m3d\x1b[0m\ny\x1b[201~", b"\x1b[200~a\x1b[200~b\x1b[201~1c\x1b[201~"),
]


def clicks(rng: random.Random) -> bytes:
    """Reports of the mouse, within the screen and beyond it."""
    x, y, button = rng.randint(0, 220), rng.randint(0, 60), rng.choice([0, 0, 2, 64, 65])
    press = f"\x1b[<{button};{x};{y}M"
    return (press + press.lower() * (button < 64)).encode()


def send_anything(seat: Terminal, rng: random.Random) -> list[bytes | tuple[int, int]]:
    """Bytes and sizes by chance, at times by chance; what they were."""
    sent: list[bytes | tuple[int, int]] = []
    for _ in range(rng.randint(1, 10)):
        kind = rng.random()
        if kind < 0.1:
            size = rng.choice(SIZES)
            seat.resize(*size)
            sent.append(size)
        else:
            data = clicks(rng) if kind < 0.35 else rng.choice(PIECES)
            cut = rng.randint(0, len(data)) if rng.random() < 0.2 else 0
            for piece in filter(None, (data[:cut], data[cut:])):
                seat.send(piece)
                pause(seat, rng.choice([0.0, 0.0, 0.05, 0.3]))
            sent.append(data)
    return sent


def pause(seat: Terminal, duration: float) -> None:
    """A moment of the referee; what is drawn is read."""
    end = time.monotonic() + duration
    while (left := end - time.monotonic()) > 0:
        seat.screen()
        time.sleep(min(left, 0.02))


class Starter:
    """Another console, which starts one run after the other."""

    def __init__(self) -> None:
        (engine,) = running_engines()
        self.client = RemoteEngine(engine.stem, Role.REFEREE, "bo@tent (2)")
        self._number = 0

    @property
    def running(self) -> bool:
        return self.client.snapshot().run.active

    def start(self) -> None:
        self._number += 1
        self.client.send_request(TakeOver())
        if self.running:
            self._act(Abort("the test before"))
        until(lambda: self._done(SetUp(make_setup(run_number=self._number, timeout=300.0))))
        for act in (*[ZeroHandle()] * (self._number == 1), ConfirmPose(), Start()):
            until(lambda act=act: self._done(act), STARTING)  # type: ignore[misc]
        until(lambda: self.client.snapshot().run.phase is Phase.RUNNING, STARTING)

    def _act(self, act: Act) -> None:
        assert self.client.send_request(Perform.of(act)) is None

    def _done(self, act: Act) -> bool:
        with suppress(MadrobError):
            return self.client.send_request(Perform.of(act)) is None
        return False


def back(seat: Terminal) -> Sequence[str]:
    """Escape, so often that whatever is open is closed."""
    seat.resize(80, 24)
    for _ in range(8):
        seat.send(b"\x1b")
        pause(seat, 0.15)
    pause(seat, 0.6)
    return seat.screen()


@pytest.fixture
def hall(monkeypatch: pytest.MonkeyPatch) -> Iterator[Hall]:
    with Hall(speed=4.0) as hall:
        monkeypatch.setenv("XDG_STATE_HOME", str(hall.folder))
        yield hall


@pytest.mark.slow
@pytest.mark.needs("tmux")
def test_whatever_comes_f8_y_ends_the_run_and_escape_leads_back(
    hall: Hall, request: pytest.FixtureRequest
) -> None:
    rng = random.Random(36)
    with ExitStack() as stack:
        seat = stack.enter_context(Tmux(hall.command(), env=hall.environment, cwd=ROOT))
        seat.wait_for("Set up this run", timeout=STARTING)
        starter = Starter()
        stack.callback(starter.client.close)
        for _ in range(max(4, request.config.getoption("--runs"))):
            starter.start()
            sent = send_anything(seat, rng)
            if starter.running:
                pause(seat, 0.05)
                seat.press("F8", "y")

                def has_ended() -> bool:
                    pause(seat, 0.02)
                    return not starter.running

                until(has_ended)
            shown = back(seat)
            assert not any("a question is open" in row for row in shown), (sent, shown)
