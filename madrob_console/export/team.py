"""A team's runs in one zip: which runs, and what goes with them."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path

import msgspec

from madrob_console.archive.collection import Collection, demand_competition, the_competition
from madrob_console.archive.folders import JOURNAL_FILE, RESULT_FILE
from madrob_console.archive.history import of_competition
from madrob_console.archive.result_reader import read_sound_result
from madrob_console.archive.run_journal import is_held
from madrob_console.common.errors import MadrobError
from madrob_console.common.files import stamp_of
from madrob_console.common.formatting import listed
from madrob_console.common.names import REHEARSAL, is_rehearsal, terminal_safe
from madrob_console.export.foxglove_layout import LAYOUT_FILE, HandleZero, foxglove_layout
from madrob_console.export.pack import (
    EXPORTS_FOLDER,
    WHOLE_BAGS,
    BagParts,
    Contents,
    Export,
    Rendering,
    pack,
)
from madrob_console.messages.codec import TopicMapping
from madrob_console.referee.lists import TeamName
from madrob_console.referee.run_summary import RunSummary
from scoring.protocol import Thresholds

_LONGEST_TEAM = 40  # characters of it in a file name


def export_team(  # noqa: PLR0913  what is packed, and how
    found: Collection,
    subject: int,
    mappings: Sequence[TopicMapping],
    now: float,
    *,
    competition: str | None = None,
    practice: bool = False,
    target: Path | None = None,
    parts: BagParts = WHOLE_BAGS,
    team: str = "",
    thresholds: Thresholds | None = None,
    report: Rendering = lambda _run: ({}, []),
    tell: Callable[[int, int], None] = lambda _done, _total: None,
    tell_size: Callable[[int, int], None] = lambda _size, _evidence: None,
) -> Export:
    """Packs all official runs of a team; a run that still goes on is left out and named.

    Args:
        found: all runs; duplicates are packed once.
        subject: the team's number.
        mappings: for the layout.
        now: s since the epoch.
        competition: of the team; None = its runs are of only one.
        practice: pack its practice runs instead.
        target: the zip; None = in the folder `exports` of the results folder.
        parts: of the recordings.
        team: its name in the list of teams; empty = the name in its latest run.
        thresholds: the testbed's, for the layout; None = the protocol's.
        report: as of `pack`, where a report was made before.
        tell: as of `pack`.
        tell_size: as of `pack`.

    Raises:
        MadrobError: no such runs, several competitions, or the zip cannot be written.
    """
    runs, left_out = _runs_of(found, subject, competition, practice=practice)
    called = TeamName.of(team, (one.team for one in runs.values()))
    zero = next(filter(None, map(_zero, reversed(runs))), None)
    layout = foxglove_layout(mappings, thresholds, zero)
    rehearsal = any(is_rehearsal(one.competition) for one in runs.values())
    kind = f"{REHEARSAL} " * rehearsal + ("PRACTICE runs" if practice else "runs")
    title = terminal_safe(f"MADROB: {kind} of subject {subject} {called.name}".rstrip())
    as_of = time.strftime("As of %Y-%m-%d %H:%M:%S UTC: all decisions until then", time.gmtime(now))
    named = (
        (one, [run.name for run, found in runs.items() if found.team == one])
        for one in called.others
    )
    what = Contents(
        f"{title}\n{as_of}",
        now,
        parts,
        problems=left_out,
        other_names=[terminal_safe(f"{one}: {listed(where)}") for one, where in named],
        last={LAYOUT_FILE: msgspec.json.format(msgspec.json.encode(layout), indent=2) + b"\n"},
    )
    name = f"{REHEARSAL}_" * rehearsal + file_name(subject, called.name, now, practice=practice)
    path = target or found.root / EXPORTS_FOLDER / name
    return pack(runs, what, path, report, tell=tell, tell_size=tell_size)


def _zero(run: Path) -> HandleZero | None:
    result = read_sound_result(str(run))
    if result is None or result.zero_samples is None:
        return None
    whose = f"run {result.run_number} of condition {result.condition_number}"
    return HandleZero(result.zero_samples.mean, whose)


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
    found: Collection, subject: int, competition: str | None, *, practice: bool
) -> tuple[dict[Path, RunSummary], list[str]]:
    """Runs to pack, oldest first, and in words what is left out and why."""
    teams: dict[int, list[RunSummary]] = {}
    for run in found.runs:  # a folder keeps its name when its subject is corrected
        if not run.twin:
            teams.setdefault(run.subject, []).append(run)
    own = sorted(teams.get(subject, ()), key=lambda run: (run.folder[-15:], run.folder))
    of_kind = [run for run in own if run.practice == practice]
    chosen, unsure = _of_one_competition(of_kind, competition)
    left_out = [f"{run.folder}: does not say of which competition it is" for run in unsure]
    packed: dict[Path, RunSummary] = {}
    for run in chosen:
        place = found.root / run.folder
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
    where = "here" if found.root == Path() else f"in {found.root}"
    raise MadrobError(f"subject {subject} has no runs {where}: {there}; name other folders")


def _of_one_competition(
    runs: Sequence[RunSummary], competition: str | None
) -> tuple[Sequence[RunSummary], Sequence[RunSummary]]:
    known = {run.competition for run in runs if run.competition is not None}
    if competition is not None and known:
        demand_competition(competition, known)
    title = the_competition(runs, competition)
    unsure = [run for run in runs if run.competition is None and len(known) > 1]
    return [run for run in of_competition(runs, title) if run not in unsure], unsure


def _all_of_the_other_kind(subject: int, count: int, *, practice: bool) -> str:
    if practice:
        return f"subject {subject} has no practice runs: leave --practice out ({count} official)"
    return f"subject {subject} has no official runs: --practice packs the others ({count})"
