"""`madrob completion`: what a shell needs to complete `madrob` with TAB."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from enum import StrEnum
from itertools import dropwhile

from madrob_console.cli.command_line import Argument, command
from madrob_console.cli.parsing import as_path, one_of
from madrob_console.common.names import SourceKind


class Shell(StrEnum):
    """A shell that can complete."""

    BASH = "bash"
    ZSH = "zsh"
    FISH = "fish"


_KINDS = " ".join(SourceKind)
_TESTBED = {
    "bash": "_madrob_testbed",
    "zsh": "_madrob_testbed::bag:_files",
    "fish": _KINDS,
    "preamble": {
        "bash": f'_madrob_testbed() {{\n  compgen -W "{_KINDS}" -- "$1"\n}}\n',
        "zsh": f"_madrob_testbed() {{\n  compadd {_KINDS}\n}}\n",
    },
}
"""shtab's completion of `--testbed`, by shell: its first word is a kind, then comes a bag."""

_REPLAY = {
    Shell.BASH: "complete -o bashdefault -o default -F _shtab_madrob madrob",
    Shell.ZSH: "",  # it knows of a second word
    Shell.FISH: "complete -c madrob -n 'test (commandline -opc)[-1] = replay' -F",
}
"""Completion after `--testbed replay`: the path of a bag."""


@command(
    "completion",
    "let bash, zsh or fish complete `madrob` with TAB",
    "It goes where the shell looks for it; zsh must have that folder in its `fpath`. Print it anew "
    "after an update.",
    options=(
        Argument(
            "shell",
            type=one_of(Shell),
            choices=list(Shell),
            metavar="SHELL",
            help=", ".join(Shell),
        ),
    ),
    examples=(
        "madrob completion bash > ~/.local/share/bash-completion/completions/madrob",
        "madrob completion zsh > ~/.zfunc/_madrob",
        "madrob completion fish > ~/.config/fish/completions/madrob.fish",
    ),
)
def completion(arguments: argparse.Namespace) -> int:
    """Print a shell's script, made from the parser of all commands; TAB starts no program."""
    import shtab

    from madrob_console.cli.main import build_parser

    parser = build_parser()
    for action in _actions(parser):
        if action.dest == "testbed":
            action.metavar = "TESTBED"  # shtab knows of no second word
            action.complete = _TESTBED  # type: ignore[attr-defined]
        elif action.type is as_path:
            kind = shtab.DIRECTORY if action.metavar == "FOLDER" else shtab.FILE
            action.complete = kind  # type: ignore[attr-defined]
    script = shtab.complete(parser, arguments.shell.value).splitlines()
    if script[0].startswith("#compdef"):  # zsh takes only the first line for that
        print(script[0])
    lines = dropwhile(lambda line: not line or line.startswith("#"), script)  # shtab's other places
    print("# Made with shtab; `madrob completion --help` says where it goes.\n")
    print(*lines, sep="\n")
    print(_REPLAY[arguments.shell])
    return 0


def _actions(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for inner in action.choices.values():
                yield from _actions(inner)
        else:
            yield action
