"""The guide in the terminal."""

from __future__ import annotations

import io
import sys
from pathlib import Path

import pytest

from madrob_console.cli.guide_command import PAGES
from madrob_console.cli.main import main

GUIDE = Path(__file__).parents[3] / "madrob_console" / "guide"


class Screen(io.TextIOWrapper):
    """A terminal's output."""

    def __init__(self, encoding: str) -> None:
        self.shown = io.BytesIO()
        super().__init__(self.shown, encoding=encoding)

    def isatty(self) -> bool:
        return True


def on_screen(monkeypatch: pytest.MonkeyPatch, page: str, encoding: str) -> str:
    monkeypatch.setattr(sys, "stdout", screen := Screen(encoding))
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("TERM", "xterm-256color")
    assert main(["guide", page]) == 0
    return screen.shown.getvalue().decode(encoding)


def test_the_guide_lists_its_pages(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["guide"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[:3] for line in lines] == [["madrob", "guide", page] for page in PAGES]
    assert all(len(line) <= 80 for line in lines)
    assert sorted(PAGES) == sorted(path.stem for path in GUIDE.iterdir())


@pytest.mark.parametrize("page", PAGES)
def test_a_file_gets_a_page_as_it_is(page: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["guide", page]) == 0
    assert capsys.readouterr().out == (GUIDE / f"{page}.md").read_text()


@pytest.mark.parametrize("page", PAGES)
def test_a_terminal_shows_a_page_with_layout(page: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NO_COLOR", "1")
    shown = on_screen(monkeypatch, page, "utf-8")
    assert (GUIDE / f"{page}.md").read_text().count("| --- |")
    for mark in ("| --- |", "```", "## ", "`", "\N{HORIZONTAL ELLIPSIS}"):
        assert mark not in shown
    assert "\N{BOX DRAWINGS LIGHT HORIZONTAL}" in shown
    assert "\x1b[1m" in shown  # as the terminal obeys it


def test_a_terminal_that_cannot_draw_gets_the_text(monkeypatch: pytest.MonkeyPatch) -> None:
    shown = on_screen(monkeypatch, "referee", "iso-8859-1")
    assert shown == (GUIDE / "referee.md").read_text()
