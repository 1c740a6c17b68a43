"""Writes a competition's site.

Every file is made again and written if its bytes have changed. The folder has a mark, and each
page ends with one. Files that a site no longer needs are removed only by the names that a site
has, in a folder with the mark, and a page only if it has the mark, too.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass, replace
from functools import cache, partial
from hashlib import sha256
from io import BytesIO
from pathlib import Path

from markupsafe import Markup

from madrob_console.archive.folders import (
    INDEX_PAGE,
    JOURNAL_FILE,
    REPORT_FILE,
    RESULT_FILE,
)
from madrob_console.archive.result_reader import LARGEST_RESULT
from madrob_console.archive.run_paths import RunPath
from madrob_console.archive.table_columns import INDICATORS, RUN_TABLES, rows_of
from madrob_console.common.errors import MadrobError
from madrob_console.common.file_locks import Hold
from madrob_console.common.files import atomic_write, atomic_write_in
from madrob_console.common.plain_files import opened_folder, read_all, refusal, stamp_of
from madrob_console.pages.plan_text import plan_json
from madrob_console.pages.related_runs import RelatedRuns, team_digest, team_runs
from madrob_console.pages.site_content import (
    PLAN,
    SiteContent,
    beside,
    condition_place,
    team_csv,
    team_place,
)
from madrob_console.pages.site_pages import (
    Links,
    condition_page,
    overview_page,
    plan_page,
    team_page,
)
from madrob_console.pages.standings_files import standings_csv, standings_json
from madrob_console.pages.templates import date_text
from madrob_console.referee.run_summary import RunSummary

SITE_MARK = ".madrob_site"

LOCK_FILE = ".madrob_site.lock"

_MARK = "<!-- madrob publish {} -->\n"
_PAGE_MARK = re.compile(rb"<!-- madrob publish [0-9a-f]* -->\n\Z")

_PLAN_DATA = "data/plan.json"
_FOLDERS = ("conditions", "data", "runs", "runs/*", "teams")
_REMOVED = (
    *(
        PLAN,
        _PLAN_DATA,
        "conditions/[0-9][0-9].html",
        "teams/[0-9]*.html",
        "teams/[0-9][0-9][0-9].csv",
    ),
    *(f"runs/*_{'[0-9a-f]' * 8}/{name}" for name in (REPORT_FILE, RESULT_FILE)),
)
"""Patterns of the files that not every site has."""

_LARGEST = 1_000_000_000  # bytes of a file


class SiteRefusedError(MadrobError):
    """The folder is not for a site: trying again does not help."""


class SourceUnreadError(MadrobError):
    """The source of one file cannot be read: the other files are written all the same."""


class SiteNotWrittenError(MadrobError):
    """The site cannot be written now: trying again may help."""


@dataclass(frozen=True, slots=True)
class SiteFile:
    """A file of the site.

    Attributes:
        name: its path in the site's folder.
        make: renders its content; may raise `SourceUnreadError`.
        key: digest of the sources of a page that takes long to render; a page with the same key in
            its mark is not rendered again. Empty = always rendered.
    """

    name: str
    make: Callable[[], bytes | str]
    key: str = ""


@dataclass(frozen=True, slots=True)
class Written:
    """Outcome of writing a site; `unread`: why files could not be made, to be retried next time."""

    files: int
    written: int
    removed: int
    unread: Sequence[str] = ()


@contextmanager
def site_held(folder: Path) -> Iterator[None]:
    """Lock the site before its runs are read, so that the newest ones are written last.

    Raises:
        SiteRefusedError: the folder holds other things.
        SiteNotWrittenError: the disk refuses, or another process writes there now.
    """
    _demand_site(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        hold = Hold(folder / LOCK_FILE)
    except BlockingIOError:
        raise SiteNotWrittenError(
            f"{folder}: another `madrob publish` writes there now; wait"
        ) from None
    except OSError as error:
        raise _refused(folder, error) from None
    with hold:
        yield


def write_site(
    folder: Path,
    files: Iterable[SiteFile],
    tell: Callable[[int, int], None] = lambda _done, _total: None,
) -> Written:
    """Write the changed files in the order given, and remove those that are no more.

    A reader of the site sees each file as it was or as it will be. Call it within `site_held`, with
    the files that others link to first; raises as `site_held`.
    """
    try:
        return _write(folder, list(files), tell)
    except OSError as error:
        raise _refused(folder, error) from None
    except SiteRefusedError:
        raise
    except MadrobError as error:
        raise SiteNotWrittenError(str(error)) from None


def _refused(folder: Path, error: OSError) -> SiteNotWrittenError:
    return SiteNotWrittenError(
        f"{folder}: not written ({error.strerror}); make room or name another folder"
    )


def _write(folder: Path, files: Sequence[SiteFile], tell: Callable[[int, int], None]) -> Written:
    for link in (path for name in _FOLDERS for path in folder.glob(name) if path.is_symlink()):
        raise SiteRefusedError(f"{link}: is a link, which leads out of the site; remove it")
    if not (folder / SITE_MARK).exists():
        atomic_write(folder / SITE_MARK, b"`madrob publish` writes and removes pages here.\n")
    there = (path for name in _REMOVED for path in folder.glob(name))
    plain = (path for path in there if stamp_of(str(path)) is not None)
    gone = {path.relative_to(folder).as_posix() for path in plain}
    written, unread = 0, []
    for number, file in enumerate(files):
        tell(number, len(files))
        try:
            written += _put(folder, file)
        except SourceUnreadError as error:  # what is there is older than its source
            unread.append(str(error))
        else:
            gone.discard(file.name)
    tell(len(files), len(files))
    removed = sum(_remove(folder, name) for name in sorted(gone))
    return Written(len(files), written, removed, unread)


def _put(folder: Path, file: SiteFile) -> bool:
    """Write a file, unless it is the same already; returns whether it was written."""
    there = _content(folder, file.name)
    is_page = file.name.endswith(".html")
    mark = _MARK.format(file.key) if is_page else ""
    if there is not None and is_page and not _PAGE_MARK.search(there):
        raise SiteRefusedError(f"{folder / file.name}: is not of `madrob publish`; move it away")
    if file.key and there is not None and there.endswith(mark.encode()):
        return False
    page = file.make()
    content = (page.encode() if isinstance(page, str) else page) + mark.encode()
    if content == there:
        return False
    *within, called = file.name.split("/")
    with opened_folder(folder, *within, make=True) as number:
        atomic_write_in(number, called, [content])
    return True


def _content(folder: Path, name: str) -> bytes | None:
    try:
        return read_all(folder / name, _LARGEST)
    except FileNotFoundError:
        return None


def _remove(folder: Path, name: str) -> bool:
    """Remove a file of the site, and the folders that it leaves empty; not somebody else's page."""
    if name.endswith(".html") and not _PAGE_MARK.search(_content(folder, name) or b""):
        return False
    *within, called = name.split("/")
    with suppress(FileNotFoundError), opened_folder(folder, *within) as number:
        os.unlink(called, dir_fd=number)
    while within:
        *within, called = within
        with suppress(OSError), opened_folder(folder, *within) as number:
            os.rmdir(called, dir_fd=number)  # unless something else is in it
    return True


_FIRST_FILES = {LOCK_FILE, f".{SITE_MARK}.part"}
"""A kill may leave them alone."""


def _demand_site(folder: Path) -> None:
    try:
        names = {*os.listdir(folder)} - _FIRST_FILES  # noqa: PTH208  of the names only
    except FileNotFoundError:
        return
    except OSError as error:
        raise SiteRefusedError(
            f"{folder}: no folder for a site ({error.strerror}); name another one"
        ) from None
    if names and SITE_MARK not in names:
        raise SiteRefusedError(
            f"{folder}: holds other things; name an empty folder, or a new one, for the site"
        )


def _run_tables(content: SiteContent) -> Mapping[str, bytes]:
    """The tables of the site's own runs, by path; each stored result is read once for all."""
    # they load numpy, which a refused folder does without
    from madrob_console.archive.stored_runs import stored_run
    from madrob_console.archive.table_rows import TableWriter

    tables = {f"data/{table.name}.csv": table for table in RUN_TABLES}
    of_teams = {team_csv(subject): INDICATORS for subject in content.of_team}
    files = {name: BytesIO() for name in (*tables, *of_teams)}
    with ExitStack() as stack:
        writers = {
            name: stack.enter_context(closing(TableWriter(files[name], table)))
            for name, table in {**tables, **of_teams}.items()
        }
        for run in content.with_result:
            with suppress(MadrobError):  # it changes just now: the next time it is there
                stored = stored_run(RunPath(Path(content.source(run))))
                shown_place = {"place": content.folder_of(run)}  # no path of this machine
                for name, table in {**tables, team_csv(run.subject): INDICATORS}.items():
                    rows = rows_of(table, stored)
                    cleaned = ({**row, **shown_place} if "place" in row else row for row in rows)
                    writers[name].write_rows(cleaned)
    return {name: file.getvalue() for name, file in files.items()}


def runs_without_report(content: SiteContent) -> list[RunSummary]:
    return [run for run in content.with_result if run.folder not in content.places]


def site_files(content: SiteContent) -> Iterator[SiteFile]:
    """All files, those that others link to first."""
    around = RelatedRuns()
    for run in content.with_result:
        yield from _of_run(content, run, around)
    yield from _tables(content)
    for subject in content.of_team:
        yield SiteFile(team_place(subject), partial(team_page, content, subject))
    for number in content.conditions:
        yield SiteFile(condition_place(number), partial(condition_page, content, number))
    if content.plan is not None:
        yield SiteFile(PLAN, partial(plan_page, content, content.plan))
    written = date_text(content.standings.made)
    yield SiteFile(INDEX_PAGE, partial(overview_page, content, written))


def _of_run(content: SiteContent, run: RunSummary, around: RelatedRuns) -> Iterator[SiteFile]:
    folder = content.source(run)
    if (page := content.places.get(run.folder)) is not None:
        sources = (
            RESULT_FILE,
            JOURNAL_FILE,
        )
        stamps = (stamp_of(f"{folder}/{name}") for name in sources)
        team = content.of_team[run.subject]
        pages = (_page_of(content, run, other) for other in team_runs(run, team))
        others = (team_digest(run, team), *pages)
        inputs = "\n".join(map(str, (content.software, _ways(content, run), *others, *stamps)))
        key = sha256(inputs.encode(errors="surrogateescape")).hexdigest()[:16]
        yield SiteFile(page, partial(_report, content, run, around), key)
    if stamp_of(f"{folder}/{RESULT_FILE}") is not None:
        yield SiteFile(f"{content.folder_of(run)}/{RESULT_FILE}", partial(_result, content, run))


def _page_of(content: SiteContent, run: RunSummary, other: RunSummary) -> str:
    place = content.places.get(other.folder)
    return "" if place is None else beside(content.places[run.folder], place)


def _ways(content: SiteContent, run: RunSummary) -> Markup:
    links = Links(content, content.places[run.folder])
    return links.ways(links.team(run.subject), links.condition(run.condition))


def _report(content: SiteContent, run: RunSummary, around: RelatedRuns) -> bytes:
    """Rendered from journal and recording: anybody may have written the report in the folder."""
    # they load numpy, SciPy and matplotlib, which a site without new reports does without
    from madrob_console.archive.pictures import pictures_of
    from madrob_console.archive.scored import score_once
    from madrob_console.pages.report import report_html

    folder, page = Path(content.source(run)), partial(_page_of, content, run)
    try:
        scored = score_once(folder)
        place = around.among(content.root, run.folder, content.runs, scored, page)
        place = replace(place, ways=_ways(content, run))
        return report_html(scored, content.software, place, pictures_of(folder, scored)).encode()
    except Exception as error:  # whatever it is, it is this run's and no other's
        raise SourceUnreadError(f"{run.folder}: no report on the site ({error})") from error


def _result(content: SiteContent, run: RunSummary) -> bytes:
    path = Path(content.source(run), RESULT_FILE)
    try:
        return read_all(path, LARGEST_RESULT)
    except OSError as error:  # it may be gone since the runs were listed
        why = f"cannot be read ({refusal(error)}); `madrob publish` takes it once it can be read"
        raise SourceUnreadError(f"{path}: {why}") from None


def _tables(content: SiteContent) -> Iterator[SiteFile]:
    standings, tables = content.standings, cache(partial(_run_tables, content))

    def csv(name: str) -> bytes:
        return tables()[name]

    names = (f"data/{table.name}.csv" for table in RUN_TABLES)
    for name in (*names, *map(team_csv, content.of_team)):
        yield SiteFile(name, partial(csv, name))
    yield SiteFile("data/standings.csv", partial(standings_csv, standings))
    yield SiteFile("data/standings.json", partial(standings_json, standings, content.software))
    if (plan := content.plan) is not None:
        inputs = (plan, standings.title, content.names, content.software)
        yield SiteFile(_PLAN_DATA, partial(plan_json, *inputs))
