"""`madrob publish` while others publish, and of runs that something is wrong with."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

import madrob_console.publishing.publish
import madrob_console.publishing.site_tables
from madrob_console.archive.folders import RESULT_FILE
from madrob_console.publishing.publish import site_files
from madrob_console.publishing.site_content import SiteContent
from tests.madrob_console.publishing.competition_runs import RUNS, publish, publish_code


def change(results: Path, number: int, **fields: object) -> None:
    """Other words in the result of one of the runs."""
    path = results / RUNS[number].folder / RESULT_FILE
    path.write_text(json.dumps({**json.loads(path.read_text()), **fields}))


def page_of(results: Path, number: int, name: str = "index.html") -> Path:
    """Of one of the runs."""
    (found,) = (results.parent / "site/runs").glob(f"{RUNS[number].folder}_*")
    return found / name


def test_a_slow_publisher_writes_no_older_pages_over_newer_ones(
    results: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    codes = []

    def slow(content: SiteContent) -> object:
        monkeypatch.undo()
        change(results, 0, voided={"reason": "unsafe"})  # after this one has read the runs
        codes.append(publish_code(results))
        return site_files(content)

    monkeypatch.setattr(madrob_console.publishing.publish, "site_files", slow)
    publish(results)
    assert codes == [os.EX_TEMPFAIL]  # the engine tries it again
    assert "another `madrob publish` writes there now" in capsys.readouterr().err
    publish(results)
    assert "VOID" in page_of(results, 0).read_text()
