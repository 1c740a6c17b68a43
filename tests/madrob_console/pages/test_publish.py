"""`madrob publish`: a competition's pages, self-contained, written whole and where changed."""

from __future__ import annotations

import csv
import errno
import json
import os
import re
import shutil
from collections.abc import Iterator
from datetime import datetime
from itertools import pairwise
from pathlib import Path
from unittest.mock import Mock
from urllib.parse import unquote

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from madrob_console.archive.folders import REPORT_FILE, RESULT_FILE
from madrob_console.archive.run_paths import RunPath
from madrob_console.archive.scored import score_once
from madrob_console.archive.stored_runs import stored_run
from madrob_console.cli.output import BAD_INPUT
from madrob_console.common.errors import MadrobError
from madrob_console.common.plain_files import read_all
from madrob_console.pages.competition import competition_standings
from madrob_console.pages.outputs import standings_lines
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
    SiteContent,
    condition_place,
    team_place,
)
from madrob_console.pages.tally import leaders_first, standings
from madrob_console.referee.run_summary import RunSummary
from scoring.protocol import Outcome
from scoring.result import Uncertainty
from tests.madrob_console.cli.typed import Madrob
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
from tests.madrob_console.pages.page import Page
from tests.madrob_console.run_folders import EPOCH, VALUES, write

PLAN = "subject,condition,attempts\n1,7,2\n3,12,2\n9,7,1\n"
NEAR = {TIME: Uncertainty(0.5, 1.0)}
MORE = (
    of(13, 2, protest_filed=EPOCH),
    of(5, uncertainties=dict.fromkeys(VALUES, Uncertainty(0.005, 0.01))),
    of(10, condition=3, own={TIME: 20.0}, uncertainties=NEAR),
    of(11, condition=3, own={TIME: 20.9}, uncertainties=NEAR),
    of(12, condition=3, own={TIME: 30.0}, uncertainties=NEAR),
)


def put_runs(root: Path, *runs: RunSummary, plan: str = PLAN) -> Path:
    """A results folder with runs and a plan beside it."""
    for run in runs:
        write(root / "results", run)
    (root / "plan.csv").write_text(plan)
    return root / "results"


@pytest.fixture
def results(tmp_path: Path) -> Path:
    return put_runs(tmp_path, *RUNS)


@pytest.fixture
def site(results: Path) -> Path:
    return publish(results)


@pytest.fixture(scope="module")
def sites(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Of all that a competition may have; nobody writes there."""
    results = put_runs(tmp_path_factory.mktemp("competition"), *RUNS, *MORE)
    put_recorded(results)
    practice = publish(results, "--practice", site="apart")
    return {"official": publish(results), "practice": practice}


def pages(site: Path) -> Iterator[tuple[Path, Page]]:
    for path in sorted(site.rglob("*.html")):
        yield path, Page(path.read_text())


def rows_of(path: Path) -> list[str]:
    """The rows of a page that begin with a number."""
    return [row for row in Page(path.read_text()).rows if re.match(r"\d+ ", row)]


def first_cells(path: Path) -> list[str]:
    return [row.split()[0] for row in rows_of(path)]


# ---------------------------------------------------------------- what is there


@pytest.mark.parametrize("kind", ["official", "practice"])
def test_every_page_is_whole_asks_nothing_from_outside_and_says_if_it_is_practice(
    sites: dict[str, Path], kind: str
) -> None:
    site, links = sites[kind], 0
    assert len(list(site.rglob("*.html"))) > 5
    for path, page in pages(site):
        for href in page.found("href"):
            target = Path(os.path.normpath(path.parent / unquote(href)))
            within = target.is_file() and target.is_relative_to(site)
            assert within or href[1:] in page.found("id"), (path, href)
            links += 1
        assert not {"script", "img", "link", "iframe", "form", "object"} & set(page.tags)
        assert not re.search(r"https?:|url\([^#]|@import|\son\w+=", path.read_text())
        assert not {"\x1b", "\u202e"} & set(path.read_text())
        assert (
            "default-src 'none'; style-src 'unsafe-inline'; img-src data:; base-uri 'none'; "
            "form-action 'none'"
        ) in page.found("content")
        assert "refresh" not in page.found("http-equiv")
        if path.name == REPORT_FILE:
            continue
        assert ("PRACTICE" in page.text) == (kind == "practice")
        landmarks = ("main", "header", "nav", "h1", "footer")
        assert [page.tags.count(tag) for tag in landmarks] == [1] * 5
        assert page.found("lang") == ["en"]
        assert "#main" in page.found("href")
        headings = [int(tag[1]) for tag in page.tags if re.fullmatch("h[1-6]", tag)]
        assert all(after <= before + 1 for before, after in pairwise(headings))
        assert set(page.found("scope")) <= {"row", "col"}
    assert links > 60
    assert ("Rehearsal" in (site / "index.html").read_text()) == (kind == "practice")


TOLD: dict[str, tuple[str, ...]] = {
    "index.html": (
        *("NOT FINAL: a PROTEST is open", "PROTEST open against run 2 of subject 13"),
        "INVALID: a child ran in",
        *("3 of 5 attempts done, 2 left.", '<progress value="3" max="5"', "attempt 2 of 2"),
        *(">20 +- 1<", ">21 +- 1<", ">30 +- 1<"),
    ),
    "plan.html": ("0 of 1",),
    "conditions/03.html": (">20 +- 1<", ">21 +- 1<", ">30 +- 1<"),
    "conditions/07.html": (
        "NOT FINAL: a PROTEST is open",
        "Ordered by capability level first",
    ),
    "teams/001.html": (
        *("PROTESTED by the team", "UNDECIDED", "INVALID", "a child ran in"),
        "11.00 +- 0.01",  # digits and uncertainty as a report has them
        RUNS[0].started_text,
    ),
    "teams/002.html": ("no uncertainty is known of them",),
    "teams/013.html": ("NOT FINAL: a PROTEST is open", "NOT FINAL: 1 PROTEST open"),
    "teams/003.html": ("VOID", "3.9000?", "&lt;script&gt;"),
}


@pytest.mark.parametrize("name", TOLD)
def test_what_counts_and_what_does_not_is_told(sites: dict[str, Path], name: str) -> None:
    text = (sites["official"] / name).read_text()
    assert [words for words in TOLD[name] if words not in text] == []
    assert not [row for row in Page(text).rows if "INVALID" in row and "not final" in row]
    known = (sites["official"] / "teams/005.html").read_text()
    assert "no uncertainty is known of them" not in known


def test_teams_stand_by_level_first_then_by_time_and_no_failed_run_is_on_top(
    sites: dict[str, Path], results: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = rows_of(sites["official"] / "conditions/07.html")
    assert [row.split()[0] for row in rows[:5]] == ["1", "3", "5", "13", "2"]
    assert re.search("timeout(?s:.*)539.5", rows[4])  # the smoothness of 2
    overview = first_cells(sites["official"] / "index.html")
    assert overview == ["3", "1", "5", "10", "11", "12", "13", "2"]
    monkeypatch.setattr("madrob_console.pages.site_pages._MOST_CELLS", 5)
    told = [row.split("\n") for row in rows_of(publish(results) / "index.html")]
    cells = [[cell.strip() for cell in row if cell.strip()] for row in told]
    assert [row[1:3] for row in cells] == [["12", "2"], ["6", "1"], ["4", "0"]]


def test_site_command_and_screens_have_one_order_and_mark_every_leader(tmp_path: Path) -> None:
    near = {TIME: Uncertainty(0.01, 0.02)}
    times = {1: 13.857, 2: 13.855, 3: 13.855, 4: 13.856}
    runs = [of(n, 9 - n, own={TIME: time}, uncertainties=near) for n, time in times.items()]
    runs.append(of(5, outcome=Outcome.TIMEOUT, own={TIME: 1.0}))
    site = publish(put_runs(tmp_path, *runs))
    ordered = ["2", "3", "4", "1", "5"]
    assert first_cells(site / "conditions/07.html")[:5] == ordered
    found = competition_standings(runs, made=0.0, best=1)
    table = [line.split() for line in standings_lines(found) if re.match(r" +\d ", line)]
    assert [row[0] for row in table] == ordered
    for best in (0, 1):  # the screens' table
        screens = leaders_first(standings(runs, best=best))
        assert [str(one.subject) for one in screens] == ordered
    overview = (site / "index.html").read_text()
    assert len(re.findall("<b><span[^>]*>level", overview)) == 2
    (leading,) = re.findall("Who leads in each condition.*?</ul>", overview, re.DOTALL)
    assert re.findall(">([0-9]) <bdi>", leading) == ["2", "3"]


def test_a_run_that_goes_on_is_none_that_was_interrupted(tmp_path: Path, madrob: Madrob) -> None:
    results = put_runs(tmp_path, plan="subject,condition,attempts\n3,1,3\n")
    drive = OfficialDrive(results)
    drive.whole_run(make_setup())
    drive.start(make_setup(run_number=2))
    write(results, of(3, 3, 1, ruleset="protocol")).write_text("{")
    assert publish_code(results) == BAD_INPUT  # for the damaged one
    drive.engine.close()
    site = tmp_path / "site"
    for name in ("index.html", "teams/003.html"):
        text = (site / name).read_text()
        assert "1 completed, 1 without a result yet" in text
        assert "INTERRUPTED" not in text
    assert "Run 3 does not count: <bdi>its result cannot be used</bdi>." in text
    assert "`madrob " not in words_of(*site.rglob("*.html"))
    row = next(csv.DictReader((site / "data/standings.csv").read_text().splitlines()))
    assert (row["interrupted"], row["without_result"]) == ("0", "1")


def words_of(*places: Path) -> str:
    return "\n".join(place.read_text() for place in places)


def test_planned_times_are_there_and_how_late_the_last_attempt_began(tmp_path: Path) -> None:
    run = of(3)
    at = datetime.fromtimestamp(run.started - 720)  # noqa: DTZ006  of the place
    plan = f"3,{run.condition},1,{at:%Y-%m-%dT%H:%M}\n4,1,1,15:00\n"
    results = put_runs(tmp_path, run, plan=f"subject,condition,attempts,time\n{plan}")
    overview = (publish(results) / "index.html").read_text()
    for words in ("time began 12 min late.", "attempt 1 of 1, planned for 15:00"):
        assert words in overview


def test_a_report_is_rendered_from_its_run_and_leads_to_pages_of_the_site(
    sites: dict[str, Path],
) -> None:
    reports = sorted(sites["practice"].glob("runs/*/report.html"))
    assert len(reports) == 2
    for report, other in (reports, reports[::-1]):
        text = report.read_text()
        assert "Where the time went" in text
        assert not re.search("evil|javascript|mcap", text)
        links = {f"../{other.parent.name}/report.html", "../../teams/003.html"}
        assert links <= set(Page(text).found("href"))


def test_a_report_follows_what_it_tells_and_goes_when_it_cannot_be_rendered(
    results: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    first, second = put_recorded(results)
    site = publish(results, "--practice")
    (report,) = site.glob(f"runs/{first.name}_*/report.html")
    assert "other runs in this condition is run 2." in report.read_text()
    before, rendered = stamps(report.parent), Mock(side_effect=score_once)
    monkeypatch.setattr("madrob_console.archive.scored.score_once", rendered)
    write(results, of(5, source="simulated"))  # another team's
    publish(results, "--practice")
    rendered.assert_not_called()
    assert stamps(report.parent) == before
    shutil.rmtree(second)
    publish(results, "--practice")
    rendered.assert_called_once_with(first)
    assert "run 2" not in report.read_text()
    (results.parent / "teams.csv").write_text("3,New Name\n")
    publish(results, "--practice", f"--teams={results.parent / 'teams.csv'}")
    assert "New Name" in report.read_text()
    next(first.glob("*.mcap")).unlink()
    (first / RESULT_FILE).touch()  # a process keeps what it has read of an unchanged run
    assert publish_code(results, "--practice") == BAD_INPUT
    assert f"practice/{first.name}: no report on the site (" in capsys.readouterr().err
    assert [path.name for path in report.parent.iterdir()] == [RESULT_FILE]


def test_files_of_a_site_are_those_of_its_runs_and_tell_no_path_of_the_machine(
    capsys: pytest.CaptureFixture[str], site: Path, results: Path
) -> None:
    assert f"{RUNS[0].folder}: no report of its result to show" in capsys.readouterr().err
    assert not result_of(results, 0).with_name(REPORT_FILE).exists()
    rows = list(csv.DictReader((site / "data/runs.csv").read_text().splitlines()))
    assert len(rows) == len(RUNS) - 1  # without practice
    assert all((site / row["place"] / RESULT_FILE).is_file() for row in rows)
    assert str(results) not in words_of(*site.rglob("*.csv"), *site.rglob("*.html"))
    zipped = site / "downloads/team_003.zip"
    zipped.parent.mkdir()
    zipped.write_bytes(b"PK")
    publish(results)
    linked = {page.parent.name for page in site.rglob("*.html") if zipped.name in page.read_text()}
    assert "teams" in linked
    assert zipped.name not in (site / "teams/001.html").read_text()
    assert zipped.read_bytes() == b"PK"


def test_two_halls_are_one_competition_whatever_their_folders_are_called(
    results: Path, madrob: Madrob
) -> None:
    other = results.parent / os.fsdecode(b"hall \xff")
    shutil.copytree(results, other)  # the same names, as two testbeds may give
    madrob("publish", results.parent / "both", results, other)
    published = list((results.parent / "both").glob("runs/*/result.json"))
    assert len(published) == 2 * (len(RUNS) - 1)


@pytest.mark.parametrize(
    ("runs", "overview", "said"),
    [
        ([], "No run counts yet.", ""),
        ([RUNS[-1]], "No run counts yet.", "no official run, 1 of practice: --practice shows"),
    ],
    ids=["none", "practice alone"],
)
def test_without_runs_that_count_there_is_a_site_that_says_so(
    runs: list[RunSummary],
    overview: str,
    said: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / "results").mkdir()
    assert overview in (publish(put_runs(tmp_path, *runs)) / "index.html").read_text()
    assert said in capsys.readouterr().err


_WHOLE = st.integers(-(2**53), 2**53)
_NUMBERS = st.floats(allow_nan=False, allow_infinity=False)


@settings(max_examples=60, deadline=None)
@example([of(1, 1, number, own={SMOOTH: -1.7e308}) for number in (1, 7)])  # the sum is beyond
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
    names = set()
    for file in site_files(content):
        assert file.make() or file.name.startswith("runs/")
        names.add(file.name)
    assert runs_without_report(content) == list(runs)
    assert {team_place(run.subject) for run in runs} <= names
    assert {condition_place(run.condition) for run in runs} <= names
    assert set(content.places.values()) <= names


# ---------------------------------------------------------------- what is written


def test_pages_of_runs_that_are_gone_go_and_nothing_else(site: Path, results: Path) -> None:
    mine = site / "notes.txt", result_of(results, 6).with_name("photo.jpg")
    for path in mine:
        path.write_text("mine")
    for number in (3, 6):
        shutil.rmtree(results / RUNS[number].folder)
    publish(results)
    for gone in ("teams/002.html", "conditions/12.html", "runs/subject_002_*"):
        assert not list(site.glob(gone))
    assert [path.name for path in mine[1].parent.iterdir()] == ["photo.jpg"]
    assert [path.read_text() for path in mine] == ["mine"] * 2


def test_a_folder_with_other_things_is_refused_with_the_remedy(
    results: Path, madrob: Madrob
) -> None:
    before = set(results.glob("[!.]*"))
    refusal = madrob.refusal("publish", results, "--results", results)
    assert "holds other things; name an empty folder" in refusal
    assert set(results.glob("[!.]*")) == before


def page(name: str, text: str) -> SiteFile:
    return SiteFile(name, lambda: text)


def put(folder: Path, *files: SiteFile, **pages: str) -> Written:
    """Write a site of these files and pages."""
    with site_held(folder):
        named = (page(f"{name}.html", text) for name, text in pages.items())
        return write_site(folder, [*files, *named])


def texts_of(site: Path) -> dict[str, str]:
    """What stands before the mark of each page."""
    return {path.stem: path.read_text().partition("<!--")[0] for path in site.glob("*.html")}


def test_who_is_cut_off_leaves_whole_files_and_the_next_one_goes_on(tmp_path: Path) -> None:
    site = tmp_path / "site"
    put(site, index="old", plan="old")

    def full() -> bytes:
        assert texts_of(site)["index"] == "new"  # in the order given
        raise MadrobError("no room")

    with pytest.raises(MadrobError, match="no room"):
        put(site, page("index.html", "new"), SiteFile("plan.html", full), c="new")
    assert texts_of(site) == {"index": "new", "plan": "old"}
    before = stamps(site)
    assert put(site, index="new", c="new") == Written(2, 1, 1, [])
    assert texts_of(site) == {"index": "new", "c": "new"}
    assert stamps(site)["index.html"] == before["index.html"]
    assert not [path for path in site.iterdir() if path.suffix in {".part", ".lock"}]


def test_what_is_somebody_else_s_is_neither_overwritten_nor_removed(tmp_path: Path) -> None:
    site = tmp_path / "site"
    put(site, index="old")
    mine = site / "plan.html", site / "teams/001.html", site / "teams/notes.html"
    (site / "teams/002.html").mkdir(parents=True)
    (site / "teams/003.html").symlink_to(tmp_path / "mine")
    for path in mine:
        path.write_text("mine")
    with pytest.raises(SiteRefusedError, match="move it away"):
        put(site, plan="new", index="new")
    assert put(site, index="new").removed == 0
    assert [path.read_text() for path in mine] == ["mine"] * 3


@pytest.mark.parametrize("linked", ["teams", "runs", "runs/subject_001_01234567"])
def test_no_page_is_written_or_removed_through_a_link(tmp_path: Path, linked: str) -> None:
    site, victim = tmp_path / "site", tmp_path / "victim"
    run = "runs/subject_001_01234567"
    put(site, page(f"{run}/report.html", "a"), page("teams/001.html", "b"))
    shutil.move(site / linked, victim)
    (victim / RESULT_FILE).write_text("mine")
    before = {path: path.read_bytes() for path in victim.rglob("*.*")}
    (site / linked).symlink_to(victim)
    for name in ("index.html", f"{linked}/new.html"):
        with pytest.raises(SiteRefusedError, match=f"{linked}: is a link.*; remove it"):
            put(site, page(name, "new"))
    assert {path: path.read_bytes() for path in victim.rglob("*.*")} == before
    assert not (site / "index.html").exists()


def test_a_link_that_comes_while_a_site_is_written_is_not_followed(tmp_path: Path) -> None:
    site, victim = tmp_path / "site", tmp_path / "victim"
    victim.mkdir()

    def make() -> bytes:
        (site / "teams").symlink_to(victim)
        return b"b"

    with pytest.raises(SiteNotWrittenError):
        put(site, SiteFile("teams/b.html", make))
    assert not list(victim.iterdir())


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
        void = {"time": 1.0, "reason": "unsafe", "referee": "R"}
        change(results, 0, voided=void)  # after this one has read the runs
        codes.append(publish_code(results))
        return site_files(content)

    monkeypatch.setattr("madrob_console.pages.publish.site_files", slow)
    publish(results)
    assert codes == [os.EX_TEMPFAIL]  # the engine tries it again
    assert "another `madrob publish` writes there now" in capsys.readouterr().err
    publish(results)
    assert json.loads(result_of(results, 0).read_text())["voided"]["reason"] == "unsafe"
    assert "VOID" in (results.parent / "site/teams/001.html").read_text()


@pytest.mark.parametrize("number", [errno.EIO, errno.ENOENT])
def test_a_result_that_cannot_be_read_keeps_nothing_else_from_being_written(
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
        patched.setattr("madrob_console.pages.publish.read_all", read)
        assert publish_code(results) == BAD_INPUT
    said = capsys.readouterr().err.splitlines()
    (told,) = (line for line in said if "madrob: note: " not in line)
    assert f"{bad}: cannot be read ({os.strerror(number)}); `madrob " in told
    assert (results.parent / "site/index.html").exists()
    assert result_of(results, 1).exists()
    assert not list((results.parent / "site").glob(f"runs/{RUNS[0].folder}_*"))
    publish(results)
    assert result_of(results, 0).exists()


@pytest.mark.parametrize("run_id", ["abcdefg\u00e9", "../../..", "0190\u0661\u0662\u0663\u0664"])
def test_whatever_a_run_says_it_is_its_page_is_found_again(results: Path, run_id: str) -> None:
    change(results, 0, run_id=run_id)
    for _ in range(2):
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

    for reading, missing in ((read, 2), (stored_run, 1)):  # practice and this one
        monkeypatch.setattr("madrob_console.archive.stored_runs.stored_run", reading)
        table = (publish(results) / "data/runs.csv").read_text()
        assert len(table.splitlines()) - 1 == len(RUNS) - missing
