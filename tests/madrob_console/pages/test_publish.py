"""`madrob publish`: a competition's pages, self-contained, written whole and where changed."""

from __future__ import annotations

import csv
import errno
import json
import os
import re
import shutil
from contextlib import suppress
from datetime import datetime
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path
from urllib.parse import unquote

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import madrob_console.archive.result_files
import madrob_console.archive.scored
import madrob_console.pages.publish
import madrob_console.pages.site_pages
from madrob_console.archive.folders import REPORT_FILE, RESULT_FILE, RunPath
from madrob_console.archive.history import RunSummary
from madrob_console.archive.result_files import stored_run
from madrob_console.archive.scored import Scored, score_once
from madrob_console.cli.main import main
from madrob_console.cli.output import BAD_INPUT
from madrob_console.common.errors import MadrobError
from madrob_console.common.files import read_all
from madrob_console.pages.competition import competition_standings
from madrob_console.pages.drawings import FEWEST_FOR_A_BOX, MOST_TEAMS
from madrob_console.pages.publish import (
    SiteFile,
    SiteNotWrittenError,
    SiteRefusedError,
    Written,
    runs_without_report,
    site_files,
    site_held,
    write_site,
)
from madrob_console.pages.site_content import (
    MOST_LINES,
    MOST_RUNS,
    SiteContent,
    alike_among,
    condition_place,
    team_place,
)
from scoring.protocol import Outcome
from scoring.result import Uncertainty
from tests.madrob_console.engine.drive import OfficialDrive, make_setup
from tests.madrob_console.pages.competition_runs import (
    LEVEL,
    RUNS,
    SMOOTH,
    TIME,
    of,
    publish,
    publish_code,
    put_recorded,
    stamps,
)
from tests.madrob_console.run_folders import EPOCH, VALUES, write


class Page(HTMLParser):
    """What a page has: its elements, where it links to, its rows."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.path = path
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str]] = []
        self.rows: list[str] = []
        self.feed(path.read_text())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += [(name, value or "") for name, value in attrs]
        if tag == "tr":
            self.rows.append("")

    def handle_data(self, data: str) -> None:
        if self.rows:
            self.rows[-1] += data

    def found(self, name: str) -> list[str]:
        """The values of an attribute."""
        return [value for attribute, value in self.attributes if attribute == name]


def pages(site: Path) -> list[Page]:
    return [Page(path) for path in sorted(site.rglob("*.html"))]


# ---------------------------------------------------------------- what is there


@pytest.mark.parametrize("options", [(), ("--practice",)])
def test_every_link_leads_to_a_file_of_the_site(results: Path, options: tuple[str, ...]) -> None:
    put_recorded(results)
    site = publish(results, *options)
    links = 0
    for page in pages(site):
        ids = set(page.found("id"))
        for href in page.found("href"):
            links += 1
            if href.startswith("#"):
                assert href[1:] in ids
            else:
                target = Path(os.path.normpath(page.path.parent / unquote(href)))
                assert target.is_file(), (page.path, href)
                assert target.is_relative_to(site)
    assert links > 60


def test_no_page_asks_for_anything_from_outside_or_runs_a_script(results: Path) -> None:
    put_recorded(results)
    found = pages(publish(results)) + pages(publish(results, "--practice", site="apart"))
    assert len(found) > 12
    for page in found:
        assert not {"script", "img", "link", "iframe", "form", "object"} & set(page.tags)
        assert not re.search(r"https?:|url\([^#]|@import|\son\w+=", page.path.read_text())
        assert (
            "default-src 'none'; style-src 'unsafe-inline'; img-src data:; base-uri 'none'; "
            "form-action 'none'"
        ) in page.found("content")


def test_every_page_has_its_landmarks_one_title_and_captions(results: Path) -> None:
    for page in pages(publish(results)):
        if page.path.name == REPORT_FILE:
            continue
        assert [page.tags.count(tag) for tag in ("main", "header", "nav", "h1", "footer")] == [
            1
        ] * 5
        assert page.found("lang") == ["en"]
        assert "#main" in page.found("href")
        headings = [int(tag[1]) for tag in page.tags if re.fullmatch("h[1-6]", tag)]
        assert all(after <= before + 1 for before, after in pairwise(headings))
        assert set(page.found("scope")) <= {"row", "col"}


def test_no_page_is_loaded_again_by_itself(results: Path) -> None:
    assert not any("refresh" in page.found("http-equiv") for page in pages(publish(results)))


def test_teams_stand_by_level_first_and_no_failed_run_is_on_top(site: Path) -> None:
    rows = [row for row in Page(site / "conditions/07.html").rows if re.match(r"\d ", row)]
    assert [row[0] for row in rows[:3]] == ["1", "3", "2"]  # the smoothness of 2 is 539.5
    assert "timeout" in rows[2]
    assert "539.5" in rows[2]
    assert "Ordered by capability level first" in (site / "conditions/07.html").read_text()
    overview = [row for row in Page(site / "index.html").rows if re.match(r"\d ", row)]
    assert [row[0] for row in overview] == ["3", "1", "2"]  # 3 in two conditions


def test_flags_voids_protests_doubts_and_reasons_are_told(site: Path) -> None:
    one, three = ((site / f"teams/{n}.html").read_text() for n in ("001", "003"))
    assert "PROTESTED by the team" in one
    assert "UNDECIDED" in one
    assert "INVALID" in one
    assert "a child ran in" in one
    assert "VOID" in three
    assert "3.9000?" in three
    assert "11.00 +- 0.01" in one  # digits and uncertainty as a report has them


def test_values_of_which_no_uncertainty_is_known_say_so(results: Path) -> None:
    write(results, of(5, uncertainties=dict.fromkeys(VALUES, Uncertainty(0.005, 0.01))))
    site, words = publish(results), "no uncertainty is known of them"
    for subject, told in ((2, True), (5, False)):
        assert (words in (site / team_place(subject)).read_text()) == told


def test_a_run_with_an_open_protest_is_not_final_on_every_page(results: Path) -> None:
    write(results, of(2, 2, protest_filed=EPOCH))
    site = publish(results)
    for name in ("index.html", "teams/002.html", "conditions/07.html"):
        assert "NOT FINAL: a PROTEST is open" in (site / name).read_text(), name
    assert "PROTEST open against run 2 of subject 2" in (site / "index.html").read_text()
    assert "NOT FINAL: 1 PROTEST open" in (site / "teams/002.html").read_text()


def test_best_runs_that_cannot_be_told_apart_are_marked(results: Path) -> None:
    near = Uncertainty(0.5, 1.0)
    write(results, of(5, condition=3, own={TIME: 20.0}, uncertainties={TIME: near}))
    write(results, of(6, condition=3, own={TIME: 20.9}, uncertainties={TIME: near}))
    write(results, of(8, condition=3, own={TIME: 30.0}, uncertainties={TIME: near}))
    site = publish(results)
    for name in ("conditions/03.html", "index.html"):
        text = (site / name).read_text()
        assert ">20~ +- 1<" in text
        assert ">21~ +- 1<" in text
        assert ">30 +- 1<" in text


def test_teams_of_one_level_stand_in_the_order_of_their_times(tmp_path: Path) -> None:
    results = tmp_path / "results"
    for subject, time in ((1, 13.84), (2, 12.22), (3, 13.85)):
        write(results, of(subject, own={TIME: time}, team=f"Team {subject}"))
    table = (publish(results) / "index.html").read_text().partition("<h2>Standings</h2>")[2]
    places = [table.index(f"Team {subject}") for subject in (2, 1, 3)]
    assert places == sorted(places)


def test_a_run_that_goes_on_is_none_that_was_interrupted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    results = tmp_path / "results"
    (tmp_path / "plan.csv").write_text("subject,condition,attempts\n3,1,3\n")
    drive = OfficialDrive(results)
    drive.whole_run(make_setup())
    drive.start(make_setup(run_number=2))
    write(results, of(3, 3, 1, ruleset="protocol")).write_text("{")
    assert publish_code(results) == BAD_INPUT  # for the damaged one
    site = tmp_path / "site"
    for name in ("index.html", "teams/003.html"):
        text = (site / name).read_text()
        assert "1 completed, 1 without a result yet" in text
        assert "INTERRUPTED" not in text
    assert "Run 3 does not count: <bdi>its result cannot be used</bdi>." in text
    assert not [page for page in site.rglob("*.html") if "`madrob " in page.read_text()]
    with (site / "data/standings.csv").open() as file:
        row = next(csv.DictReader(file))
    assert (row["interrupted"], row["without_result"]) == ("0", "1")
    capsys.readouterr()
    assert main(["standings", "--results", str(results), "--details"]) == BAD_INPUT
    assert "1 completed, 1 without a result yet" in capsys.readouterr().out
    assert main(["standings", "--results", str(results)]) == BAD_INPUT
    assert "Runs without a result yet: 1.\nRuns that do not count: 1;" in capsys.readouterr().out
    drive.engine.close()


def test_a_teams_zip_is_linked_once_it_is_there_and_stays(results: Path) -> None:
    zipped = publish(results) / "downloads/team_003.zip"
    zipped.parent.mkdir()
    zipped.write_bytes(b"PK")
    site = publish(results)
    assert "../downloads/team_003.zip" in Page(site / "teams/003.html").found("href")
    assert "../downloads/team_001.zip" not in Page(site / "teams/001.html").found("href")
    assert zipped.read_bytes() == b"PK"


def test_practice_is_published_apart_and_says_so(results: Path) -> None:
    assert not any("Rehearsal" in page.path.read_text() for page in pages(publish(results)))
    apart = publish(results, "--practice", site="apart")
    assert "Rehearsal" in (apart / "index.html").read_text()
    assert all("PRACTICE" in p.path.read_text() for p in pages(apart) if p.path.name != REPORT_FILE)


def test_names_have_no_power(site: Path) -> None:
    text = (site / "teams/003.html").read_text()
    assert "<script" not in text
    assert "&lt;script&gt;" in text
    assert not {"\x1b", "\u202e"} & set(text)


def words_of(*places: Path) -> str:
    return "\n".join(place.read_text() for place in places)


def test_many_runs_of_a_team_are_on_pages_of_their_days_and_none_is_lost(results: Path) -> None:
    for number in range(1, MOST_RUNS + 6):  # an hour each, from 22:13 UTC on
        last = number == MOST_RUNS + 5
        run = of(8, number, own={TIME: 100.0 + number}, protest_filed=EPOCH if last else None)
        write(results, run)
    write(results, of(8, 900, outcome=Outcome.ABORTED, values={}, reason="a child ran in"))
    site = publish(results)
    whole, days = site / "teams/008.html", sorted(site.glob("teams/008_*.html"))
    assert len(days) >= 3
    assert {day.name for day in days} <= set(Page(whole).found("href"))
    assert max(page.stat().st_size for page in (whole, *days)) <= 100_000
    for number in range(1, MOST_RUNS + 6):
        assert words_of(*days).count(f">{100 + number}.0000<") == 1
    assert "a child ran in" in words_of(*days)
    assert ">101.0000<" in whole.read_text()  # the best one
    assert ">102.0000<" not in whole.read_text()
    assert "NOT FINAL: 1 PROTEST open" in whole.read_text()
    assert "NOT FINAL: a PROTEST is open" in words_of(*days)
    before = stamps(site)
    write(results, of(8, 901))
    publish(results)
    after = stamps(site)
    assert sum(after[f"teams/{day.name}"] != before[f"teams/{day.name}"] for day in days) <= 1


def test_many_teams_of_a_condition_have_a_page_a_section_and_none_is_lost(results: Path) -> None:
    for subject in range(100, 100 + 3 * MOST_TEAMS):
        for number in range(1, FEWEST_FOR_A_BOX + 1):
            write(results, of(subject, number, own={TIME: 100.0 + number}, team=f"Team {subject}"))
    site = publish(results)
    sections = [site / f"conditions/07{end}.html" for end in ("", "_runs", "_means")]
    for section, title in zip(sections, ("The best run", "All valid runs", "Means"), strict=True):
        text = section.read_text()
        assert re.findall("<h2>(.*?)</h2>", text)[0].startswith(title)
        assert {other.name for other in sections} <= set(Page(section).found("href"))
        assert len(re.sub("(?s)<svg.*?</svg>", "", text).encode()) <= 100_000
        for subject in range(100, 100 + 3 * MOST_TEAMS):
            assert f"Team {subject}" in text


def test_a_long_plan_is_on_pages_of_its_days_and_none_of_its_lines_is_lost(results: Path) -> None:
    write(results, of(2, 2, protest_filed=EPOCH))
    lines = [f"{n},7,1,2026-11-{25 + n % 2}T10:00" for n in range(1, MOST_LINES + 2)]
    (results.parent / "plan.csv").write_text("\n".join(("subject,condition,attempts,time", *lines)))
    site = publish(results)
    days = sorted(site.glob("plan_*.html"))
    assert {day.name for day in days} <= set(Page(site / "plan.html").found("href"))
    rows = [row for day in days for row in Page(day).rows if "condition 7" in row]
    assert len([row for row in rows if "2026-11-2" in row]) == len(lines)
    assert "With an open protest" in (site / "plan.html").read_text()
    assert len([row for row in Page(site / "plan.html").rows if row.startswith("2 ")]) == 1


def test_a_table_of_many_teams_and_conditions_has_what_their_order_goes_by(
    results: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(madrob_console.pages.site_pages, "_MOST_CELLS", 5)
    rows = [row for row in Page(publish(results) / "index.html").rows if re.match(r"\d ", row)]
    told = [[cell.strip() for cell in row.splitlines() if cell.strip()] for row in rows]
    assert [row[1:5] for row in told] == [
        ["6", "2", "2", "26.00"],
        ["6", "1", "1", "11.00"],
        ["4", "1", "0", "-"],
    ]


def test_the_plan_is_there_with_its_progress_and_what_comes_next(site: Path) -> None:
    overview = (site / "index.html").read_text()
    assert "3 of 5 attempts done, 2 left." in overview
    assert '<progress value="3" max="5"' in overview
    assert "attempt 2 of 2" in overview
    assert "0 of 1" in (site / "plan.html").read_text()


def test_planned_times_are_there_and_how_late_the_last_attempt_began(tmp_path: Path) -> None:
    run = of(3)
    write(tmp_path / "results", run)
    at = datetime.fromtimestamp(run.started - 720)  # noqa: DTZ006  of the place
    (tmp_path / "plan.csv").write_text(
        f"subject,condition,attempts,time\n3,{run.condition},1,{at:%Y-%m-%dT%H:%M}\n4,1,1,15:00\n"
    )
    overview = (publish(tmp_path / "results") / "index.html").read_text()
    assert "The last attempt with a planned time began 12 min late." in overview
    assert "attempt 1 of 1, planned for 15:00" in overview


def test_reports_are_led_to_pages_of_the_site_alone(results: Path) -> None:
    put_recorded(results)
    site = publish(results, "--practice")
    (report,) = site.glob("runs/subject_003_cond_001_run_001_*/report.html")
    hrefs = Page(report).found("href")
    (other,) = site.glob("runs/subject_003_cond_001_run_002_*")
    assert f"../{other.name}/report.html" in hrefs
    assert not [href for href in hrefs if "mcap" in href]
    assert "../../teams/003.html" in hrefs


def test_a_report_is_rendered_from_its_run_and_never_copied(results: Path) -> None:
    put_recorded(results)
    site = publish(results, "--practice")
    reports = list(site.glob("runs/*/report.html"))
    assert len(reports) == 2
    for report in reports:
        assert "Where the time went" in report.read_text()
        assert not re.search("evil|javascript", report.read_text())


def test_a_report_is_rendered_again_once_what_it_tells_of_the_team_has_changed(
    results: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, second = put_recorded(results)
    site = publish(results, "--practice")
    (report,) = site.glob(f"runs/{first.name}_*/report.html")
    assert "other runs in this condition is run 2." in report.read_text()
    before = stamps(site)
    rendered: list[Path] = []

    def scored(folder: Path) -> Scored:
        rendered.append(folder)
        return score_once(folder)

    monkeypatch.setattr(madrob_console.archive.scored, "score_once", scored)
    write(results, of(5, source="simulated"))  # another team's
    publish(results, "--practice")
    assert rendered == []
    assert stamps(site)[str(report.relative_to(site))] == before[str(report.relative_to(site))]
    shutil.rmtree(second)
    publish(results, "--practice")
    assert rendered == [first]
    assert "run 2" not in report.read_text()


def test_a_report_that_can_be_rendered_no_more_leaves_no_older_one(
    results: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first, second = put_recorded(results)
    site = publish(results, "--practice")
    for recording in second.glob("*.mcap"):
        recording.unlink()
    (second / RESULT_FILE).touch()  # a process keeps what it has read of an unchanged run
    shutil.rmtree(first)
    assert publish_code(results, "--practice") == BAD_INPUT
    assert f"practice/{second.name}: no report on the site (" in capsys.readouterr().err
    assert not list(site.glob("runs/*/report.html"))
    assert list(site.glob(f"runs/{second.name}_*/{RESULT_FILE}"))


def test_a_run_without_a_report_is_published_and_named(
    capsys: pytest.CaptureFixture[str], site: Path
) -> None:
    assert f"{RUNS[0].folder}: no report of its result to show" in capsys.readouterr().err
    (result,) = site.glob("runs/subject_001_cond_007_run_001_*/result.json")
    assert not result.with_name(REPORT_FILE).exists()
    assert RUNS[0].started_text in (site / "teams/001.html").read_text()


def test_tables_have_the_published_runs_and_no_path_of_the_machine(
    site: Path, results: Path
) -> None:
    with (site / "data/runs.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(RUNS) - 1  # without practice
    assert all((site / row["place"] / RESULT_FILE).is_file() for row in rows)
    text = "".join(p.read_text() for p in site.rglob("*") if p.suffix in {".csv", ".html"})
    assert str(results) not in text


def test_two_halls_are_one_competition(results: Path) -> None:
    other = results.parent / "other"
    shutil.copytree(results, other)  # the same names, as two testbeds may give
    site = results.parent / "both"
    assert main(["publish", str(site), str(results), str(other)]) == 0
    assert len(list(site.glob("runs/*/result.json"))) == 2 * (len(RUNS) - 1)


_WHOLE = st.integers(-(2**53), 2**53)
_NUMBERS = st.floats(allow_nan=False, allow_infinity=False)


@settings(max_examples=60, deadline=None)
@given(
    st.lists(
        st.builds(
            of,
            st.integers(1, 3),
            st.integers(1, 999),
            st.sampled_from([1, 7]),
            own=st.fixed_dictionaries({TIME: _NUMBERS, SMOOTH: _NUMBERS, LEVEL: _WHOLE}),
            uncertainties=st.just({}) | st.builds(lambda x: {TIME: Uncertainty(x, x)}, _NUMBERS),
            outcome=st.sampled_from(Outcome),
            ruleset=st.sampled_from(["protocol", "robust-2026"]),
        ),
        max_size=6,
        unique_by=lambda run: run.folder,
    )
)
def test_whatever_results_say_there_are_pages(runs: list[RunSummary]) -> None:
    runs = sorted(runs, key=lambda run: run.started)
    content = SiteContent(
        root=Path("nowhere"),
        runs=runs,
        standings=competition_standings(runs, made=0.0),
        plan=None,
        names={},
        software="1",
    )
    names = {file.name for file in site_files(content)}
    assert runs_without_report(content) == list(runs)
    assert {team_place(run.subject) for run in runs} <= names
    assert {condition_place(run.condition) for run in runs} <= names
    assert set(content.places.values()) <= names


# ---------------------------------------------------------------- what is written


def test_what_did_not_change_is_not_touched(site: Path, results: Path) -> None:
    before = stamps(site)
    publish(results)
    assert stamps(site) == before


def test_a_new_result_touches_its_own_pages_alone(site: Path, results: Path) -> None:
    before = stamps(site)
    write(results, of(2, 2))
    publish(results)
    after = stamps(site)
    changed = {name for name in after if after[name] != before.get(name)}
    assert {"index.html", "teams/002.html", "conditions/07.html"} <= changed
    assert not {"teams/001.html", "teams/003.html", "conditions/12.html"} & changed
    runs = {name for name in changed if name.startswith("runs/")}
    assert all(name.startswith("runs/subject_002_") for name in runs)


def test_pages_of_runs_that_are_gone_go_and_nothing_else(site: Path, results: Path) -> None:
    mine = site / "notes.txt"
    mine.write_text("mine")
    beside = next(site.glob("runs/subject_003_cond_012_*")) / "photo.jpg"
    beside.write_text("mine")
    shutil.rmtree(results / RUNS[6].folder)
    shutil.rmtree(results / RUNS[3].folder)
    publish(results)
    assert not (site / "teams/002.html").exists()
    assert not (site / "conditions/12.html").exists()
    assert not list(site.glob("runs/subject_002_*"))
    assert [p.name for p in beside.parent.iterdir()] == ["photo.jpg"]
    assert mine.read_text() == "mine"


def test_a_folder_with_other_things_is_refused_with_the_remedy(
    results: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = sorted(results.iterdir())
    assert main(["publish", str(results), "--results", str(results)]) == BAD_INPUT
    assert "holds other things; name an empty folder" in capsys.readouterr().err
    assert sorted(path for path in results.iterdir() if path.name[0] != ".") == [
        path for path in before if path.name[0] != "."
    ]


def page(name: str, text: str) -> SiteFile:
    return SiteFile.of(name, text)


def put(folder: Path, files: list[SiteFile]) -> Written:
    """Write a site of these files."""
    with site_held(folder):
        return write_site(folder, files)


def test_a_file_of_somebody_else_is_not_overwritten(tmp_path: Path) -> None:
    put(tmp_path / "site", [page("index.html", "old")])
    (tmp_path / "site/plan.html").write_text("mine")
    with pytest.raises(SiteRefusedError, match="move it away"):
        put(tmp_path / "site", [page("index.html", "new"), page("plan.html", "new")])
    assert (tmp_path / "site/index.html").read_text() == "old"


def test_who_is_cut_off_leaves_whole_files_and_the_next_one_goes_on(tmp_path: Path) -> None:
    site = tmp_path / "site"
    put(site, [page("a.html", "old a"), page("b.html", "old b")])

    def full() -> bytes:
        assert (site / "a.html").read_text() == "new a"  # in the order given
        raise MadrobError("no room")

    files = [page("a.html", "new a"), SiteFile("b.html", "2", full), page("c.html", "new c")]
    with pytest.raises(MadrobError, match="no room"):
        put(site, files)
    assert {p.name: p.read_text() for p in site.glob("*.html")} == {
        "a.html": "new a",
        "b.html": "old b",
    }
    done = put(site, [page("a.html", "new a"), page("c.html", "new c")])
    assert (done.removed, {p.name for p in site.glob("*.html")}) == (1, {"a.html", "c.html"})
    assert not [p for p in site.iterdir() if p.suffix in {".part", ".lock"}]


def test_a_file_that_somebody_changed_is_made_again(tmp_path: Path) -> None:
    put(tmp_path / "site", [page("a.html", "whole")])
    (tmp_path / "site/a.html").write_text("cut")
    put(tmp_path / "site", [page("a.html", "whole")])
    assert (tmp_path / "site/a.html").read_text() == "whole"


def test_names_in_the_list_lead_nowhere_else(tmp_path: Path) -> None:
    site = tmp_path / "site"
    put(site, [page("a.html", "a")])
    (tmp_path / "mine.txt").write_text("mine")
    listed = next(site.glob(".madrob_site.json"))
    listed.write_text(listed.read_text().replace('"a.html"', '"../mine.txt"'))
    (site / "a.html").unlink()
    put(site, [page("b.html", "b")])
    assert (tmp_path / "mine.txt").exists()


@pytest.mark.parametrize("linked", ["teams", "runs", "runs/one"])
def test_no_page_is_written_or_removed_through_a_link(tmp_path: Path, linked: str) -> None:
    site, victim = tmp_path / "site", tmp_path / "victim"
    put(site, [page("runs/one/a.html", "a"), page("teams/b.html", "b")])
    shutil.copytree(site / linked, victim)
    (victim / "journal.jsonl").write_text("mine")
    before = {path: path.read_bytes() for path in victim.rglob("*") if path.is_file()}
    shutil.rmtree(site / linked)
    (site / linked).symlink_to(victim)
    listed = site / ".madrob_site.json"
    listed.write_text(
        listed.read_text().replace('"teams/b.html"', f'"teams/b.html":"","{linked}/journal.jsonl"')
    )
    for files in ([page("index.html", "new")], [page(f"{linked}/new.html", "new")]):
        with pytest.raises(SiteRefusedError, match=f"{linked}: is a link.*; remove it"):
            put(site, files)
    assert {path: path.read_bytes() for path in victim.rglob("*") if path.is_file()} == before
    assert not (site / "index.html").exists()


def test_a_link_that_comes_while_a_site_is_written_is_not_followed(tmp_path: Path) -> None:
    site, victim = tmp_path / "site", tmp_path / "victim"
    victim.mkdir()

    def make() -> bytes:
        with suppress(FileNotFoundError):
            (site / "teams").rmdir()
        (site / "teams").symlink_to(victim)
        return b"b"

    with pytest.raises(SiteNotWrittenError):
        put(site, [SiteFile("teams/b.html", "1", make)])
    assert not list(victim.iterdir())


def test_a_linked_folder_of_a_site_is_one_line_and_exit_code_2(
    capsys: pytest.CaptureFixture[str], site: Path, results: Path
) -> None:
    shutil.move(site / "teams", results.parent / "elsewhere")
    (site / "teams").symlink_to(results.parent / "elsewhere")
    capsys.readouterr()
    assert publish_code(results) == BAD_INPUT
    told = capsys.readouterr().err
    assert told == f"madrob: {site}/teams: is a link, which leads out of the site; remove it\n"


def test_without_runs_there_is_a_site_that_says_so(results: Path) -> None:
    shutil.rmtree(results)
    results.mkdir()
    site = publish(results)
    assert "No run counts yet." in (site / "index.html").read_text()


def change(results: Path, number: int, **fields: object) -> None:
    """Other words in the result of one of the runs."""
    path = results / RUNS[number].folder / RESULT_FILE
    path.write_text(json.dumps({**json.loads(path.read_text()), **fields}))


def result_of(results: Path, number: int) -> Path:
    """The result of one of the runs on the site."""
    (found,) = (results.parent / "site/runs").glob(f"{RUNS[number].folder}_*")
    return found / RESULT_FILE


def test_a_slow_publisher_writes_no_older_pages_over_newer_ones(
    results: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    codes = []

    def slow(content: SiteContent) -> object:
        monkeypatch.undo()
        change(
            results, 0, voided={"time": 1.0, "reason": "unsafe", "referee": "R"}
        )  # after this one has read the runs
        codes.append(publish_code(results))
        return site_files(content)

    monkeypatch.setattr(madrob_console.pages.publish, "site_files", slow)
    publish(results)
    assert codes == [os.EX_TEMPFAIL]  # the engine tries it again
    assert "another `madrob publish` writes there now" in capsys.readouterr().err
    publish(results)
    assert json.loads(result_of(results, 0).read_text())["voided"]["reason"] == "unsafe"
    assert "VOID" in (results.parent / "site/teams/001.html").read_text()


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
        patched.setattr(madrob_console.pages.publish, "read_all", read)
        assert publish_code(results) == BAD_INPUT
    told = capsys.readouterr().err
    assert f"{bad}: cannot be read ({os.strerror(number)}); `madrob " in told
    assert len([line for line in told.splitlines() if "madrob: note: " not in line]) == 1
    site = results.parent / "site"
    assert (site / "index.html").exists()
    assert result_of(results, 1).exists()
    assert not list(site.glob(f"runs/{RUNS[0].folder}_*"))
    publish(results)
    assert result_of(results, 0).exists()


@pytest.mark.parametrize("run_id", ["abcdefg\u00e9", "../../..", "0190\u0661\u0662\u0663\u0664"])
def test_whatever_a_run_says_it_is_its_page_is_found_again(results: Path, run_id: str) -> None:
    change(results, 0, run_id=run_id)
    publish(results)
    publish(results)
    place = result_of(results, 0).relative_to(results.parent / "site").as_posix()
    assert re.fullmatch(r"runs/[a-z0-9_]+/result\.json", place)


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
        patched.setattr(madrob_console.archive.result_files, "stored_run", read)
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
