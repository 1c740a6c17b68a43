"""What screens, robot and testbed get while the disk is frozen: a terminal, and DDS."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from madrob_console.messages.codec import REFEREE_STATE_TOPIC, MessageTypes, decode_text
from madrob_console.referee.acts import Abort
from scoring.protocol import Outcome
from tests.madrob_console.console_process import ENTER, F5, F6, F7, F8, Hall, start_a_run
from tests.madrob_console.engine_process import ROOT, STARTING, EngineProcess
from tests.madrob_console.refereed_run import Referee
from tests.madrob_console.ros_peer import Peer
from tests.madrob_console.small_disk import SmallDisk, disk_image
from tests.terminal import Terminal

pytestmark = [pytest.mark.slow, pytest.mark.needs("mkfs.ext4")]

AT_ONCE = 0.2  # s, from the key to the topic
ON_SCREEN = 1.5  # s, from the key to the screen, drawn by a busy machine
STAYS = 2.0  # s, in which the words are looked at again and again
SILENT = "disk silent for"
_TYPES = MessageTypes()


@contextmanager
def hall_on(disk: SmallDisk) -> Iterator[Hall]:
    with Hall(speed=1.0) as hall:
        hall.results = disk.folder / "runs"
        settings = hall.folder / "madrob.toml"
        settings.write_text("[results]\nreports = false\n[checks]\ndisk_space = 0\n")
        yield hall


def pressed(terminal: Terminal, keys: str, *texts: str) -> float:
    """How long it takes from keys to what they bring, s."""
    began = time.monotonic()
    terminal.send(keys)
    terminal.wait_for(*texts)
    return time.monotonic() - began


def test_a_screen_says_that_the_disk_is_silent_and_abort_works(tmp_path: Path) -> None:
    with (
        disk_image(tmp_path / "disk") as disk,
        hall_on(disk) as hall,
        hall.console(columns=120, lines=40) as terminal,
    ):
        start_a_run(terminal)
        folder = hall.wait_for_running()
        with disk.stalled():
            terminal.wait_for(SILENT, timeout=5.0)
            terminal.send(F8)
            terminal.wait_for("ABORT the run")
            terminal.send("1")
            took = pressed(terminal, "y", "ABORTED")
            terminal.wait_for("NOT ON DISK YET", timeout=5.0)
            stays = time.monotonic() + STAYS
            while time.monotonic() < stays:
                terminal.wait_for("NOT ON DISK YET", timeout=0.1)
                terminal.wait_for(SILENT, timeout=0.1)
            shown = terminal.screen()
        assert hall.wait_for_result(folder)["outcome"] == "aborted"
        terminal.wait_for("f finalises it")
        assert not any(SILENT in line or "NOT ON DISK" in line for line in terminal.screen())
    print(f"\naborted on the screen {1000 * took:.0f} ms after the key, the disk being frozen:")
    print("\n".join(line for line in shown if SILENT in line or "NOT ON DISK" in line))
    assert took <= ON_SCREEN


def test_a_start_that_the_disk_holds_up_is_refused_on_the_screen_and_never_comes(
    tmp_path: Path,
) -> None:
    with (
        disk_image(tmp_path / "disk") as disk,
        hall_on(disk) as hall,
        hall.console(columns=120, lines=40) as terminal,
    ):
        terminal.wait_for("all fresh and at rate", timeout=STARTING)
        terminal.send(ENTER)
        terminal.wait_for("is set up", timeout=STARTING)
        terminal.send(F7)
        terminal.wait_for("Done: zero the handle", timeout=STARTING)
        terminal.send(F6)
        terminal.wait_for("all passed or waived", timeout=STARTING)
        with disk.stalled():
            took = pressed(terminal, F5, "Refused: start")
            shown = [line for line in terminal.screen() if "Refused: start" in line]
            time.sleep(3.0)
        time.sleep(3.0)  # in which it could come late
        assert not any(
            word in line for word in ("COUNTDOWN", "RUNNING") for line in terminal.screen()
        )
    print(f"\nrefused after {1000 * took:.0f} ms: {shown}")
    assert 1.5 <= took <= 3.5


def test_an_abort_is_on_dds_at_once_while_the_disk_is_frozen(
    ros_domain: int, tmp_path: Path
) -> None:
    testbed = subprocess.Popen(
        [sys.executable, "-m", "madrob_console.cli.main", "testbed", "--scenario", "touch-only"],
        cwd=ROOT,
        env=os.environ,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        with (
            disk_image(tmp_path / "disk") as disk,
            EngineProcess(disk.folder / "results", None) as engine,
            Peer(ros_domain) as peer,
        ):
            heard = peer.listen_raw(REFEREE_STATE_TOPIC, "std_msgs/msg/String")
            referee = Referee(engine, patience=STARTING)
            referee.start(timeout=60.0)
            peer.until(lambda: "running" in phases(heard))
            with disk.stalled():
                time.sleep(1.0)
                pressing = threading.Thread(target=lambda: referee.do(Abort("unsafe")))
                began = time.monotonic()
                pressing.start()
                peer.until(lambda: "stopped" in phases(heard))
                took = time.monotonic() - began
                pressing.join()
            referee.until(lambda s: s.result is not None)
            result = referee.snapshot().result
            assert result is not None
            assert result.outcome is Outcome.ABORTED
    finally:
        testbed.terminate()
        testbed.wait()
    print(f"\nan abort was on {REFEREE_STATE_TOPIC} after {1000 * took:.0f} ms")
    assert took <= AT_ONCE


def phases(heard: list[bytes]) -> list[str]:
    """The phases that were announced."""
    return [json.loads(decode_text(_TYPES, data))["phase"] for data in heard]
