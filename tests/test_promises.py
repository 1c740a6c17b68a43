"""Each promise of the papers names the tests that hold it (tests/PROMISES.md)."""

from __future__ import annotations

import ast
import re
from pathlib import Path

HERE = Path(__file__).parent
ROOT = HERE.parent
_ROW = re.compile(r"^\| (?P<promise>.+?) \| (?P<tests>`.+`) \|$")


def _promises() -> list[tuple[str, str, list[str]]]:
    """Paper, promise and names of tests of each row."""
    found: list[tuple[str, str, list[str]]] = []
    paper = ""
    for line in (HERE / "PROMISES.md").read_text().splitlines():
        if line.startswith("## "):
            paper = line.removeprefix("## ")
        elif row := _ROW.match(line):
            found.append((paper, row["promise"], re.findall("`(.+?)`", row["tests"])))
    return found


def _place(name: str) -> Path:
    return next(place for place in (HERE / "madrob_console" / name, HERE / name) if place.is_file())


def _is_there(test: str) -> bool:
    """Whether `file::test` or `file::test[row of its table]` is there."""
    file, _, called = test.partition("::")
    name, _, row = called.removesuffix("]").partition("[")
    content = _place(file).read_text()
    nodes = ast.walk(ast.parse(content))
    found = {n.name for n in nodes if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef)}
    return name in found and row in content


def test_every_promise_is_a_sentence_of_its_paper() -> None:
    texts = {paper: " ".join((ROOT / paper).read_text().split()) for paper, _, _ in _promises()}
    assert [promise for paper, promise, _ in _promises() if promise not in texts[paper]] == []


def test_every_promise_is_held_by_tests_that_are_there() -> None:
    assert [test for _, _, tests in _promises() for test in tests if not _is_there(test)] == []


def test_every_line_of_what_must_stay_true_is_a_promise() -> None:
    paper = "madrob_console/ARCHITECTURE.md"
    section = (ROOT / paper).read_text().split("## What must stay true")[1].split("\n## ")[0]
    lines = [" ".join(line.split()) for line in section.split("\n- ")[1:]]
    promised = [promise for of, promise, _ in _promises() if of == paper]
    assert [line for line in lines if not any(promise in line for promise in promised)] == []
