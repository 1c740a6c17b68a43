"""What the command line says of itself, and of what cannot be used."""

from __future__ import annotations

import shlex
from collections.abc import Iterator

import pytest

from madrob_console.cli.main import COMMANDS, build_parser, main

ALL = (*COMMANDS, "calibrate masks", "calibrate handle", "table samples")


def said(capsys: pytest.CaptureFixture[str], line: str) -> tuple[int, str, str]:
    try:
        code = main(shlex.split(line))
    except SystemExit as end:
        code = int(end.code or 0)
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def examples(text: str) -> Iterator[str]:
    for line in text.splitlines():
        if line.startswith("  madrob "):
            yield line.partition("#")[0].partition(">")[0].strip()


@pytest.mark.parametrize("command", ALL)
def test_a_help_has_an_example_that_works_and_no_empty_default(
    command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    code, text, _ = said(capsys, f"{command} --help")
    assert code == 0
    for empty in ("None", "default: )", "default: False"):
        assert empty not in text
    lines = list(examples(text))
    assert lines
    for line in lines:
        if not line.endswith("--help"):
            build_parser().parse_args(shlex.split(line)[1:])


@pytest.mark.parametrize(
    ("command", "default"),
    [
        ("run", "setting `run.timeout`, 300 by default"),
        ("run", "setting `results.folder`, ~/madrob_runs by default"),
        ("run", "s to wait for the pre-start checks (default: 20)"),
        ("console", "setting `engine.idle_time`, 600 by default"),
        ("console", "setting `console.theme`, dark by default"),
        ("run", "nominal, jerky, slam"),
        ("run", "No Force, Constant Force"),
        ("testbed", "(default: 0)"),
        ("standings", "setting `competition.best_runs`, 0 by default"),
    ],
)
def test_a_help_says_the_real_defaults_and_the_choices(
    command: str,
    default: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("COLUMNS", "300")
    _, text, _ = said(capsys, f"{command} --help")
    assert default in text


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("consol", "madrob: COMMAND: there is no 'consol', did you mean console?"),
        ("calibrate mask", "there is no 'mask', did you mean masks?"),
        ("engine stat", "did you mean status?"),
        ("console --theme blue", "--theme: there is no 'blue', use dark, light or high-contrast"),
        ("run --opening-side left", "--opening-side: there is no 'left', use cw or ccw"),
        ("run --scenario nominall", "--scenario: there is no 'nominall', did you mean nominal?"),
        ("run --subject Delft", "--subject: 'Delft' is no whole number"),
        ("run --timeout long", "--timeout: 'long' is no number"),
        ("standings --bets 3", "madrob standings: --bets: no such option, did you mean --best?"),
        ("export --subject 3 --bag", "madrob export: --bag: no such option"),
        ("schema all", "madrob schema: all: nothing more is expected here"),
        ("console --testbed sim", "--testbed: there is no 'sim', did you mean simulated?"),
        ("console --testbed ros 3", "--testbed: ros takes nothing more, not '3'"),
        ("watch --testbed replay", "--testbed: replay needs the path of one bag"),
        ("run --speed -1", "--speed: -1: use 0 to 1000"),
        ("run --speed nan", "--speed: nan: use 0 to 1000"),
        ("run --team Delft", "--team: 'Delft' is no whole number"),
        ("recover", "the following arguments are required: PATH"),
    ],
)
def test_a_wrong_word_is_named_with_what_was_meant(
    line: str, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, error = said(capsys, line)
    assert (code, out) == (2, "")
    assert words in error
    assert error.count("\n") == 1
    assert error.endswith("--help`\n")


@pytest.mark.parametrize(
    ("line", "first"), [("", "usage: madrob "), ("calibrate", "usage: madrob c")]
)
def test_without_a_command_the_help_is_printed_and_the_exit_code_is_git_s(
    line: str, first: str, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, error = said(capsys, line)
    assert (code, error) == (1, "")
    assert out.startswith(first)
    assert said(capsys, f"{line} --help")[1] == out
