"""What a command is, said once: words, options, examples. Parser, help and completion follow."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

from madrob_console.cli.parsing import Parser

Main: TypeAlias = Callable[[argparse.Namespace], int]
"""Carries a command out and returns its exit code."""

NO_COMMAND = 1
"""Exit code where only the help was printed, as git's."""


class Argument:
    """An option or argument of one command or of several: what argparse takes for it."""

    def __init__(self, *flags: str, **how: Any) -> None:  # noqa: ANN401  argparse's own
        self._flags, self._how = flags, how

    def add_to(self, parser: argparse._ActionsContainer) -> None:
        parser.add_argument(*self._flags, **self._how)


class OneOf:
    """Options of which at most one is given."""

    def __init__(self, *options: Argument) -> None:
        self._options = options

    def add_to(self, parser: argparse._ActionsContainer) -> None:
        either = parser.add_mutually_exclusive_group()
        for option in self._options:
            option.add_to(either)


class WordsAction(argparse.Action):
    """Makes one value of all words of an option: what its `const` returns for them."""

    def __call__(
        self,
        _parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: str | Sequence[Any] | None,
        _option: str | None = None,
    ) -> None:
        try:
            setattr(namespace, self.dest, self.const(list(values or ())))
        except argparse.ArgumentTypeError as error:
            raise argparse.ArgumentError(self, str(error)) from None


class TellAction(argparse.Action):
    """Prints what its `const` returns and ends the program, as `--help` does."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        print(self.const())
        parser.exit()


def print_help(arguments: argparse.Namespace) -> int:
    arguments.parser.print_help()
    return NO_COMMAND


@dataclass(frozen=True, slots=True)
class MadrobCommand:
    """A command, or a part of one.

    Attributes:
        text: for the list of commands.
        more: added to the command's own help.
        examples: lines to type, with what each does after a `#`.
        parts: commands of its own; alone it prints its help.
    """

    name: str
    text: str
    more: str = ""
    options: Sequence[Argument | OneOf] = ()
    examples: Sequence[str] = ()
    main: Main = print_help
    parts: Sequence[MadrobCommand] = ()

    def add_to(self, commands: argparse._SubParsersAction[Parser]) -> None:
        head = "examples:" if len(self.examples) > 1 else "example:"
        parser = commands.add_parser(
            self.name,
            help=self.text,
            description=f"{self.text[0].upper()}{self.text[1:]}.\n{self.more}".rstrip(),
            epilog="\n  ".join((head, *self.examples)) if self.examples else None,
        )
        parser.set_defaults(main=self.main)
        for option in self.options:
            option.add_to(parser)
        if self.parts:
            parts = parser.add_subparsers(metavar="WHAT")
            for part in self.parts:
                part.add_to(parts)


def command(
    name: str,
    text: str,
    more: str = "",
    *,
    options: Sequence[Argument | OneOf] = (),
    examples: Sequence[str] = (),
) -> Callable[[Main], MadrobCommand]:
    """Make a command of the function that carries it out."""
    return lambda main: MadrobCommand(name, text, more, options, examples, main)
