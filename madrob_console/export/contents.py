"""Which runs go into a zip: those of a team, or one for those who decide a protest."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

from madrob_console.archive.collection import (
    Collection,
    collected,
    demand_competition,
    the_competition,
)
from madrob_console.archive.folders import (
    JOURNAL_FILE,
    RESULT_FILE,
    parse_folder_name,
    results_folder_of,
)
from madrob_console.archive.history import of_competition
from madrob_console.archive.unfinished_runs import is_held
from madrob_console.common.errors import MadrobError
from madrob_console.common.formatting import listed
from madrob_console.common.names import REHEARSAL, is_rehearsal, terminal_safe
from madrob_console.common.plain_files import stamp_of
from madrob_console.export.pack import EXPORTS_FOLDER, Contents
from madrob_console.export.papers import PROTESTS_FILE
from madrob_console.referee.run_summary import RunSummary
from madrob_console.referee.team_list import TeamName

_LONGEST_TEAM = 40  # characters of it in a file name


def team_contents(
    collection: Collection,
    subject: int,
    now: float,
    *,
    competition: str | None = None,
    practice: bool = False,
    team: str = "",
) -> Contents:
    """All official runs of a team; a run that still goes on is left out and named.

    Args:
        collection: all runs; duplicates are packed once.
        subject: the team's number.
        now: s since the epoch.
        competition: of the team; None = its runs are of only one.
        practice: its practice runs instead.
        team: its name in the list of teams; empty = the name in its latest run.

    Raises:
        MadrobError: no such runs, or several competitions.
    """
    runs, left_out = _runs_of(collection, subject, competition, practice=practice)
    called = TeamName.of(team, (run.team for run in runs.values()))
    rehearsal = any(is_rehearsal(run.competition) for run in runs.values())
    kind = f"{REHEARSAL} " * rehearsal + ("PRACTICE runs" if practice else "runs")
    title = terminal_safe(f"MADROB: {kind} of subject {subject} {called.name}".rstrip())
    as_of = time.strftime("As of %Y-%m-%d %H:%M:%S UTC: all decisions until then", time.gmtime(now))
    named = (
        (other, [run.name for run, summary in runs.items() if summary.team == other])
        for other in called.others
    )
    name = f"{REHEARSAL}_" * rehearsal + file_name(subject, called.name, now, practice=practice)
    return Contents(
        runs,
        (title, as_of),
        now,
        collection.root / EXPORTS_FOLDER / name,
        problems=left_out,
        other_names=[terminal_safe(f"{other}: {listed(where)}") for other, where in named],
    )


def file_name(subject: int, team: str, now: float, *, practice: bool = False) -> str:
    """A team's zip: `team_SSS_<team>_YYYYMMDD_HHMMSS.zip`, local time; practice is named in it.

    In the team's name all but letters and digits becomes `_`. `now` is in s since the epoch.
    """
    words = "".join(char if char.isalnum() or char == "-" else " " for char in team).split()
    name = "_".join(words)[:_LONGEST_TEAM].rstrip("_")
    date = time.strftime("%Y%m%d_%H%M%S", time.localtime(now))
    kind = "practice" if practice else ""
    return "_".join(part for part in (f"team_{subject:03d}", name, kind, date) if part) + ".zip"


def _runs_of(
    collection: Collection, subject: int, competition: str | None, *, practice: bool
) -> tuple[dict[Path, RunSummary], list[str]]:
    """Runs to pack, oldest first, and in words what is left out and why."""
    teams: dict[int, list[RunSummary]] = {}
    for run in collection.runs:  # a folder keeps its name when its subject is corrected
        if not run.twin:
            teams.setdefault(run.subject, []).append(run)
    own = sorted(teams.get(subject, ()), key=lambda run: (run.folder[-15:], run.folder))
    of_kind = [run for run in own if run.practice == practice]
    chosen, unsure = _of_one_competition(of_kind, competition)
    left_out = [f"{run.folder}: does not say of which competition it is" for run in unsure]
    packed: dict[Path, RunSummary] = {}
    for run in chosen:
        place = collection.root / run.folder
        if place.name in {other.name for other in packed}:
            left_out.append(f"{place}: another run has this name: export its results folder alone")
        elif is_held(place / JOURNAL_FILE) and stamp_of(str(place / RESULT_FILE)) is None:
            left_out.append(f"{place.name}: this run goes on: export again after it")
        else:
            packed[place] = run
    if packed:
        return packed, left_out
    if left_out:
        raise MadrobError(f"the only run of subject {subject} goes on: export it after its end")
    if own:
        raise MadrobError(_all_of_the_other_kind(subject, len(own), practice=practice))
    others = ", ".join(map(str, sorted(teams)))
    there = f"there are runs of subject {others}" if teams else "it holds no runs at all"
    where = "here" if collection.root == Path() else f"in {collection.root}"
    raise MadrobError(f"subject {subject} has no runs {where}: {there}; name other folders")


def _of_one_competition(
    runs: Sequence[RunSummary], competition: str | None
) -> tuple[Sequence[RunSummary], Sequence[RunSummary]]:
    competitions = {run.competition for run in runs if run.competition is not None}
    if competition is not None and competitions:
        demand_competition(competition, competitions)
    title = the_competition(runs, competition)
    unsure = [run for run in runs if run.competition is None and len(competitions) > 1]
    return [run for run in of_competition(runs, title) if run not in unsure], unsure


def _all_of_the_other_kind(subject: int, count: int, *, practice: bool) -> str:
    if practice:
        return f"subject {subject} has no practice runs: leave --practice out ({count} official)"
    return f"subject {subject} has no official runs: --practice packs the others ({count})"


def dossier_contents(run: Path) -> Contents:
    """All about one run; the same run gives the same zip, byte by byte.

    Its zip is `exports/dossier_RUN.zip`; a rehearsal and practice are named before RUN.

    Raises:
        MadrobError: there is no such run, or it goes on.
    """
    if not run.is_dir():
        raise MadrobError(f"{run}: no such run folder; name one with --run")
    if parse_folder_name(run.name) is None or not (run / JOURNAL_FILE).exists():
        raise MadrobError(f"{run}: is no run folder with a journal; name one with --run")
    if is_held(run / JOURNAL_FILE) and stamp_of(str(run / RESULT_FILE)) is None:
        raise MadrobError(f"{run}: this run goes on: make the dossier after it")
    for summary in collected([run]).runs:
        kind = [REHEARSAL] * is_rehearsal(summary.competition)
        words = " ".join([*kind, *["the PRACTICE run"] * summary.practice, terminal_safe(run.name)])
        name = "_".join(["dossier", *kind, *["practice"] * summary.practice, run.name])
        return Contents(
            {run: summary},
            (f"MADROB: dossier of {words}", f"Begin with {PROTESTS_FILE}."),
            _stamp(run),
            results_folder_of(run) / EXPORTS_FOLDER / f"{name}.zip",
            dossier=True,
        )
    raise MadrobError(f"{run}: is behind a link: name the folder itself with --run")


def _stamp(run: Path) -> float:
    """Modification time of a generated file: that of its newest source, s since the epoch."""
    stamps = (stamp_of(str(run / name)) for name in (JOURNAL_FILE, RESULT_FILE))
    return max((stamp.modified / 1e9 for stamp in stamps if stamp is not None), default=0.0)
