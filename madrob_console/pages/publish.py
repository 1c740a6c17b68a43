"""Writes a competition's site: what has changed, and nothing of somebody else's."""

from __future__ import annotations

import os
import re
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass, replace
from functools import cache, cached_property, lru_cache, partial
from hashlib import sha256
from io import BytesIO
from itertools import zip_longest
from pathlib import Path
from tempfile import TemporaryFile
from typing import BinaryIO

import msgspec
from markupsafe import Markup

from madrob_console.archive.folders import (
    INDEX_PAGE,
    JOURNAL_FILE,
    PICTURES_FOLDER,
    PICTURES_INDEX,
    RESULT_FILE,
    FoundRun,
)
from madrob_console.archive.history import RunSummary
from madrob_console.archive.result_reader import LARGEST_RESULT
from madrob_console.common.errors import MadrobError
from madrob_console.common.files import (
    Hold,
    atomic_write,
    atomic_write_in,
    open_plain,
    opened_folder,
    read_all,
    refusal,
    stamp_of,
)
from madrob_console.export.table_columns import RUN_TABLES, TidyTable
from madrob_console.pages.competition import plan_json
from madrob_console.pages.outputs import standings_csv, standings_document, standings_json
from madrob_console.pages.site_content import (
    PLAN,
    SiteContent,
    beside,
    condition_place,
    team_place,
)
from madrob_console.pages.site_pages import (
    Links,
    condition_page,
    overview_page,
    plan_page,
    team_page,
)
from madrob_console.pages.surroundings import Surroundings, team_digest, team_runs
from madrob_console.pages.templates import date_text

# The folder of a site: files that change are written whole, others stay as they are.
#
# A list beside the pages says what was written and what each file was made of. By this list pages
# of deleted runs are removed, and never a file of somebody else.


MANIFEST_FILE = ".madrob_site.json"

LOCK_FILE = ".madrob_site.lock"

_LARGEST = 100_000_000  # bytes of the list: some 1,000,000 files
_PART = 1 << 16  # bytes of a file that are in memory at once
_NAME = re.compile(r"(?:[A-Za-z0-9_-][A-Za-z0-9._-]*/)*[A-Za-z0-9_-][A-Za-z0-9._-]*")


class SiteRefusedError(MadrobError):
    """The folder is not for a site: nothing was written, and trying again does not help."""


class SourceUnreadError(MadrobError):
    """The source of one file cannot be read: the other files are written all the same."""


class SiteNotWrittenError(MadrobError):
    """The site cannot be written now: trying again may help."""


@dataclass(frozen=True, slots=True)
class SiteFile:
    """A file of the site.

    Attributes:
        name: its path in the site's folder.
        key: of its sources: the same key, the same content.
        make: its content, or an open file with it, which is closed then; called only if the key
            changed; may raise `SourceUnreadError`.
        whole: whether no source was missing; else it is made again the next time.
    """

    name: str
    key: str
    make: Callable[[], bytes | BinaryIO]
    whole: Callable[[], bool] = lambda: True

    @classmethod
    def of(cls, name: str, text: str, key: str | None = None) -> SiteFile:
        """A finished page.

        `key` is the text less what alone is no reason to write it again; None = all of it.
        """
        return cls(name, _digest(text if key is None else key), text.encode)


class _Manifest(msgspec.Struct, frozen=True):
    """Digest of key and stamp of each file; empty while it is written."""

    files: dict[str, str] = {}


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
        return _write(folder, files, tell)
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


def _write(folder: Path, files: Iterable[SiteFile], tell: Callable[[int, int], None]) -> Written:
    before = _known(folder)  # in the end what is to be removed
    _refuse_links(folder, before)
    known: dict[str, str] = {}
    changed: deque[SiteFile] = deque()
    for file in files:  # of an unchanged one no more than this is kept in memory
        was = before.pop(file.name, None)
        if was is None and (folder / file.name).exists():
            raise SiteRefusedError(
                f"{folder / file.name}: is not of `madrob publish`; move it away"
            )
        known[file.name] = was or ""
        if was != _as_written(folder, file):
            changed.append(file)
    _refuse_links(folder, (file.name for file in changed))
    written, unread = 0, []
    if changed or before:  # first whose the files are: one that is cut off leaves none to nobody
        known.update((file.name, "") for file in changed)
        _note(folder, {**before, **known})
        total = len(changed)
        while changed:  # nor of a written one
            tell(total - len(changed), total)
            file = changed.popleft()
            try:
                written += _put(folder, file.name, file.make())
            except SourceUnreadError as error:
                unread.append(str(error))
                _remove(folder, file.name)  # it is older than what it is made of
                continue
            known[file.name] = _as_written(folder, file) if file.whole() else ""
        tell(total, total)
        for name in before:
            _remove(folder, name)
        _note(folder, known)
    return Written(len(known), written, len(before), unread)


def _as_written(folder: Path, file: SiteFile) -> str:
    """What the list says of a file that was made of this key and lies there as it was written."""
    return _digest(f"{file.key} {stamp_of(f'{folder}/{file.name}')}")


def _digest(text: str) -> str:
    return sha256(text.encode(errors="surrogateescape")).hexdigest()[:16]


def _refuse_links(folder: Path, names: Iterable[str]) -> None:
    """Refuse links, which could lead a page, or its removal, out of the site."""
    within: set[str] = set()
    for name in names:
        while (name := name.rpartition("/")[0]) and name not in within:
            within.add(name)
    for parent in sorted(within):
        if os.path.islink(f"{folder}/{parent}"):  # noqa: PTH114  of a hundred thousand
            raise SiteRefusedError(
                f"{folder / parent}: is a link, which leads out of the site; remove it"
            )


def _put(folder: Path, name: str, content: bytes | BinaryIO) -> bool:
    """Write a file, unless it is the same already; returns whether it was written."""
    with BytesIO(content) if isinstance(content, bytes) else content as data:
        with suppress(OSError), os.fdopen(open_plain(folder / name), "rb") as there:
            if all(one == other for one, other in zip_longest(_parts(there), _parts(data))):
                return False
        *within, called = name.split("/")
        with opened_folder(folder, *within, make=True) as number:
            atomic_write_in(number, called, _parts(data))
    return True


def _parts(file: BinaryIO) -> Iterator[bytes]:
    file.seek(0)
    return iter(partial(file.read, _PART), b"")


def _demand_site(folder: Path) -> None:
    try:
        there = next(folder.iterdir(), None) is not None
    except FileNotFoundError:
        return
    except OSError as error:
        raise SiteRefusedError(
            f"{folder}: no folder for a site ({error.strerror}); name another one"
        ) from None
    if there and stamp_of(f"{folder}/{MANIFEST_FILE}") is None:
        left = [path.name for path in folder.iterdir() if path.name != LOCK_FILE]
        if left:
            raise SiteRefusedError(
                f"{folder}: holds other things; name an empty folder, or a new one, for the site"
            )


def _known(folder: Path) -> dict[str, str]:
    path = folder / MANIFEST_FILE
    try:
        found = msgspec.json.decode(read_all(path, _LARGEST), type=_Manifest)
    except FileNotFoundError:
        return {}
    except (OSError, msgspec.MsgspecError, ValueError):
        raise SiteRefusedError(
            f"{path}: cannot be read, so that nobody knows whose files lie beside it: remove the "
            "folder, all of it is made again"
        ) from None
    return {name: one for name, one in found.files.items() if _NAME.fullmatch(name)}


def _note(folder: Path, files: dict[str, str]) -> None:
    atomic_write(folder / MANIFEST_FILE, msgspec.json.encode(_Manifest(files)) + b"\n")


def _remove(folder: Path, name: str) -> None:
    """Remove a file, and the folders that it leaves empty."""
    *within, called = name.split("/")
    with suppress(FileNotFoundError), opened_folder(folder, *within) as number:
        os.unlink(called, dir_fd=number)
    while within:
        *within, called = within
        with suppress(OSError), opened_folder(folder, *within) as number:
            os.rmdir(called, dir_fd=number)  # unless something else is in it


# The tables for programs of a site: of its own runs only.


class RunTables:
    """Makes the tables from the stored results, which are read once for all tables."""

    def __init__(self, content: SiteContent) -> None:
        self.whole = True
        self._content = content
        self._files: dict[str, BinaryIO] = {}

    @cached_property
    def key(self) -> str:
        content, told = self._content, sha256(self._content.software.encode())
        for run in content.with_result:
            stamp = stamp_of(f"{content.source(run)}/{RESULT_FILE}")
            told.update(os.fsencode(f"{run.folder} {stamp} {run.voided}\n"))
        return told.hexdigest()

    def csv(self, table: TidyTable) -> BinaryIO:
        if table.name not in self._files:
            self._write()
        return self._files.pop(table.name)

    def _write(self) -> None:
        # they load numpy, which a site without new runs does without
        from madrob_console.archive.result_files import stored_run
        from madrob_console.export.read_runs import read_rows, unpacked_rows
        from madrob_console.export.rows import TableWriter

        self._files = {table.name: TemporaryFile() for table in RUN_TABLES}  # noqa: SIM115
        with ExitStack() as stack:
            writers = [
                stack.enter_context(closing(TableWriter(file, table)))
                for table, file in zip(RUN_TABLES, self._files.values(), strict=True)
            ]
            read = lru_cache(maxsize=1)(stored_run)  # of all tables, which go on together
            rows = [read_rows(table, self._found, read) for table in RUN_TABLES]
            for run, *found in zip(self._content.with_result, *rows, strict=True):
                whole = [packed for packed in found if isinstance(packed, bytes)]
                if len(whole) < len(found):
                    self.whole = False  # it changes just now: the next time it is there
                    continue
                place = self._content.folder_of(run)  # no path of this machine
                for writer, table, packed in zip(writers, RUN_TABLES, whole, strict=True):
                    writer.write_rows(unpacked_rows(table, packed, place))

    @property
    def _found(self) -> Iterator[FoundRun]:
        within = cache(Path)
        for run in self._content.with_result:
            folder, name = os.path.split(self._content.source(run))
            yield FoundRun(within(folder), name)


def runs_without_report(content: SiteContent) -> list[RunSummary]:
    return [run for run in content.with_result if run.folder not in content.places]


def site_files(content: SiteContent) -> Iterator[SiteFile]:
    """All files, those that others link to first."""
    around = Surroundings()
    for run in content.with_result:
        yield from _of_run(content, run, around)
    yield from _tables(content)
    for subject in content.of_team:
        yield SiteFile.of(team_place(subject), team_page(content, subject))
    for number in content.conditions:
        yield SiteFile.of(condition_place(number), condition_page(content, number))
    if content.plan is not None:
        yield SiteFile.of(PLAN, plan_page(content, content.plan))
    written = date_text(content.standings.made)
    # that it is later now is alone no reason to write it again
    pages = overview_page(content, written), overview_page(content, "")
    yield SiteFile.of(INDEX_PAGE, *pages)


def _of_run(content: SiteContent, run: RunSummary, around: Surroundings) -> Iterator[SiteFile]:
    folder = content.source(run)
    if (page := content.places.get(run.folder)) is not None:
        sources = (RESULT_FILE, JOURNAL_FILE, f"{PICTURES_FOLDER}/{PICTURES_INDEX}")
        stamps = (stamp_of(f"{folder}/{name}") for name in sources)
        team = content.of_team[run.subject]
        pages = (_page_of(content, run, one) for one in team_runs(run, team))
        others = (team_digest(run, team), *pages)
        key = _key(content.software, _ways(content, run), *others, *stamps)
        yield SiteFile(page, key, partial(_report, content, run, around))
    stamp = stamp_of(f"{folder}/{RESULT_FILE}")
    if stamp is not None:
        place = f"{content.folder_of(run)}/{RESULT_FILE}"
        yield SiteFile(place, _key(stamp), partial(_result, content, run))


def _page_of(content: SiteContent, run: RunSummary, other: RunSummary) -> str:
    place = content.places.get(other.folder)
    return "" if place is None else beside(content.places[run.folder], place)


def _ways(content: SiteContent, run: RunSummary) -> Markup:
    links = Links(content, content.places[run.folder])
    return links.ways(links.team(run.subject), links.condition(run.condition))


def _report(content: SiteContent, run: RunSummary, around: Surroundings) -> bytes:
    """Rendered from journal and recording: anybody may have written the report in the folder."""
    # they load numpy, SciPy and matplotlib, which a site without new reports does without
    from madrob_console.archive.run_pictures import stored_pictures
    from madrob_console.archive.scored import score_once
    from madrob_console.pages.report import report_html

    folder, page = Path(content.source(run)), partial(_page_of, content, run)
    try:
        scored = score_once(folder)
        place = around.among(content.root, run.folder, content.runs, scored, page)
        place = replace(place, ways=_ways(content, run))
        return report_html(scored, content.software, place, stored_pictures(folder)).encode()
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
    tables = RunTables(content)
    for table in RUN_TABLES:
        make = partial(tables.csv, table)
        yield SiteFile(f"data/{table.name}.csv", tables.key, make, lambda: tables.whole)
    yield SiteFile.of("data/standings.csv", standings_csv(content.standings))
    undated = replace(content.standings, made=0.0)
    told = msgspec.json.encode(standings_document(undated, content.software))
    write = partial(standings_json, content.standings, content.software)
    yield SiteFile("data/standings.json", sha256(told).hexdigest(), write)
    if content.plan is not None:
        competition = content.standings.title
        made = plan_json(content.plan, competition, content.names, content.software)
        yield SiteFile.of("data/plan.json", made.decode())


def _key(*of: object) -> str:
    return _digest("\n".join(map(str, of)))
