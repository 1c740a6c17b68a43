"""`madrob publish` while others publish, and of runs that something is wrong with."""

from __future__ import annotations

import errno
import json
import os
import re
from pathlib import Path

import pytest

import madrob_console.publishing.publish
import madrob_console.publishing.site_tables
from madrob_console.archive.folders import REPORT_FILE, RESULT_FILE
from madrob_console.archive.run_paths import RunPath
from madrob_console.archive.stored_runs import stored_run
from madrob_console.cli.main import main
from madrob_console.cli.problems import BAD_INPUT
from madrob_console.errors import MadrobError
from madrob_console.files.bounded import read_all
from madrob_console.publishing.publish import site_files
from madrob_console.publishing.site_content import SiteContent, alike_among
from scoring.protocol import Outcome
from scoring.result import Uncertainty
from tests.madrob_console.publishing.competition_runs import (
    RUNS,
    TIME,
    of,
    publish,
    publish_code,
    put_recorded,
)
from tests.madrob_console.run_folders import VALUES, write


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


@pytest.mark.parametrize("number", [errno.EIO, errno.ENOENT])
def test_what_cannot_be_read_or_is_gone_meanwhile_keeps_nothing_else_from_being_written(
    results: Path,
    number: int,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    bad = results / RUNS[0].folder / RESULT_FILE

    def read(path: Path, limit: int) -> bytes:
        if path == bad:
            raise OSError(number, os.strerror(number))
        return read_all(path, limit)

    with monkeypatch.context() as patched:
        patched.setattr(madrob_console.publishing.publish, "read_all", read)
        assert publish_code(results) == BAD_INPUT
    told = capsys.readouterr().err
    assert f"{bad}: cannot be read ({os.strerror(number)}); `madrob " in told
    assert len([line for line in told.splitlines() if "madrob: note: " not in line]) == 1
    site = results.parent / "site"
    assert (site / "index.html").exists()
    assert page_of(results, 1, RESULT_FILE).exists()
    assert not page_of(results, 0, RESULT_FILE).exists()
    publish(results)
    assert page_of(results, 0, RESULT_FILE).exists()


@pytest.mark.parametrize("run_id", ["abcdefg\u00e9", "../../..", "0190\u0661\u0662\u0663\u0664"])
def test_whatever_a_run_says_it_is_its_page_is_found_again(results: Path, run_id: str) -> None:
    change(results, 0, run_id=run_id)
    publish(results)
    publish(results)
    place = page_of(results, 0).relative_to(results.parent / "site").as_posix()
    assert re.fullmatch(r"runs/[a-z0-9_]+/index\.html", place)


def test_a_run_that_could_not_be_read_once_is_in_the_tables_the_next_time(
    results: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def read(run: RunPath) -> object:
        if RUNS[0].folder in str(run.path):
            raise MadrobError("too many open files")
        return stored_run(run)

    def rows() -> int:
        return len((results.parent / "site/data/runs.csv").read_text().splitlines()) - 1

    with monkeypatch.context() as patched:
        patched.setattr(madrob_console.publishing.site_tables, "stored_run", read)
        publish(results)
        assert rows() == len(RUNS) - 2  # without practice and this one
    publish(results)
    assert rows() == len(RUNS) - 1


def test_reports_follow_the_teams_name_and_lead_to_no_plan_that_is_gone(results: Path) -> None:
    first, _ = put_recorded(results)
    teams, site = results.parent / "teams.csv", results.parent / "site"

    def report() -> str:
        publish(results, "--practice", "--teams", teams)
        (page,) = site.glob(f"runs/{first.name}_*/{REPORT_FILE}")
        return page.read_text()

    teams.write_text("subject,team\n3,Old Name\n")
    text = report()
    assert "Old Name" in text
    assert "plan.html" in text
    teams.write_text("subject,team\n3,New Name\n")
    (results.parent / "plan.csv").write_text("")
    text = report()
    assert "New Name" in text
    assert "Old Name" not in text
    assert "plan.html" not in text


def test_a_failed_run_is_like_no_other() -> None:
    wide = dict.fromkeys(VALUES, Uncertainty(5.0, 10.0))
    one, near = (of(n, own={TIME: 59.9}, uncertainties=wide) for n in (1, 2))
    failed = of(3, outcome=Outcome.TIMEOUT, own={TIME: 60.0}, uncertainties=wide)
    assert failed.folder not in alike_among([one, near, failed])
    assert alike_among([one, near])[one.folder] == set(VALUES)
    assert alike_among([one, failed]) == {}


def test_halls_whose_folders_are_no_text_are_published(results: Path) -> None:
    hall = results.rename(results.parent / os.fsdecode(b"hall \xff"))
    site = results.parent / "site"
    assert main(["publish", str(site), str(hall / RUNS[0].folder), str(hall / RUNS[3].folder)]) == 0
    assert len(list((site / "runs").iterdir())) == 2


def test_practice_alone_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write(tmp_path / "results", of(4, source="simulated"))
    publish(tmp_path / "results")
    assert "no official run, 1 of practice: --practice shows them" in capsys.readouterr().err
