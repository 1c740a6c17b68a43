"""TAB in real shells."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from madrob_console.cli.main import main
from tests.terminal import Terminal

pytestmark = pytest.mark.machine


PROMPT = "ready>"
FISH = f"function fish_prompt; echo -n '{PROMPT}'; end; set fish_greeting; source SCRIPT"
SHELLS = {
    "bash": (["bash", "--norc", "--noprofile", "-i"], f"source SCRIPT; PS1='{PROMPT}'"),
    "zsh": (
        ["zsh", "-f", "-i"],
        f"fpath=(FOLDER $fpath); autoload -Uz compinit; compinit -u -D; PS1='{PROMPT}'",
    ),
    "fish": (["fish", "--no-config", "-i", "-C", FISH], ""),
}


@pytest.fixture(
    params=[
        "bash",
        *(pytest.param(name, marks=pytest.mark.needs(name)) for name in ("zsh", "fish")),
    ]
)
def shell(
    request: pytest.FixtureRequest, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> Iterator[Terminal]:
    name: str = request.param
    assert main(["completion", name]) == 0
    script = tmp_path / "functions" / "_madrob"
    script.parent.mkdir()
    script.write_text(capsys.readouterr().out)
    (tmp_path / "my_run").mkdir()
    (tmp_path / "my_run" / "some.mcap").write_text("")
    words, begin = (
        [
            part.replace("SCRIPT", str(script)).replace("FOLDER", str(script.parent))
            for part in parts
        ]
        if isinstance(parts, list)
        else parts.replace("SCRIPT", str(script)).replace("FOLDER", str(script.parent))
        for parts in SHELLS[name]
    )
    environment = {"HOME": str(tmp_path), "XDG_CONFIG_HOME": str(tmp_path / "config")}
    environment["PATH"] = f"{tmp_path}:{os.environ['PATH']}"
    with Terminal(list(words), columns=100, env=environment, cwd=tmp_path) as terminal:
        if begin:
            terminal.send(f"{begin}\n")
        terminal.wait_for(PROMPT)
        yield terminal


@pytest.mark.parametrize(
    ("typed", "completed"),
    [
        ("madrob conso", "madrob console"),
        ("madrob calibrate ma", "madrob calibrate masks"),
        ("madrob run --bench", "madrob run --benchmark-type"),
        ("madrob console --theme hi", "madrob console --theme high-contrast"),
        ("madrob engine sta", "madrob engine status"),
        ("madrob console --testbed sim", "madrob console --testbed simulated"),
        ("madrob console --testbed replay my_", "madrob console --testbed replay my_run/"),
        ("madrob score my_", "madrob score my_run/"),
        ("madrob score --write my_", "madrob score --write my_run/"),
        ("madrob engine stop --fo", "madrob engine stop --force"),
        ("madrob standings --results my_", "madrob standings --results my_run/"),
    ],
)
def test_tab_completes(shell: Terminal, typed: str, completed: str) -> None:
    shell.send(f"{typed}\t")
    shell.wait_for(f"{PROMPT}{completed}")


def test_tab_starts_no_program(shell: Terminal, tmp_path: Path) -> None:
    called = tmp_path / "called"
    madrob = tmp_path / "madrob"
    madrob.write_text(f"#!/bin/sh\ntouch {called}\n")
    madrob.chmod(0o755)
    shell.send(f"{madrob} x\n")
    while not called.exists():  # it would be seen
        time.sleep(0.01)
    called.unlink()
    shell.send("madrob stand\t")
    shell.wait_for("madrob standings")
    shell.send("--be\t")
    shell.wait_for("--best")
    assert not called.exists()


@pytest.mark.parametrize(
    ("name", "first"), [("bash", "# "), ("zsh", "#compdef madrob"), ("fish", "# ")]
)
def test_the_script_sends_nobody_to_another_place_than_the_help_does(
    name: str, first: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["completion", name]) == 0
    script = capsys.readouterr().out
    assert script.startswith(first)
    assert "madrob completion --help" in script.partition("\n\n")[0]
    assert ".local/share" not in script
    assert ".bashrc" not in script


PROGRAM = [sys.executable, "-m", "madrob_console.cli"]


@pytest.mark.parametrize(("command", "lines"), [("console", "run"), ("watch", "watch --plain")])
def test_screens_are_not_painted_into_a_pipe(command: str, lines: str, tmp_path: Path) -> None:
    ran = subprocess.run(
        [*PROGRAM, command, "--results", str(tmp_path)], stdin=subprocess.DEVNULL,
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert (ran.returncode, ran.stdout) == (2, "")
    assert ran.stderr.startswith(f"madrob: no terminal: `madrob {lines}` prints plain lines")
    assert ran.stderr.count("\n") == 1


def test_what_nothing_is_painted_of_yet_is_imported_after_the_first_paint(tmp_path: Path) -> None:
    code = (
        "import sys, madrob_console.ui.terminal as terminal\n"
        "late = {'madrob_console.engine.snapshot', 'madrob_console.archive.run_journal'}\n"
        "terminal.check_terminal = lambda *_: None\n"
        "terminal.run_console = lambda *_, **__: print(late & set(sys.modules)) or 0\n"
        "from madrob_console.cli.main import main\n"
        "main(['console', '--testbed', 'simulated', '--results', sys.argv[1]])\n"
    )
    ran = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path)], env=os.environ | {"HOME": str(tmp_path)},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert ran.stdout == "set()\n"
