"""The parser of the command line: one line for what is wrong with it, help to work from."""

from __future__ import annotations

import argparse
import math
import re
import textwrap
from collections.abc import Callable, Iterable, Sequence
from enum import StrEnum
from pathlib import Path
from typing import Any, NoReturn, TypeVar, get_args, get_type_hints

from madrob_console.cli.output import BAD_INPUT

_Words = TypeVar("_Words", bound=StrEnum)
_Number = TypeVar("_Number", int, float)

_NEGATIVE = re.compile(r"-[\d.]")
"""How a value may begin that is no option: `-1.5,0,0` is a pose."""


class CommandHelp(argparse.HelpFormatter):
    """In a description, lines that begin with blanks stay as they are; the rest is wrapped."""

    def add_argument(self, action: argparse.Action) -> None:
        """Leave room for the names of commands, which stand further to the right."""
        super().add_argument(action)
        if isinstance(action, argparse._SubParsersAction):
            self._action_max_length += self._indent_increment

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        return "\n".join(
            line if line.startswith(" ") else textwrap.fill(line, width, initial_indent=indent)
            for line in text.splitlines()
        )


class Parser(argparse.ArgumentParser):
    """Reports an error of the command line in one line."""

    def __init__(self, **how: Any) -> None:  # noqa: ANN401  argparse's own, of the subparsers
        super().__init__(**({"formatter_class": CommandHelp} | how))
        self.set_defaults(parser=self)
        self._negative_number_matcher = _NEGATIVE

    def error(self, message: str) -> NoReturn:
        words = message.removeprefix("argument ")
        self.exit(BAD_INPUT, f"{self.prog}: {words}; see `{self.prog} --help`\n")

    def _check_value(self, action: argparse.Action, value: object) -> None:
        if action.choices is not None and value not in action.choices:
            raise argparse.ArgumentError(action, none_of(str(value), map(str, action.choices)))


def none_of(text: str, choices: Iterable[str]) -> str:
    return f"there is no '{text}', use {_either(list(choices))}"


def _either(words: Sequence[str]) -> str:
    return " or ".join(filter(None, (", ".join(words[:-1]), words[-1])))


def one_of(words: type[_Words]) -> Callable[[str], _Words]:
    def convert(text: str) -> _Words:
        try:
            return words(text)
        except ValueError:
            raise argparse.ArgumentTypeError(none_of(text, words)) from None

    return convert


def as_path(text: str) -> Path:
    """Argument type: a path, `~` too where no shell has seen to it; an empty one is refused."""
    if not text:
        raise argparse.ArgumentTypeError("is empty: name a path")
    try:
        return Path(text).expanduser()
    except RuntimeError:
        raise argparse.ArgumentTypeError(f"'{text}': there is no such user") from None


def whole_number(text: str) -> int:
    return _typed(int, text, "whole number")


def whole_within(low: int, high: float = math.inf) -> Callable[[str], int]:
    def convert(text: str) -> int:
        return _demand(whole_number(text), low, high)

    return convert


def number(text: str) -> float:
    """Argument type: a finite number."""
    if not math.isfinite(typed := _typed(float, text, "number")):
        raise argparse.ArgumentTypeError(f"'{text}' is no number")
    return typed


def number_within(low: float, high: float = math.inf) -> Callable[[str], float]:
    def convert(text: str) -> float:
        return _demand(_typed(float, text, "number"), low, high)

    return convert


def as_setting(table: str, key: str) -> Callable[[str], float]:
    def convert(text: str) -> float:
        from madrob_console.config import Settings

        kind = type(getattr(Settings(), table))
        _, meta = get_args(get_type_hints(kind, include_extras=True)[key])
        return _demand(number(text), meta.ge, meta.le)

    return convert


def _typed(kind: Callable[[str], _Number], text: str, what: str) -> _Number:
    try:
        return kind(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"'{text}' is no {what}") from None


def _demand(typed: _Number, low: float, high: float) -> _Number:
    """Refuse a number outside [low, high], and NaN."""
    if low <= typed <= high:
        return typed
    most = "or more" if high == math.inf else f"to {high:g}"
    raise argparse.ArgumentTypeError(f"{typed:g}: use {low:g} {most}")
