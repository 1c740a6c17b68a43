"""The command line, typed in the process of the test."""

from __future__ import annotations

import io
import json
import shlex
from typing import Any, NamedTuple

import pytest

from madrob_console.cli.main import main


class Said(NamedTuple):
    """What came of a command line."""

    code: int
    out: str
    err: str


class Madrob:
    """Types command lines: words, then what may hold spaces, such as paths."""

    def __init__(self, captured: pytest.CaptureFixture[str]) -> None:
        self._captured = captured

    def say(self, line: str, *more: object) -> Said:
        self._captured.readouterr()
        try:
            code = main([*shlex.split(line), *map(str, more)])
        except SystemExit as end:  # argparse
            code = int(end.code or 0)
        return Said(code, *self._captured.readouterr())

    def __call__(self, line: str, *more: object, code: int = 0) -> str:
        """What it prints; it ends with this exit code."""
        said = self.say(line, *more)
        assert said.code == code, said.err
        return said.out

    def document(self, line: str, *more: object, code: int = 0) -> Any:  # noqa: ANN401  JSON
        return json.loads(self(f"{line} --json", *more, code=code))

    def complaint(self, line: str, *more: object) -> str:
        """The one line on the error output of a command that is done as far as it goes."""
        said = self.say(line, *more)
        assert (said.code, said.err.count("\n")) == (2, 1), said.err
        return said.err

    def refusal(self, line: str, *more: object) -> str:
        """The one line of a command that does nothing."""
        said = self.say(line, *more)
        assert (said.code, said.out, said.err.count("\n")) == (2, "", 1), said.err
        return said.err


class Screen(io.TextIOWrapper):
    """The output of a terminal."""

    def __init__(self, encoding: str) -> None:
        self.shown = io.BytesIO()
        super().__init__(self.shown, encoding=encoding)

    def isatty(self) -> bool:
        return True
