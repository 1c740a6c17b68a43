"""`madrob completion`: what a shell needs to complete `madrob` with TAB."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator
from enum import StrEnum
from itertools import dropwhile
from typing import TypeAlias

from madrob_console.cli.command_line import Option, command
from madrob_console.cli.parsing import as_path, one_of
from madrob_console.common.names import SourceKind
from scoring.rulesets import RulesetName


class Shell(StrEnum):
    """A shell that can complete."""

    BASH = "bash"
    ZSH = "zsh"
    FISH = "fish"


Completer: TypeAlias = "dict[str, str | dict[str, str]]"
"""shtab's completion of an option, by shell."""


def _first_word(name: str, words: Iterable[str], then: str, *, folders: bool = False) -> Completer:
    """Completion of an option whose first word is one of `words`; zsh then completes `then`.

    bash completes one kind of word only: with `folders` it completes folders there, too.
    """
    listed = " ".join(words)
    lines = [f'  compgen -W "{listed}" -- "$1"']
    if folders:
        lines.append('  compgen -d -- "$1"')
    return {
        "bash": f"_madrob_{name}",
        "zsh": f"_madrob_{name}:{then}",
        "fish": listed,
        "preamble": {
            "bash": "\n".join([f"_madrob_{name}() {{", *lines, "}\n"]),
            "zsh": f"_madrob_{name}() {{\n  compadd {listed}\n}}\n",
        },
    }


_SEVERAL_WORDS: dict[str, tuple[str, Completer]] = {
    "testbed": ("TESTBED", _first_word("testbed", SourceKind, ":bag:_files")),
    "write": ("RULESET", _first_word("write", RulesetName, "folder:_files -/", folders=True)),
}
"""Metavar and completion of each option with several words, by its argument name."""

_REPLAY = {
    Shell.BASH: "complete -o bashdefault -o default -F _shtab_madrob madrob",
    Shell.ZSH: "",  # it knows of a second word
    Shell.FISH: "complete -c madrob -n 'test (commandline -opc)[-1] = replay' -F",
}
"""Completion after `--testbed replay`: the path of a bag."""


@command(
    "completion",
    "what bash, zsh or fish needs to complete `madrob` with TAB",
    "It goes where the shell looks for it; zsh must have that folder in its `fpath`. Print it anew "
    "after an update.",
    options=(
        Option(
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
        if action.dest in _SEVERAL_WORDS:
            action.metavar, action.complete = _SEVERAL_WORDS[action.dest]  # type: ignore[attr-defined]
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
