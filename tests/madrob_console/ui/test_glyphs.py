from __future__ import annotations

import ast
import asyncio
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.cells import cell_len

import madrob_console.ui
from madrob_console.config.tables import ConsoleSettings
from madrob_console.names import terminal_safe
from madrob_console.ui.look.glyphs import LIKENESS, to_ascii, uses_ascii
from tests.madrob_console.ui.driver import DEFAULTS, driving
from tests.madrob_console.ui.fake_engine import FakeEngine

UI = Path(next(iter(madrob_console.ui.__path__)))
TEXTS = st.text() | st.text(alphabet="ab é門❤👩🏽🏴🇩🇪₂█─\u200d\ufe0f\u0301\U000e0067")


@pytest.mark.parametrize(
    ("environ", "ascii_only"),
    [
        ({}, False),
        ({"TERM": "xterm-256color", "LANG": "de_DE.UTF-8"}, False),
        ({"TERM": "linux", "LANG": "en_US.utf8"}, False),
        ({"LC_CTYPE": "UTF-8"}, False),
        ({"LC_ALL": "C.UTF-8", "LANG": "C"}, False),
        ({"LC_ALL": "", "LANG": ""}, False),
        ({"LANG": "C"}, True),
        ({"LANG": "POSIX"}, True),
        ({"LANG": "en_US"}, True),
        ({"LANG": "de_DE@euro"}, True),
        ({"LC_CTYPE": "en_US.ISO-8859-1", "LANG": "en_US.UTF-8"}, True),
        ({"LC_ALL": "C", "LC_CTYPE": "C.UTF-8", "LANG": "C.UTF-8"}, True),
        ({"TERM": "vt100", "LANG": "C.UTF-8"}, True),
        ({"TERM": "vt102"}, True),
        ({"TERM": "vt220"}, True),
    ],
)
def test_terminal_and_locale_decide_unless_told(environ: dict[str, str], ascii_only: bool) -> None:
    assert uses_ascii(environ) is ascii_only
    assert uses_ascii(environ, wanted=True) is True
    assert uses_ascii(environ, wanted=False) is False


def test_every_likeness_takes_the_one_cell_of_its_sign() -> None:
    for code, likeness in LIKENESS.items():
        assert cell_len(chr(code)) == 1
        assert len(likeness) == 1
        assert likeness.isascii()
        assert likeness.isprintable()


def test_every_sign_that_the_screens_draw_has_a_likeness() -> None:
    drawn = {char for path in UI.rglob("*.py") for text in literals(path) for char in text}
    assert {char for char in drawn if not char.isascii()} <= {*map(chr, LIKENESS)}


def literals(path: Path) -> Iterator[str]:
    """The texts in a module."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value


@pytest.mark.parametrize(
    ("text", "drawn"),
    [
        ("✓ done, 3 ±0.5 …", "v done, 3 +0.5 ~"),
        ("╭─┬─╮│═║┼\u2571\u2572\u2573", "+-+-+|=|+/\\X"),
        ("⠀⠃⡠⣿▁█↑→↓←", " '.:_#^>v<"),
        ("Zürich Åse e\u0301 Łódź", "Zurich Ase e ?odz"),
        ("門 Bots", "?? Bots"),
        ("🤖👩\u200d👩\u200d👧x", "????x"),
        ("½", "?"),
    ],
)
def test_signs_become_their_likeness_and_letters_lose_accents(text: str, drawn: str) -> None:
    assert to_ascii(text) == drawn


@given(TEXTS.map(terminal_safe))
def test_any_text_becomes_ascii_in_as_many_cells(text: str) -> None:
    drawn = to_ascii(text)
    assert drawn.isascii()
    assert len(drawn) == cell_len(text)


@given(TEXTS.filter(str.isascii))
def test_ascii_stays_as_it_is(text: str) -> None:
    assert to_ascii(text) == text


@pytest.mark.slow
def test_on_no_screen_is_anything_but_ascii(engine: FakeEngine) -> None:
    names = replace(DEFAULTS, team="Zürich 門", competition="Coupe d'été", referee="Åse")

    async def drive() -> None:
        async with driving(engine, defaults=names, look=ConsoleSettings(ascii=True)) as console:
            await console.press("f2", "enter", "tab")
            screens = [console.text]
            assert "Zurich ??" in console.text
            assert " v topics" in console.text
            await console.run()
            await console.press("f3", "f8")
            screens.append(console.text)
            assert "+-------" in console.text
            assert "|_|" in console.text
            await console.press("escape")
            engine.finish()
            await console.settle()
            for pane in ("f4", "f1", "h", "s", "g", "ctrl+p"):
                await console.press(pane)
                screens.append(console.text)
            for screen in screens:
                assert screen.isascii(), screen

    asyncio.run(drive())
