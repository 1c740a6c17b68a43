"""The short page of a run: what the report says of a failed or re-issued run, it says, too."""

from __future__ import annotations

import html
import json
import re
from pathlib import Path

import pytest

from madrob_console.archive.scored import score_opened
from madrob_console.cli.main import main
from madrob_console.pages.page import report_html
from madrob_console.pages.surroundings import Surroundings
from madrob_console.referee.acts import Finalise, Reissue, Rule, Void
from madrob_console.referee.records import TeamWord
from madrob_console.testbeds.simulated import Scenario
from scoring.protocol import Step
from tests.madrob_console.engine.drive import Drive, make_setup
from tests.madrob_console.recorded_runs import without_digests


@pytest.fixture(scope="module")
def failed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run in which nothing was done, ruled, signed and issued again."""
    drive = Drive(tmp_path_factory.mktemp("site") / "results", Scenario.NO_TOUCH)
    drive.whole_run(make_setup(timeout=1.0))
    drive.act(Rule(Step.TOUCH, confirmed=True, reason="seen <b>by all</b>"))
    drive.act(Finalise(TeamWord.PROTESTED, "R. Eferee", "unfair"))
    drive.act(Reissue("the video shows more"))
    drive.act(Finalise(TeamWord.ACKNOWLEDGED, "R. Eferee"))
    drive.act(Void("the floor was wet"))
    drive.engine.close()
    return drive.folder


def words_of(text: str, section: str) -> list[str]:
    """The cells, entries and paragraphs of a part of a page, without elements."""
    found = re.search(f'<section id="{section}">(.*?)</section>', text, re.DOTALL)
    assert found is not None, section
    cells = re.split("</(?:t[dh]|li|p|h2|small)>", re.sub("\n", " ", found[1]))
    words = (html.unescape(re.sub("<[^>]*>", "", cell)).strip() for cell in cells)
    return [one for one in words if one]


def published(folder: Path) -> str:
    """The page of the run on the site."""
    site = folder.parents[2] / "pages"
    assert main(["publish", str(site), str(folder.parents[1]), "--practice"]) == 0
    (page,) = site.glob("runs/*/index.html")
    return page.read_text()


def report_of(folder: Path) -> str:
    scored = score_opened(folder)
    return report_html(scored, place=Surroundings().place_of(folder, scored))


def test_reasons_and_steps_of_a_failed_run_are_those_of_its_report(failed: Path) -> None:
    page, whole = published(failed), report_of(failed)
    assert words_of(page, "steps") == words_of(whole, "steps")
    told = words_of(page, "indicators")
    reasons = [one for one in told if one.startswith("none: ")]
    assert reasons
    assert reasons == [one for one in words_of(whole, "indicators") if one.startswith("none: ")]
    assert "seen <b>by all</b>" in " ".join(words_of(page, "steps"))


def test_who_issued_a_result_again_why_and_what_it_was_is_told(failed: Path) -> None:
    page, whole = published(failed), report_of(failed)
    told = words_of(page, "issues")
    assert told == words_of(whole, "issues")
    heading, void, again = told
    assert heading == "Issued again"
    assert re.fullmatch(
        r"Issue 2: issued again \d{4}-\d\d-\d\d \d\d:\d\d:\d\d \(UTC[+-]\d{4}\) by R\. Eferee: "
        r"the video shows more; was: level \d, timeout, final",
        again,
    )
    assert "by R. Eferee (void): the floor was wet; was: level" in void


def test_an_earlier_issue_that_is_damaged_or_gone_costs_what_it_was_alone(failed: Path) -> None:
    first = failed / "result_issue_1.json"
    data = first.read_bytes()
    try:
        first.write_text("{")
        assert words_of(report_of(failed), "issues")[2].endswith("the video shows more")
    finally:
        first.write_bytes(data)


def test_a_result_of_a_version_that_told_less_or_more_has_its_page(failed: Path) -> None:
    path = failed / "result.json"
    without_digests(failed)
    data = path.read_bytes()
    document = json.loads(data)
    try:
        path.write_text(json.dumps({k: v for k, v in document.items() if k != "reissues"}))
        assert "Issued again" not in published(failed)
        path.write_text(json.dumps({**document, "steps": [{"step": 7, "name": "dance"}]}))
        page = published(failed)
        assert "Another version wrote the result" in page
        assert words_of(page, "indicators")
    finally:
        path.write_bytes(data)
