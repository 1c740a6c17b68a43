"""What others name, say or type may hold anything; a terminal shows it and obeys none of it."""

from __future__ import annotations

import sys
import unicodedata
from contextlib import suppress
from pathlib import Path
from unittest.mock import Mock

import pytest

from madrob_console.cli import main as command_line
from madrob_console.cli.main import COMMANDS, main
from madrob_console.testbeds.simulated.simulated_source import SimulatedSource

HOSTILE = "\x1b]0;owned\x07\x1b[2J\x9b31m\r\x08\u202e\x1b"


@pytest.fixture(autouse=True)
def _own_engines(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))


def said(capfd: pytest.CaptureFixture[str], *arguments: str) -> str:
    """Everything that a command says; nothing of it moves a cursor or names a window."""
    with suppress(SystemExit):  # argparse's
        main(list(arguments))
    out, err = capfd.readouterr()
    words = out + err
    bad = {char for char in words if unicodedata.category(char) in ("Cc", "Cf")} - {"\n"}
    assert not bad, repr(words)
    return words


@pytest.mark.parametrize("command", COMMANDS)
def test_what_is_typed_is_repeated_without_what_a_terminal_would_obey(
    command: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)  # some make what they are told
    for arguments in ([f"--{HOSTILE}x"], [f"{HOSTILE}y"], ["--settings", f"/{HOSTILE}z"]):
        assert said(capfd, command, *arguments) != ""


def test_what_a_testbed_says_is_a_plain_line_of_a_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(SimulatedSource, "sides_problem", f"refused:{HOSTILE}\nBOOM")
    monkeypatch.setattr(SimulatedSource, "label", f"SIM {HOSTILE}")
    results = tmp_path / f"re{HOSTILE}sults"
    flags = ["--speed=0", "--countdown=1", "--timeout=1", "--no-report"]
    words = said(capfd, "run", "--testbed", "simulated", *flags, f"--results={results}")
    assert "note: refused:  BOOM\n" in words
    assert "\nrun folder: " in words
    [folder] = map(str, results.glob("practice/subject_*"))
    named = f"--results={results}"
    for arguments in (
        ("score", folder),
        ("recover", folder),
        ("standings", named),
        ("table", "runs", named),
        ("table", "events", named),
        ("export", named, "--subject=1"),
    ):
        assert said(capfd, *arguments) != ""


def test_a_traceback_is_made_safe_as_well(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(command_line, "build_parser", Mock(side_effect=ValueError(HOSTILE)))
    monkeypatch.setattr(sys, "argv", ["madrob", "settings"])
    assert main() == 1
    _, err = capfd.readouterr()
    assert "ValueError" in err
    assert not set("\x1b\x9b\r") & set(err)
