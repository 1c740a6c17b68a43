"""One run in one zip, for who decides a protest: what was said, shown, measured and decided."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

from madrob_console.archive.folders import (
    FRAMES_FOLDER,
    JOURNAL_FILE,
    REPORT_FILE,
    RESULT_FILE,
    parse_folder_name,
    results_folder_of,
)
from madrob_console.archive.result_document import SCHEMA_FILE, schema_text
from madrob_console.archive.run_journal import (
    UnusableJournalError,
    evidence_removed,
    is_held,
    read_run_journal,
)
from madrob_console.common.errors import MadrobError
from madrob_console.common.files import stamp_of, whole_file
from madrob_console.common.formatting import utc_text
from madrob_console.common.names import terminal_safe
from madrob_console.export.pack import (
    EXPORTS_FOLDER,
    README_FILE,
    Export,
    KnownRun,
    folder_for,
    packed_report,
)
from madrob_console.export.zip_file import (
    SUMS_FILE,
    WHOLE_BAGS,
    Archive,
    BagParts,
    PackedBag,
    add_run,
    size_of,
)
from madrob_console.referee.records import Protest, ProtestEnd
from madrob_console.referee.run import Run

PROTESTS_FILE = "PROTESTS.txt"
"""In the archive: who protested about what, the decision, and missing evidence."""

TABLES_FOLDER = "tables"
"""In the archive: folder with the samples as tables."""

_EVIDENCE = "_evidence_"
_ABOUT: Sequence[tuple[str, str]] = (
    (PROTESTS_FILE, "the protests and what was decided"),
    (REPORT_FILE, "the report: open it in any browser"),
    (JOURNAL_FILE, "all that was done and said, a line each"),
    (RESULT_FILE, f"the result that counts; {SCHEMA_FILE} describes every key"),
    ("result_issue_", "an earlier issue of the result"),
    ("/pictures/", "pictures of the cameras"),
    (f"/{FRAMES_FOLDER}/", "what the cameras saw at an instant that somebody asked for"),
    (f"{TABLES_FOLDER}/", "what the sensors said, as tables"),
    (_EVIDENCE, "evidence: what was recorded beside the testbed's own topics"),
    (".mcap", "the recording (rosbag2, MCAP): `ros2 bag play`, or foxglove.dev"),
    ("metadata.yaml", "lists the files of the recording"),
    (".csv", "EUROBENCH's data file"),
    (".yaml", "EUROBENCH's file of an indicator, a condition or the run"),
    (SCHEMA_FILE, "the keys of result.json"),
)
"""Meaning of a file by a part of its path; the first match counts."""


def dossier_target(run: Path) -> Path:
    """Default zip: `exports/dossier_RUN.zip`; of practice `exports/dossier_practice_RUN.zip`."""
    run = run.absolute()
    kind = "practice_" if KnownRun.of(run).practice else ""
    return results_folder_of(run) / EXPORTS_FOLDER / f"dossier_{kind}{run.name}.zip"


def check_dossier(run: Path) -> None:
    """Raises MadrobError if there is no run, or if it still goes on."""
    if not run.is_dir():
        raise MadrobError(f"{run}: no such run folder; name one with --run")
    if parse_folder_name(run.name) is None or not (run / JOURNAL_FILE).exists():
        raise MadrobError(f"{run}: is no run folder with a journal; name one with --run")
    if is_held(run / JOURNAL_FILE) and stamp_of(str(run / RESULT_FILE)) is None:
        raise MadrobError(f"{run}: this run goes on: make the dossier after it")


def export_dossier(
    run: Path,
    target: Path,
    *,
    made: Mapping[str, bytes] = MappingProxyType({}),
    tables: Path | None = None,
    problems: Sequence[str] = (),
    parts: BagParts = WHOLE_BAGS,
    tell_size: Callable[[int, int], None] = lambda _size, _evidence: None,
) -> Export:
    """Packs everything about one run.

    The same run gives the same zip, byte by byte.

    Args:
        run: its folder.
        target: the zip.
        made: its current report and the files that belong to it, by name.
        tables: a folder with its samples as tables; None = there are none.
        problems: why any of these is missing, in words.
        parts: of the recording.
        tell_size: told before packing: bytes in all, and bytes of evidence among them.

    Raises:
        MadrobError: there is no such run, it goes on, or the zip cannot be written.
    """
    check_dossier(run)
    at = _stamp(run)
    bag = PackedBag.of(run, parts)
    made = {**made, **packed_report(run, {run: (run.name, bag)}, made)}
    tell_size(*size_of(run, bag))
    before = stamp_of(str(run / RESULT_FILE))
    with folder_for(target), whole_file(target) as file, Archive(file) as archive:
        archive.problems += problems
        archive.add_file(PROTESTS_FILE, _protests(run, archive.problems).encode(), at)
        there = add_run(archive, run, run.name, bag, made)
        for name, data in made.items():
            if (called := f"{run.name}/{name}") not in there:
                archive.add_file(called, data, at)
        if tables is not None:
            archive.add_folder(tables, TABLES_FOLDER)
        archive.add_file(SCHEMA_FILE, schema_text(), at)
        if stamp_of(str(run / RESULT_FILE)) != before:
            archive.problems.append(f"{run.name}: its result changed meanwhile: export again")
        left_out = [] if parts.recording else ["the recording was left out on demand"]
        if bag.evidence_left_out and not parts.evidence:
            left_out.append("the evidence was left out on demand")
        if gone := evidence_removed(run):
            left_out.append(f"the evidence was {gone}")
        archive.add_file(README_FILE, _readme(run, archive, left_out).encode(), at)
        archive.finish(at)
        size = file.tell()
    said = tuple(archive.problems), tuple(archive.renamed)
    return Export(target, 1, archive.count, size, *said)


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


def _readme(run: Path, archive: Archive, left_out: Sequence[str]) -> str:
    known = KnownRun.of(run)
    kind = "the PRACTICE run " if known.practice else ""
    lines = [
        f"MADROB: dossier of {kind}{terminal_safe(run.name)}",
        terminal_safe(known.words),
        f"Begin with {PROTESTS_FILE}.",
        "",
    ]
    if missing := [*left_out, *archive.problems]:
        lines += ["NOT IN THIS ARCHIVE", *(f"  {terminal_safe(one)}" for one in missing), ""]
    if archive.renamed:
        lines += ["UNDER ANOTHER NAME", *(f"  {terminal_safe(one)}" for one in archive.renamed), ""]
    lines += ["IS EVERYTHING WHOLE?", f"  sha256sum -c {SUMS_FILE}", "", "FILES, WITH SHA-256"]
    for digest, name in archive.sums:
        lines += [f"  {terminal_safe(name)}: {_about(name)}", f"    {digest}"]
    return "\n".join(lines) + "\n"


def _about(name: str) -> str:
    return next((words for part, words in _ABOUT if part in name), "of the run's folder")
