"""What the command line says of itself, and of what cannot be used."""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from madrob_console.cli.guide_command import PAGES
from madrob_console.cli.main import COMMANDS, build_parser, main
from madrob_console.cli.parsing import as_path
from tests.madrob_console.cli.typed import Madrob, Screen

ALL = (*COMMANDS, "calibrate masks", "calibrate handle", "table samples")


def examples(text: str) -> Iterator[str]:
    for line in text.splitlines():
        if line.startswith("  madrob "):
            yield line.partition("#")[0].partition(">")[0].strip()


@pytest.mark.parametrize("command", ALL)
def test_a_help_has_an_example_that_works_and_no_empty_default(
    command: str, madrob: Madrob
) -> None:
    text = madrob(f"{command} --help")
    assert text.startswith("usage: madrob")
    for empty in ("None", "default: )", "default: False"):
        assert empty not in text
    lines = list(examples(text))
    assert lines
    for line in lines:
        if not line.endswith(("--help", "--columns")):  # these end the program
            build_parser().parse_args(shlex.split(line)[1:])


@pytest.mark.parametrize(
    ("command", "words"), [("run", "nominal, slam, slow"), ("run", "No Force, Constant Force")]
)
def test_a_help_says_the_choices(
    command: str, words: str, madrob: Madrob, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "300")
    assert words in madrob(f"{command} --help")


NEGATIVE = {"--seed", "--start-pose"}
"""Of these a negative number makes sense."""

ENDLESS = {"--idle-time", "--wait"}
"""Of these `inf` does: they have no end."""


def parsers(parser: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    yield parser
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for part in action.choices.values():
                yield from parsers(part)


def taken(action: argparse.Action, text: str) -> bool:
    assert callable(action.type)
    try:
        return action.type(text) is not None
    except (argparse.ArgumentTypeError, ValueError):
        return False


def numbers() -> Iterator[tuple[str, argparse.Action, str]]:
    """All options that take a number, and a text that each of them takes."""
    for parser in parsers(build_parser()):
        for action in parser._actions:
            texts = ("3", "30", "3,0,0", "3/4")
            if callable(action.type) and action.type is not as_path:
                yield from [(parser.prog, action, t) for t in texts if taken(action, t)][:1]


def test_no_option_takes_a_number_that_makes_no_sense() -> None:
    found = list(numbers())
    options = {name for _, action, _ in found for name in action.option_strings}
    assert {"--wait", "--timeout", "--jobs", "--best"} <= options
    for command, action, text in found:
        (name,) = action.option_strings[:1]
        wrong = {text.replace("3", "nan")}
        wrong |= set() if name in NEGATIVE else {f"-{text}", "-1e9", "-inf"}
        wrong |= set() if name in ENDLESS else {text.replace("3", "inf"), "1e999"}
        assert not [one for one in wrong if taken(action, one)], (command, name)


@pytest.mark.parametrize(
    ("line", "first"), [("", "usage: madrob "), ("calibrate", "usage: madrob c")]
)
def test_without_a_command_the_help_is_printed_and_the_exit_code_is_git_s(
    line: str, first: str, madrob: Madrob
) -> None:
    said = madrob.say(line)
    assert (said.code, said.err, said.out) == (1, "", madrob(f"{line} --help"))
    assert said.out.startswith(first)


GUIDE = Path(__file__).parents[3] / "madrob_console" / "guide"


def on_screen(monkeypatch: pytest.MonkeyPatch, page: str, encoding: str) -> str:
    monkeypatch.setattr(sys, "stdout", screen := Screen(encoding))
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("TERM", "xterm-256color")
    assert main(["guide", page]) == 0
    return screen.shown.getvalue().decode(encoding)


def test_the_guide_lists_its_pages(madrob: Madrob) -> None:
    lines = madrob("guide").splitlines()
    assert [line.split()[:3] for line in lines] == [["madrob", "guide", page] for page in PAGES]
    assert all(len(line) <= 80 for line in lines)
    assert sorted(PAGES) == sorted(path.stem for path in GUIDE.iterdir())


@pytest.mark.parametrize("page", PAGES)
def test_a_file_gets_a_page_as_it_is_and_a_terminal_one_with_layout(
    page: str, monkeypatch: pytest.MonkeyPatch, madrob: Madrob
) -> None:
    text = (GUIDE / f"{page}.md").read_text()
    assert madrob("guide", page) == text
    monkeypatch.setenv("NO_COLOR", "1")
    shown = on_screen(monkeypatch, page, "utf-8")
    marks = ("| --- |", "```", "## ", "`", "\N{HORIZONTAL ELLIPSIS}")
    assert (marks[0] in text, [mark for mark in marks if mark in shown]) == (True, [])
    assert "\N{BOX DRAWINGS LIGHT HORIZONTAL}" in shown
    assert "\x1b[1m" in shown  # as the terminal obeys it


def test_a_terminal_that_cannot_draw_gets_the_text(monkeypatch: pytest.MonkeyPatch) -> None:
    shown = on_screen(monkeypatch, "referee", "iso-8859-1")
    assert shown == (GUIDE / "referee.md").read_text()
