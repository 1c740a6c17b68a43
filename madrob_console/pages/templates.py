"""The templates of all pages: what they print is escaped, and a name that they lack is an error."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from urllib.parse import quote

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from madrob_console.common.names import terminal_safe
from madrob_console.pages.site_drawings import FAILED
from madrob_console.referee.acts.during import RULED
from madrob_console.referee.run_summary import condition_words
from scoring.indicator_table import unit_text
from scoring.protocol import Condition
from scoring.result import uncertainty_text, value_text

NONE = "-"

NOTHING = Markup()


def render(template: str, **variables: object) -> Markup:
    """A template filled in; text from anywhere is escaped and without control characters."""
    return Markup(TEMPLATES.get_template(template).render(variables))


def path_link(target: str, words: str) -> Markup:
    """A link to a file beside a page, by its relative path."""
    return Markup('<a href="{}">{}</a>').format(quote(target), words)


def since(time: float | None, start: float) -> str:
    """A time from the start, s with two decimals, as sampling has it; a dash for none."""
    return NONE if time is None else f"{time - start:.2f}"


def task_text(condition: Condition) -> str:
    way = "pull" if condition.must_pull else "push"
    start, destination = condition.starting_side.upper(), condition.destination_side.upper()
    return f"{way} the door, from side {start} to side {destination}"


def date_text(epoch: float) -> str:
    """Local date and time with the offset from UTC."""
    try:
        local = datetime.fromtimestamp(epoch, tz=UTC).astimezone()
    except (OverflowError, OSError, ValueError):
        return f"{epoch:.3f} s since 1970"
    return f"{local:%Y-%m-%d %H:%M:%S} (UTC{local:%z})"


def _printed(value: object) -> object:
    plain = isinstance(value, str) and not isinstance(value, Markup)
    return terminal_safe(str(value)) if plain else value


_FILTERS: Mapping[str, Any] = {
    "date": date_text,
    "path": quote,
    "since": since,
    "task": task_text,
}
_GLOBALS: Mapping[str, Any] = {
    "condition_words": condition_words,
    "failed_mark": FAILED,
    "ruled": RULED,
    "uncertainty_text": uncertainty_text,
    "unit_text": unit_text,
    "value_text": value_text,
}


def _environment() -> Environment:
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).with_name("templates")),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=_printed,
    )
    environment.filters.update(_FILTERS)
    environment.globals.update(_GLOBALS)
    return environment


TEMPLATES = _environment()
