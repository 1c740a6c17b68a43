"""What somebody types to see few of many runs."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping

from madrob_console.archive.history import RunSummary

_NUMBERS: Mapping[str, Callable[[RunSummary], int]] = {
    "subject": lambda run: run.subject,
    "sub": lambda run: run.subject,
    "cond": lambda run: run.condition,
    "run": lambda run: run.run_number,
}
_TEXTS: Mapping[str, Callable[[RunSummary], str]] = {
    "team": lambda run: run.team,
    "outcome": lambda run: f"{run.outcome_word} {run.outcome or ''}",
    "closed": lambda run: run.closing,
    "ruleset": lambda run: run.ruleset,
    "testbed": lambda run: run.testbed,
    "competition": lambda run: run.competition or "",
}
_FIELD = re.compile(r"([^\W\d]+):(.*)", re.DOTALL)
"""A word that looks at one field alone; a time of day, `14:28`, does not."""


def matches(run: RunSummary, text: str) -> bool:
    """Whether a run passes a filter: every word of the text occurs in the run's words.

    Capitals do not matter. `subject:3`, `run:2`, `cond:5` and `team:delft` look at that alone.
    """
    return all(_has(run, word) for word in text.casefold().split())


def filter_problem(text: str) -> str | None:
    """Why no run can pass a filter, in words: it names a field that no run has; None = one can."""
    found = (_FIELD.fullmatch(word) for word in text.casefold().split())
    known = (*_NUMBERS, *_TEXTS)
    unknown = next((word[1] for word in found if word and word[1] not in known), None)
    if unknown is None:
        return None
    return f"no field {unknown}: there are {', '.join(known)}"


def _has(run: RunSummary, word: str) -> bool:
    field, _, wanted = word.partition(":")
    if field in _NUMBERS:
        return not wanted or wanted.lstrip("0") == str(_NUMBERS[field](run))
    if field in _TEXTS:
        return wanted in _TEXTS[field](run).casefold()
    return word in run.words
