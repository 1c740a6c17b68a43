from __future__ import annotations

import signal

import pytest

from tests.terminal import Terminal


def test_a_program_gets_a_terminal_of_the_size_asked_for_and_what_is_typed() -> None:
    script = "stty size; read line; echo got $line; exit 3"
    with Terminal(["sh", "-c", script], columns=100, lines=30) as terminal:
        terminal.wait_for("30 100")
        terminal.send("a word\r")
        terminal.wait_for("got a word")
        assert terminal.wait_exit() == 3
        assert terminal.screen()[:3] == ["30 100", "a word", "got a word"]


def test_hanging_up_reaches_the_program() -> None:
    with Terminal(["sh", "-c", "echo ready; sleep 60"]) as terminal:
        terminal.wait_for("ready")
        terminal.hang_up()
        assert terminal.wait_exit() == -signal.SIGHUP


@pytest.mark.parametrize(
    ("script", "patience", "complaint"),
    [
        ("echo something else", 30.0, r"ended before 'a word':\nsomething else"),
        ("echo something else; sleep 60", 2.0, r"did not come in 2 s:\nsomething else"),
    ],
)
def test_waiting_in_vain_shows_the_screen(script: str, patience: float, complaint: str) -> None:
    with Terminal(["sh", "-c", script]) as terminal, pytest.raises(AssertionError, match=complaint):
        terminal.wait_for("a word", timeout=patience)
