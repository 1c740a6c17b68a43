"""What a report says of a run that was issued again."""

from __future__ import annotations

import html
import re
from pathlib import Path

import pytest

from madrob_console.archive.scored import score_opened
from madrob_console.pages.report import report_html
from madrob_console.pages.surroundings import Surroundings
from madrob_console.referee.acts import Finalise, Reissue, Rule, Void
from madrob_console.referee.records import TeamWord
from madrob_console.testbeds.simulated import Scenario
from scoring.protocol import Step
from tests.madrob_console.engine.drive import Drive, make_setup


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


def report_of(folder: Path) -> str:
    scored = score_opened(folder)
    return report_html(scored, place=Surroundings().place_of(folder, scored))


def test_who_issued_a_result_again_why_and_what_it_was_is_told(failed: Path) -> None:
    told = words_of(report_of(failed), "issues")
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
