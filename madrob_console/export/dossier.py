"""One run in one zip, for who decides a protest: what was said, shown, measured and decided."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from madrob_console.archive.collection import collected
from madrob_console.archive.folders import (
    JOURNAL_FILE,
    RESULT_FILE,
    parse_folder_name,
    results_folder_of,
)
from madrob_console.archive.run_journal import UnusableJournalError, is_held, read_run_journal
from madrob_console.common.errors import MadrobError
from madrob_console.common.files import stamp_of
from madrob_console.common.formatting import utc_text
from madrob_console.common.names import REHEARSAL, is_rehearsal, terminal_safe
from madrob_console.export.pack import (
    EXPORTS_FOLDER,
    PROTESTS_FILE,
    WHOLE_BAGS,
    BagParts,
    Contents,
    Export,
    Rendering,
    pack,
)
from madrob_console.referee.records import Protest, ProtestEnd
from madrob_console.referee.run import Run
from madrob_console.referee.run_summary import RunSummary


def dossier_target(run: Path) -> Path:
    """Default zip: `exports/dossier_RUN.zip`; a rehearsal and practice are named before RUN."""
    run = run.absolute()
    known = _summary(run)
    kind = f"{REHEARSAL}_" * is_rehearsal(known.competition) + "practice_" * known.practice
    return results_folder_of(run) / EXPORTS_FOLDER / f"dossier_{kind}{run.name}.zip"


def export_dossier(
    run: Path,
    target: Path | None,
    *,
    report: Rendering,
    parts: BagParts = WHOLE_BAGS,
    tell_size: Callable[[int, int], None] = lambda _size, _evidence: None,
) -> Export:
    """Packs everything about one run.

    The same run gives the same zip, byte by byte.

    Args:
        run: its folder.
        target: the zip; None = `dossier_target`.
        report: as of `pack`.
        parts: of the recording.
        tell_size: as of `pack`.

    Raises:
        MadrobError: there is no such run, it goes on, or the zip cannot be written.
    """
    if not run.is_dir():
        raise MadrobError(f"{run}: no such run folder; name one with --run")
    if parse_folder_name(run.name) is None or not (run / JOURNAL_FILE).exists():
        raise MadrobError(f"{run}: is no run folder with a journal; name one with --run")
    if is_held(run / JOURNAL_FILE) and stamp_of(str(run / RESULT_FILE)) is None:
        raise MadrobError(f"{run}: this run goes on: make the dossier after it")
    known = _summary(run)
    kind = f"{REHEARSAL} " * is_rehearsal(known.competition)
    kind += "the PRACTICE run " if known.practice else ""
    problems: list[str] = []
    protests = _protests(run, problems)
    what = Contents(
        f"MADROB: dossier of {kind}{terminal_safe(run.name)}\nBegin with {PROTESTS_FILE}.",
        _stamp(run),
        parts,
        problems,
        first={PROTESTS_FILE: protests.encode()},
        dossier=True,
    )
    return pack({run: known}, what, target or dossier_target(run), report, tell_size=tell_size)


def _summary(run: Path) -> RunSummary:
    for found in collected([run]).runs:
        return found
    raise MadrobError(f"{run}: is behind a link: name the folder itself with --run")


def _stamp(run: Path) -> float:
    """Modification time of a generated file: that of its newest source, s since the epoch."""
    stamps = (stamp_of(str(run / name)) for name in (JOURNAL_FILE, RESULT_FILE))
    return max((stamp.modified / 1e9 for stamp in stamps if stamp is not None), default=0.0)


def _protests(run: Path, problems: list[str]) -> str:
    try:
        told = read_run_journal(run).run
    except (UnusableJournalError, OSError) as error:
        problems.append(f"{run.name}: its protests are not known: {error}")
        return f"The journal of {terminal_safe(run.name)} cannot be read: {error}\n"
    return "\n".join(protest_lines(told, run.name)) + "\n"


def protest_lines(run: Run, name: str) -> Iterator[str]:
    """All protests against a run, the decisions, and missing evidence."""
    setup = run.setup
    yield f"MADROB: protests against {terminal_safe(name)}"
    if setup is not None:
        whose = terminal_safe(f"subject {setup.subject} {setup.team}".rstrip())
        yield (
            f"Run {setup.run_number} of {whose}, "
            f"condition {setup.condition.number}{', PRACTICE' if setup.practice else ''}"
        )
    if not run.protests:
        yield ""
        yield "No protest was filed."
    for one in run.protests:
        yield ""
        yield from _protest_lines(one, run)
    if run.taken_back:
        yield ""
        yield "Taken back by the referee:"
        for back in run.taken_back:
            yield f"  {utc_text(back.time)}: " + terminal_safe(f"{back.words}: {back.reason}")
    if run.evidence is not None:
        yield ""
        yield f"Evidence: {terminal_safe(run.evidence.words)}"
        for remark in filter(None, (run.evidence_removed(utc_text), *run.evidence.remarks())):
            yield f"  {terminal_safe(remark)}"


def _protest_lines(one: Protest, run: Run) -> Iterator[str]:
    rows: Mapping[str, str] = {
        "by": one.team,
        "about": one.about_words(run.start),
        "the team says": one.text,
        "filed": utc_text(one.time) + (f", taken by {one.referee}" if one.referee else ""),
    }
    yield f"Protest {one.number}"
    for name, words in rows.items():
        if words:
            yield f"  {name + ':':<15}{terminal_safe(words)}"
    if (answer := one.answer) is None:
        yield "  OPEN: it waits for a decision"
        return
    decided = "withdrawn" if answer.end is ProtestEnd.WITHDRAWN else "decided"
    by = answer.referee or "the referee"
    yield f"  {answer.end.upper()}"
    yield f"  {'in words:':<15}{terminal_safe(answer.reason)}"
    yield f"  {decided + ':':<15}{utc_text(answer.time)}, {terminal_safe(by)}"
