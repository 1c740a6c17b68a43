"""All runs of a team in one zip (protocol section 10, and what opens the files)."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec

from madrob_console.archive.folders import (
    JOURNAL_FILE,
    RESULT_FILE,
    parse_folder_name,
    run_folder_names,
)
from madrob_console.archive.result_document import SCHEMA_FILE, schema_text
from madrob_console.archive.result_reader import (
    ListedResult,
    UnusableResultError,
    read_result,
    read_setup,
)
from madrob_console.archive.unfinished import is_held
from madrob_console.errors import MadrobError
from madrob_console.export.foxglove_layout import LAYOUT_FILE, foxglove_layout
from madrob_console.export.readme import README_FILE, PackedRun, readme
from madrob_console.export.zip_file import Archive
from madrob_console.files.bounded import stamp_of
from madrob_console.files.whole import whole_file
from madrob_console.kinds import SourceKind
from madrob_console.messages.codec import TopicMapping
from madrob_console.names import terminal_safe

EXPORTS_FOLDER = "exports"
"""In the results folder, for zips that are given no other place."""

_LONGEST_TEAM = 40  # characters of it in a file name
_BAG = (".mcap", "metadata.yaml")
_PRACTICE = {SourceKind.SIMULATED: "SIMULATED, for practice", SourceKind.REPLAY: "a REPLAY"}


@dataclass(frozen=True, slots=True)
class Export:
    """A zip that was made.

    Attributes:
        path: of the zip.
        runs, files: how many are in it.
        size: of the zip, bytes.
        problems: what is not in it and why, in words.
    """

    path: Path
    runs: int
    files: int
    size: int
    problems: tuple[str, ...]


def export_team(
    root: Path,
    subject: int,
    mappings: Sequence[TopicMapping],
    now: float,
    *,
    target: Path | None = None,
    bags: bool = True,
) -> Export:
    """Pack all runs of a team; the one that goes on is left out and named.

    Args:
        root: the results folder.
        subject: the team's number.
        mappings: which topic carries which signal, for the layout.
        now: s since the epoch.
        target: the zip; in the folder `exports` of the results folder if not given.
        bags: whether with the recordings.

    Raises:
        MadrobError: the team has no runs, or the zip cannot be written.
    """
    runs, going_on = _runs_of(root, subject)
    known = {run: _Known.of(run) for run in runs}
    team = next((known[run].team for run in reversed(runs) if known[run].team), "")
    path = target or root / EXPORTS_FOLDER / file_name(subject, team, now)
    _make_folder(path.parent)
    with whole_file(path) as file, Archive(file) as archive:
        archive.problems += [
            f"{run.name}: this run goes on: export again after it" for run in going_on
        ]
        without = () if bags else _BAG
        packed = [
            PackedRun(run.name, terminal_safe(known[run].words), _add_run(archive, run, without))
            for run in runs
        ]
        archive.add(SCHEMA_FILE, schema_text(), now)
        layout = msgspec.json.format(msgspec.json.encode(foxglove_layout(mappings)), indent=2)
        archive.add(LAYOUT_FILE, layout + b"\n", now)
        problems = [terminal_safe(problem) for problem in archive.problems]
        title = terminal_safe(f"MADROB: runs of subject {subject} {team}".rstrip())
        archive.add(README_FILE, readme(title, packed, problems, bags=bags).encode(), now)
        archive.finish(now)
        size = file.tell()
    return Export(path, len(runs), archive.count, size, tuple(archive.problems))


def file_name(subject: int, team: str, now: float) -> str:
    """The name of a team's zip: `team_SSS_<team>_YYYYMMDD_HHMMSS.zip`, of letters and digits.

    Args:
        subject: the team's number.
        team: its name; what is neither letter nor digit becomes `_`.
        now: s since the epoch; stands in it in local time.
    """
    words = "".join(char if char.isalnum() or char == "-" else " " for char in team).split()
    name = "_".join(words)[:_LONGEST_TEAM].rstrip("_")
    date = time.strftime("%Y%m%d_%H%M%S", time.localtime(now))
    return "_".join(part for part in (f"team_{subject:03d}", name, date) if part) + ".zip"


@dataclass(frozen=True, slots=True)
class _Known:
    """What is known of a run without its recording."""

    team: str
    words: str

    @classmethod
    def of(cls, run: Path) -> _Known:
        folder = str(run)
        try:
            result, _ = read_result(folder)
        except FileNotFoundError:
            setup = read_setup(f"{folder}/{JOURNAL_FILE}")
            return cls("" if setup is None else setup.team, "no result, it was cut off")
        except UnusableResultError as problem:
            return cls("", str(problem))
        return cls(result.team, _outcome(result))


def _outcome(result: ListedResult) -> str:
    """How a run ended, for people."""
    final = "provisional" if result.closure is None else f"final, {result.closure.team_word}"
    practice = [_PRACTICE[kind] for kind in _PRACTICE if result.source == kind]
    condition = f"condition {result.condition_number}, run {result.run_number}"
    return ", ".join([f"{condition}: {result.outcome}", final, *practice])


def _runs_of(root: Path, subject: int) -> tuple[list[Path], list[Path]]:
    """The runs of a team, oldest first: those to be packed, and the one that goes on.

    Raises:
        MadrobError: there is none to be packed, or the folder cannot be read.
    """
    teams: dict[int, list[str]] = {}
    for name in run_folder_names(root):
        if (parsed := parse_folder_name(name)) is not None:
            teams.setdefault(parsed[0].subject, []).append(name)
    own = [root / n for n in sorted(teams.get(subject, ()), key=lambda name: (name[-15:], name))]
    going_on = [
        run
        for run in own
        if is_held(run / JOURNAL_FILE) and stamp_of(str(run / RESULT_FILE)) is None
    ]
    packed = [run for run in own if run not in going_on]
    if packed:
        return packed, going_on
    if going_on:
        raise MadrobError(f"the only run of team {subject} goes on: export it after its end")
    others = ", ".join(map(str, sorted(teams)))
    known = f"there are runs of team {others}" if teams else "it holds no runs at all"
    raise MadrobError(f"team {subject} has no runs in {root}: {known}; check --results")


def _add_run(archive: Archive, run: Path, without: tuple[str, ...]) -> list[str]:
    result = str(run / RESULT_FILE)
    before = stamp_of(result)
    added = archive.add_folder(run, without=without)
    if stamp_of(result) != before:
        archive.problems.append(f"{run.name}: its result changed meanwhile: export again")
    return added


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise MadrobError(
            f"{folder}: cannot be made ({error.strerror}): choose another --output"
        ) from None
