"""A disk that does not answer takes nothing from the referee: real processes, a frozen file system.

Its own ioctl freezes it: each call that would change it waits until it is thawed."""

from __future__ import annotations

import json
import threading
import time
from pathlib import Path

import pytest

from madrob_console.messages.codec import REFEREE_STATE_TOPIC, decode_text
from madrob_console.referee.acts import Abort
from tests.madrob_console.engine.drive import make_setup
from tests.madrob_console.engine_process import (
    STARTING,
    EngineProcess,
    Hall,
    madrob_beside,
    result_of,
)
from tests.madrob_console.ros_peer import KEPT, TYPES, Peer
from tests.madrob_console.small_disk import disk_image
from tests.terminal import Terminal
from tests.watching import Stutter, until

AT_ONCE = 0.2  # s, within which an abort takes effect
ANSWERED = 2.5  # s; an act that is not on disk after 2 s is withdrawn
FROZEN_FOR = 1.0  # s that the disk has been silent when the referee acts
LATE = 3.0  # s in which what was refused could still come
SILENT = "disk silent for"
ON_SCREEN = 1.5  # s, from the key to the screen, drawn by a busy machine


def key_pressed(terminal: Terminal, key: str, *texts: str) -> float:
    """How long it takes from a key to what it brings, s."""
    began = time.monotonic()
    terminal.press(key)
    terminal.wait_for(*texts)
    return time.monotonic() - began


@pytest.mark.slow
@pytest.mark.needs("mkfs.ext4")
def test_a_screen_says_that_the_disk_is_silent_aborts_and_refuses_a_start(tmp_path: Path) -> None:
    with (
        disk_image(tmp_path / "disk") as disk,
        Hall(speed=1.0, results=disk.folder / "runs") as hall,
        hall.console(columns=120, lines=40) as terminal,
        Stutter() as stutter,
    ):
        terminal.start_a_run()
        folder = hall.wait_for_running()
        with disk.hanging():
            terminal.wait_for(SILENT)
            terminal.press("F8")
            terminal.wait_for("ABORT the run")
            terminal.send("1")
            assert key_pressed(terminal, "y", "ABORTED") <= ON_SCREEN + stutter.allowance
            terminal.wait_for("NOT ON DISK YET")
            terminal.wait_for(SILENT)
        assert result_of(folder, STARTING)["outcome"] == "aborted"
        until(lambda: not terminal.shows(SILENT, "NOT ON DISK"))
        terminal.make_ready()
        with disk.hanging():
            took = key_pressed(terminal, "F5", "Refused: start")
            assert 1.5 <= took <= ANSWERED + ON_SCREEN + stutter.allowance
        late = time.monotonic() + LATE
        while time.monotonic() < late:
            assert not terminal.shows("COUNTDOWN")
            time.sleep(0.1)


@pytest.mark.slow
@pytest.mark.needs("mkfs.ext4")
def test_an_abort_is_on_dds_at_once_while_the_disk_is_frozen(
    ros_domain: int, tmp_path: Path
) -> None:
    with (
        madrob_beside("testbed", "--scenario=touch-only", output=tmp_path / "testbed"),
        disk_image(tmp_path / "disk") as disk,
        EngineProcess(disk.folder / "results", None) as engine,
        Peer(ros_domain) as peer,
        Stutter() as stutter,
    ):
        heard = peer.listen_raw(REFEREE_STATE_TOPIC, "std_msgs/msg/String", KEPT)

        def announced(phase: str) -> bool:
            return any(json.loads(decode_text(TYPES, data))["phase"] == phase for data in heard)

        engine.start(make_setup(timeout=60.0))
        peer.until(lambda: announced("running"))
        with disk.hanging():
            time.sleep(FROZEN_FOR)
            pressing = threading.Thread(target=lambda: engine.act(Abort("unsafe")))
            began = time.monotonic()
            pressing.start()
            peer.until(lambda: announced("stopped"))
            took = time.monotonic() - began
            pressing.join()
        print(f"\nan abort was on {REFEREE_STATE_TOPIC} after {1000 * took:.0f} ms")
        assert took <= AT_ONCE + stutter.allowance
        assert engine.result()["outcome"] == "aborted"
