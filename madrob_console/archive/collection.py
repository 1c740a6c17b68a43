"""The runs of several results folders as one list, each once, and the filter over it."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from msgspec.structs import replace

from madrob_console.archive.folders import RESULT_FILE, named_by_recording, parse_folder_name
from madrob_console.archive.history import History, mark_duplicates
from madrob_console.archive.run_paths import RunPath, listed_at, with_name
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import terminal_safe
from madrob_console.common.plain_files import refusal
from madrob_console.referee.run_summary import RunSummary

NO_RUN = "holds no run: name folders with runs"
LEFT_OUT_LINK = "is behind a link and left out: name the folder itself"


class Unlisted(NamedTuple):
    """A path, or what lies below it, that no list shows; `why` also says what to do."""

    place: str
    why: str


@dataclass(frozen=True, slots=True)
class Collection:
    """The runs at some paths, oldest first; their folders are relative to `root`."""

    root: Path
    runs: tuple[RunSummary, ...]
    unlisted: tuple[Unlisted, ...] = ()

    @property
    def competitions(self) -> frozenset[str]:
        return frozenset(run.competition for run in self.runs if run.competition is not None)

    @property
    def twins(self) -> tuple[str, ...]:
        return tuple(run.why_twin for run in self.runs if run.twin)


def collected(paths: Sequence[Path], testbed: str | None = None) -> Collection:
    """The runs at some paths, at any depth; what cannot be read does not stop the rest."""
    of_root: dict[Path, set[str]] = {}
    unlisted = []
    for path in paths:
        if not path.exists():
            raise MadrobError(f"{path}: no such folder; name a folder with runs")
        if path.is_file():
            unlisted.append(Unlisted(str(path), "is no run folder: name folders with runs"))
    for entry in listed_at(path for path in paths if not path.is_file()):
        if parse_folder_name(entry.path.name) is not None:
            root, name = entry.place
            of_root.setdefault(root, set()).add(name)
        else:
            unlisted.append(Unlisted(entry.name, _why_unlisted(entry)))
    alone = len(of_root) == 1 and [*map(with_name, paths)] == list(of_root)
    runs: list[RunSummary] = []
    for root in list(of_root):
        names = of_root.pop(root)
        try:
            history = History(root).refresh()
        except MadrobError as error:
            unlisted.append(Unlisted(str(root), str(error).removeprefix(f"{root}: ")))
            continue
        runs_of_root = {run.folder: run for run in history if run.folder in names}
        unlisted += [
            Unlisted(str(root / name), LEFT_OUT_LINK) for name in sorted(names - {*runs_of_root})
        ]
        if alone:
            runs += runs_of_root.values()
            continue
        within = str(root / "_")[:-1]  # joining a hundred thousand Paths takes too long
        runs += [
            replace(run, folder=f"{within}{name}", twin="") for name, run in runs_of_root.items()
        ]
    wanted = runs if testbed is None else of_testbed(runs, testbed)
    ordered = sorted(wanted, key=lambda run: (run.started, run.folder))
    root = with_name(paths[0]) if alone else Path()
    return Collection(root, mark_duplicates(ordered), tuple(unlisted))


def collected_in(results: Path, testbed: str | None = None) -> Collection:
    runs = History(results).refresh()
    return Collection(results, runs if testbed is None else tuple(of_testbed(runs, testbed)))


def of_testbed(runs: Iterable[RunSummary], name: str) -> list[RunSummary]:
    every = list(runs)
    _demand_existing("--testbed-name", name, {run.testbed for run in every})
    return [run for run in every if run.testbed == name]


def demand_competition(name: str, competitions: Iterable[str]) -> None:
    _demand_existing("--competition", name, competitions)


def the_competition(runs: Iterable[RunSummary], name: str | None) -> str | None:
    """The chosen competition, else the only one; MadrobError if several and nobody chose.

    A team is competition and subject (protocol section 2). None = no run says.
    """
    if name is not None:
        return name
    names = {run.competition for run in runs if run.competition is not None}
    if len(names) > 1:
        raise MadrobError(
            f"runs of {len(names)} competitions are here: {_listed(names)}: choose one by "
            "--competition NAME"
        )
    return next(iter(names), None)


def _demand_existing(option: str, name: str, existing: Iterable[str]) -> None:
    names = {*existing}
    if name not in names:
        there = _listed(names) or "none"
        raise MadrobError(f"{option} '{terminal_safe(name)}': no such runs; there are {there}")


def _listed(names: Iterable[str]) -> str:
    return ", ".join(f"'{terminal_safe(name)}'" for name in sorted(names))


def _why_unlisted(run: RunPath) -> str:
    try:
        names = os.listdir(run.path)  # noqa: PTH208  of the names only
    except OSError as error:
        return f"cannot be read ({refusal(error)}): check its permissions"
    if RESULT_FILE in names and (called := named_by_recording(names)) is not None:
        return f"is not called like a run and left out: call it {called} again"
    if run.prefix or any(name.endswith((".mcap", ".db3")) for name in names):
        return f"has no {RESULT_FILE} of a run folder: name folders with runs"
    return NO_RUN


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
"""A word for one field alone; a time of day, `14:28`, does not match."""


def matches(run: RunSummary, text: str) -> bool:
    """Whether every word of the text is in the run's words; capitals do not matter.

    `subject:3`, `run:2`, `cond:5` and `team:delft` look at that field alone.
    """
    return all(_has(run, word) for word in text.casefold().split())


def filter_problem(text: str) -> str | None:
    """Why no run can pass a filter: it names an unknown field."""
    matches = (_FIELD.fullmatch(word) for word in text.casefold().split())
    fields = (*_NUMBERS, *_TEXTS)
    unknown = next((word[1] for word in matches if word and word[1] not in fields), None)
    if unknown is None:
        return None
    return f"no field {unknown}: there are {', '.join(fields)}"


def _has(run: RunSummary, word: str) -> bool:
    field, _, wanted = word.partition(":")
    if field in _NUMBERS:
        return not wanted or wanted.lstrip("0") == str(_NUMBERS[field](run))
    if field in _TEXTS:
        return wanted in _TEXTS[field](run).casefold()
    return word in run.words
