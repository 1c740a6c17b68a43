"""One word for one thing in what people read; the guide's table of words says which."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from madrob_console.ui.keys.key_table import CALLED

ROOT = Path(__file__).parents[2]
SAID = sorted((ROOT / "madrob_console").rglob("*.py"))
"""Whose texts people may read, on screens, pages and the command line."""
GUIDE = ROOT / "madrob_console" / "guide"
PAPERS = [
    ROOT / "README.md",
    ROOT / "madrob_console" / "CHANGELOG.md",
    ROOT / "scoring" / "PROTOCOL.md",
    *sorted(GUIDE.glob("*.md")),
]

FOR_PROGRAMS = {
    *(("standings_files.py", "provisional"), ("check.py", "recomputed"), ("collection.py", "sub")),
    *(("key_table.py", words) for words in CALLED.values()),
}
"""Keys of files, and what a filter and the palette understand beside the right word."""

WRONG = {
    r"\bredo\b": "re-issue",
    r"\bre-?open\w*|\bopen(ed|s)? (it|a final result|the result) again": "re-issue",
    r"\bprovisional\b": "not final",
    r"\bunsigned\b|\bsigned off\b": "not final, final",
    r"\bsub\b": "subject",
    r"\bundo(ne)?\b|\brevok\w*|\brescind\w*": "take back",
    r"\bannul\w*|\binvalidat\w*": "void",
    r"\bamend\w*|\bedit the\b": "correct",
    r"\bdisqualif\w*|\bpenalt\w*": "void, incident",
    r"\brecalculat\w*|\bre-?scor\w*|\brecomput\w*|\bcomputed again": "scored again",
    r"\btraining\b|\bunofficial\w*": "practice",
    r"\bcrash mark|\bevent mark": "incident",
    r"\bobserver\w*|\bviewer\w*": "spectator",
    r"\bappeal\w*": "protest",
}
"""What is not said, and what is."""
IN_THE_TABLE = {"correct": "correction", "scored again": "score"}
"""The guide's words of which others are made."""


@cache
def texts_of(path: Path) -> tuple[tuple[int, str], ...]:
    source = path.read_text(encoding="utf-8")
    prose = re.sub("`[^`\\n]*`", "", source)  # what is in backticks is for programs
    lines = texts(source) if path.suffix == ".py" else enumerate(prose.splitlines(), 1)
    return tuple((line, text) for line, text in lines if (path.name, text) not in FOR_PROGRAMS)


def texts(source: str) -> Iterator[tuple[int, str]]:
    """The string constants of a module that are no docstrings, with their lines."""
    tree = ast.parse(source)
    told = {
        id(node.value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    }
    for node in ast.walk(tree):
        match node:
            case ast.Constant(value=str(text)) if id(node) not in told:
                yield node.lineno, text


@pytest.mark.parametrize("wrong", WRONG)
def test_one_word_for_one_thing(wrong: str) -> None:
    assert len(SAID) > 100
    assert len(PAPERS) > 8
    places = [
        f"{path.relative_to(ROOT)}:{line}: {text!r}; say: {WRONG[wrong]}"
        for path in [*SAID, *PAPERS]
        for line, text in texts_of(path)
        if re.search(wrong, text, re.IGNORECASE)
    ]
    assert places == []


def test_the_words_to_say_are_those_of_the_guide() -> None:
    _, table = (GUIDE / "referee.md").read_text(encoding="utf-8").split("## Words\n")
    terms = {
        term
        for row in table.splitlines()
        if row.startswith("| ")
        for term in row.split("|")[1].strip().split(", ")
    }
    said = {word for words in WRONG.values() for word in words.split(", ")}
    assert {IN_THE_TABLE.get(word, word) for word in said} <= terms
