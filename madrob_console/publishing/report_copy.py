"""The report of a run as a page of the site: its links lead to what the site has, or nowhere."""

from __future__ import annotations

import html
import posixpath
import re
from collections.abc import Mapping
from pathlib import Path
from urllib.parse import quote, unquote

from madrob_console.archive.folders import REPORT_FILE
from madrob_console.files.bounded import Stamp, read_bounded
from madrob_console.publishing.site_content import beside, report_beside
from madrob_console.publishing.site_frame import NOTHING_ELSE
from madrob_console.report.markup import Markup

LARGEST_REPORT = 20_000_000
"""Of a report that is taken along, bytes."""

_LINK = re.compile(r'<a href="([^"#][^"]*)">')
_FILES = re.compile(
    r'<section id="files">.*?</section>\s*|<a href="#files">[^<]*</a>\s*', re.DOTALL
)


def stamp_to_copy(report: Path) -> Stamp | None:
    """The stamp of a report that the site can take; None = it is missing, unreadable or too large.

    Args:
        report: its path.
    """
    try:
        _, stamp = read_bounded(str(report), 1)
    except OSError:
        return None
    return stamp if stamp[1] <= LARGEST_REPORT else None


def report_copy(report: str, folder: str, places: Mapping[str, str], around: Markup) -> str:
    """A report with other links.

    It loads nothing and runs no script, whatever is in it: it says so to the browser.

    Args:
        report: the page in the folder of its run.
        folder: of the run, as its summary has it.
        places: the pages of its team's runs on the site, by the run's folder.
        around: the ways to the pages around it.
    """
    here = report_beside(places[folder])
    reports = {
        posixpath.normpath(f"{other}/{REPORT_FILE}"): report_beside(place)
        for other, place in places.items()
    }

    def led(found: re.Match[str]) -> str:
        target = posixpath.normpath(f"{folder}/{unquote(html.unescape(found[1]))}")
        place = reports.get(target)
        return "<a>" if place is None else f'<a href="{quote(beside(here, place))}">'

    text = _LINK.sub(led, _FILES.sub("", report))
    text = text.replace('<meta charset="utf-8">', f'<meta charset="utf-8">{NOTHING_ELSE}', 1)
    return re.sub("<body>", lambda _: f"<body>{around}", text, count=1)
