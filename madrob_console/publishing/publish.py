"""All files of a competition's site, from its runs as they are now."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from hashlib import sha256
from pathlib import Path

from madrob_console.archive.folders import (
    INDEX_PAGE,
    JOURNAL_FILE,
    PICTURES_FOLDER,
    PICTURES_INDEX,
    REPORT_FILE,
    RESULT_FILE,
)
from madrob_console.archive.history import RunSummary
from madrob_console.archive.listed_result import ListedResult, PagedResult
from madrob_console.archive.result_reader import (
    LARGEST_RESULT,
    DamagedResultError,
    UnusableResultError,
    read_paged_result,
    read_result,
)
from madrob_console.files.bounded import read_all, stamp_of
from madrob_console.files.plain import refusal
from madrob_console.publishing.condition_page import condition_page
from madrob_console.publishing.hall_page import hall_page
from madrob_console.publishing.overview import overview_page, plan_page
from madrob_console.publishing.run_page import run_page
from madrob_console.publishing.site_content import (
    HALL,
    PLAN,
    SiteContent,
    beside,
    condition_place,
    report_beside,
    result_beside,
    team_place,
)
from madrob_console.publishing.site_folder import SiteFile, SourceUnreadError
from madrob_console.publishing.site_frame import condition_link, team_link, ways
from madrob_console.publishing.site_tables import RunTables
from madrob_console.publishing.team_page import team_page
from madrob_console.report.explanations import date_text
from madrob_console.report.markup import Markup, link
from madrob_console.report.surroundings import Surroundings, team_digest
from madrob_console.standings.data_files import standings_csv, standings_json
from madrob_console.standings.plan_table import plan_json
from madrob_console.tidy.run_tables import RUN_TABLES


def site_files(content: SiteContent) -> tuple[list[SiteFile], list[RunSummary]]:
    """All files, those that others link to first; and the runs without a report to show.

    Args:
        content: of the site.
    """
    files: list[SiteFile] = []
    without = []
    around = Surroundings()
    for run in content.runs:
        if run.folder in content.places:
            own = list(_of_run(content, run, around))
            files += own
            if not any(file.name.endswith(REPORT_FILE) for file in own):
                without.append(run)
    files += _tables(content)
    files += [SiteFile.of(team_place(one), team_page(content, one)) for one in content.of_team]
    files += [
        SiteFile.of(condition_place(one), condition_page(content, one))
        for one in content.conditions
    ]
    if content.plan is not None:
        files.append(SiteFile.of(PLAN, plan_page(content, content.plan)))
    written = date_text(content.standings.made)
    for name, make in ((HALL, hall_page), (INDEX_PAGE, overview_page)):
        # that it is later now is alone no reason to write it again
        files.append(SiteFile.of(name, make(content, written), make(content, "")))
    return files, without


def _of_run(content: SiteContent, run: RunSummary, around: Surroundings) -> Iterator[SiteFile]:
    """Its report where one was made of it, its result, its page."""
    place, folder = content.places[run.folder], content.source(run)
    result = result_beside(place)
    named = []
    if _has_report(content, run):
        named.append(report_beside(place))
        sources = (RESULT_FILE, JOURNAL_FILE, f"{PICTURES_FOLDER}/{PICTURES_INDEX}")
        stamps = (stamp_of(f"{folder}/{name}") for name in sources)
        team = content.of_team[run.subject]
        others = (team_digest(run, team), *(_report_page(content, run, one) for one in team))
        key = _key(content.software, _ways(content, run), *others, *stamps)
        yield SiteFile(named[0], key, partial(_report, content, run, around))
    stamp = stamp_of(f"{folder}/{RESULT_FILE}")
    if stamp is not None and run.problem is None:
        named.append(result)
        yield SiteFile(result, _key(stamp), partial(_result, folder / RESULT_FILE))
    key = _key(content.software, stamp, run_page(content, run, named, None))
    yield SiteFile(place, key, partial(_page, content, run, named))


def _page(content: SiteContent, run: RunSummary, files: Sequence[str]) -> bytes:
    """The page of a run with what its result says."""
    folder = str(content.source(run))
    result: PagedResult | ListedResult
    try:
        try:
            result = read_paged_result(folder)
        except DamagedResultError:
            result, _ = read_result(folder)
    except (OSError, UnusableResultError) as error:
        raise SourceUnreadError(f"{run.folder}: {error}") from None
    return run_page(content, run, files, result).encode()


def _has_report(content: SiteContent, run: RunSummary) -> bool:
    return stamp_of(f"{content.source(run)}/{REPORT_FILE}") is not None


def _report_page(content: SiteContent, run: RunSummary, other: RunSummary) -> str:
    """The report of another run as seen from that of a run; empty = the site has none."""
    place = content.places.get(other.folder)
    if place is None or not _has_report(content, other):
        return ""
    return beside(content.places[run.folder], report_beside(place))


def _ways(content: SiteContent, run: RunSummary) -> Markup:
    """The ways from its report to the pages around it."""
    place = report_beside(content.places[run.folder])
    more = (
        link(beside(place, content.places[run.folder]), "this run, short"),
        team_link(content, place, run.subject),
        condition_link(content, place, run.condition),
    )
    return ways(content, place, more)


def _report(content: SiteContent, run: RunSummary, around: Surroundings) -> bytes:
    """Rendered from journal and recording: anybody may have written the report in the folder."""
    # they load numpy, SciPy and matplotlib, which a site without new reports does without
    from madrob_console.archive.scored import score_once
    from madrob_console.cameras.run_pictures import stored_pictures
    from madrob_console.report.page import report_html

    folder, page = content.source(run), partial(_report_page, content, run)
    try:
        scored = score_once(folder)
        place = around.among(content.root, run.folder, content.runs, scored, page)
        place = replace(place, ways=_ways(content, run))
        return report_html(scored, content.software, place, stored_pictures(folder)).encode()
    except Exception as error:  # whatever it is, it is this run's and no other's
        raise SourceUnreadError(f"{run.folder}: no report on the site ({error})") from error


def _result(path: Path) -> bytes:
    try:
        return read_all(path, LARGEST_RESULT)
    except OSError as error:  # it may be gone since the runs were listed
        why = f"cannot be read ({refusal(error)}); `madrob publish` takes it once it can be read"
        raise SourceUnreadError(f"{path}: {why}") from None


def _tables(content: SiteContent) -> Iterator[SiteFile]:
    tables = RunTables(content)
    for table in RUN_TABLES:
        make = partial(tables.csv, table)
        yield SiteFile(f"data/{table.name}.csv", tables.key, make, lambda: tables.whole)
    yield SiteFile.of("data/standings.csv", standings_csv(content.standings))
    undated = replace(content.standings, made=0.0)
    remarks = content.standings.remarks  # a protest becomes overdue by the time alone
    yield SiteFile.of(
        "data/standings.json",
        standings_json(content.standings, content.software).decode(),
        "\n".join((standings_json(undated, content.software).decode(), *remarks)),
    )
    if content.plan is not None:
        competition = content.standings.title
        made = plan_json(content.plan, competition, content.names, content.software)
        yield SiteFile.of("data/plan.json", made.decode())


def _key(*of: object) -> str:
    return sha256("\n".join(map(str, of)).encode(errors="surrogateescape")).hexdigest()
