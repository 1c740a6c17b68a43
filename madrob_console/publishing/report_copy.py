"""The report of a run as a page of the site: its links lead to what the site has, or nowhere."""

from __future__ import annotations

import posixpath
import re
from collections.abc import Mapping
from pathlib import Path

from madrob_console.archive.folders import LARGEST_REPORT, REPORT_FILE
from madrob_console.archive.report_links import led_elsewhere
from madrob_console.files.bounded import Stamp, read_bounded
from madrob_console.publishing.site_content import beside, report_beside
from madrob_console.publishing.site_folder import SourceUnreadError
from madrob_console.publishing.site_frame import NOTHING_ELSE
from madrob_console.report.markup import PAGE_BEGINS, Markup

_FILES = re.compile(
    r'<section id="files">.*?</section>\s*|<a href="#files">[^<]*</a>\s*'
    r'|<span class="beside">[^<]*</span>',
    re.DOTALL,
)


def stamp_to_copy(report: Path) -> Stamp | None:
    """The stamp of a report that the site can take; None = there is no such one.

    It can be read, has at most `LARGEST_REPORT`, and begins as our own pages do: another could
    swallow what the copy says to the browser.

    Args:
        report: its path.
    """
    try:
        begins, stamp = read_bounded(str(report), len(PAGE_BEGINS))
    except OSError:
        return None
    ours = begins == PAGE_BEGINS.encode()
    return stamp if ours and stamp[1] <= LARGEST_REPORT else None


def report_copy(report: str, folder: str, places: Mapping[str, str], around: Markup) -> str:
    """A report with other links.

    It loads nothing and runs no script, whatever is in it: it says so to the browser.

    Args:
        report: the page in the folder of its run.
        folder: of the run, as its summary has it.
        places: the pages of its team's runs on the site, by the run's folder.
        around: the ways to the pages around it.

    Raises:
        SourceUnreadError: it does not begin as our own pages do.
    """
    if not report.startswith(PAGE_BEGINS):
        raise SourceUnreadError(f"{folder}: its report is none; `madrob report` makes it anew")
    here = report_beside(places[folder])
    reports = {
        posixpath.normpath(f"{other}/{REPORT_FILE}"): report_beside(place)
        for other, place in places.items()
    }

    def led(target: str) -> str | None:
        place = reports.get(posixpath.normpath(f"{folder}/{target}"))
        return None if place is None else beside(here, place)

    text = led_elsewhere(_FILES.sub("", report), led)
    text = f"{PAGE_BEGINS}{NOTHING_ELSE}{text.removeprefix(PAGE_BEGINS)}"
    return re.sub("<body>", lambda _: f"<body>{around}", text, count=1)
