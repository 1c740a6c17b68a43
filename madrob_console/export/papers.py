"""What a zip says of itself: page, README, protests, and the columns of its csv files."""

from __future__ import annotations

import posixpath
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined, select_autoescape

from madrob_console.archive.folders import (
    FRAMES_FOLDER,
    INDEX_PAGE,
    JOURNAL_FILE,
    REPORT_FILE,
    RESULT_FILE,
)
from madrob_console.archive.result_document import SCHEMA_FILE
from madrob_console.archive.table_columns import RUN_TABLES, SAMPLE_TABLES, column_lines
from madrob_console.common.formatting import utc_text
from madrob_console.common.names import REHEARSAL, SourceKind, is_rehearsal, terminal_safe
from madrob_console.export.zip_file import SUMS_FILE
from madrob_console.referee.flags import FlagKind, serious
from madrob_console.referee.run import Run
from madrob_console.referee.run_summary import VOID, RunSummary
from recorder.bag import EVIDENCE, METADATA_FILE
from scoring.indicator_table import IndicatorName, unit_text
from scoring.result import DOUBTED

README_FILE = "README.txt"
COLUMNS_FILE = "COLUMNS.txt"
PROTESTS_FILE = "PROTESTS.txt"
"""Who protested about what, the decision, and missing evidence."""

_OF_ALL: Mapping[str, str] = {
    PROTESTS_FILE: "the protests and what was decided: begin here",
    INDEX_PAGE: "the runs with their values and reports: open it in any browser",
    **{f"{table.name}.csv": table.row for table in RUN_TABLES},
    COLUMNS_FILE: "the columns of all csv files, with units and meaning",
    SCHEMA_FILE: "the keys of result.json",
}
"""Meaning of the files that are not of one run."""

_OF_RUNS: Mapping[str, str] = {
    f"/{REPORT_FILE}": "the report: open it in any browser, also on a phone; it prints well",
    f"/{RESULT_FILE}": f"the result that counts; {SCHEMA_FILE} describes every key",
    "/result_issue_": "an earlier version of the result",
    f"/{JOURNAL_FILE}": "all that was done and said, a line each",
    f"/{FRAMES_FOLDER}/": "what the cameras saw at an instant that somebody asked for",
    "tables/": f"what the sensors said, as tables; see {COLUMNS_FILE}",
    EVIDENCE: "evidence: a bag of cameras and other topics; nothing is scored from it",
    ".mcap": "the recording (MCAP): for PlotJuggler, Foxglove, or ROS 2: ros2 bag play {folder}",
    METADATA_FILE: "makes a rosbag2 bag of the recording",
    ".csv": f"EUROBENCH's data file, in s since 1970; see {COLUMNS_FILE}",
    ".yaml": "EUROBENCH's file of an indicator (none in an aborted run), a condition or the run",
    "": "of the run's folder",
}
"""Meaning of a run's file by a part of its path; the first match counts."""

_PAPERS = Environment(
    loader=FileSystemLoader(Path(__file__).with_name("templates")),
    autoescape=select_autoescape(),
    undefined=StrictUndefined,
    finalize=lambda value: terminal_safe(str(value)),
    trim_blocks=True,
    keep_trailing_newline=True,
)


def _render(paper: str, **variables: object) -> bytes:
    return _PAPERS.get_template(paper).render(variables).encode()


def protests_text(runs: Sequence[tuple[Run | str, str]]) -> bytes:
    """All protests against some runs, the decisions, and missing evidence.

    Each run with its name; a text says why a run cannot be read.
    """
    return _render(PROTESTS_FILE, runs=runs, utc=utc_text)


def columns_text(*, samples: bool) -> bytes:
    """The legend of the csv files; `samples`: those of `madrob table samples` are there, too."""
    tables = (*RUN_TABLES, *(SAMPLE_TABLES if samples else ()))
    return _render(COLUMNS_FILE, lines=column_lines(tables))


def index_page(
    title: Sequence[str], runs: Mapping[Path, RunSummary], names: Collection[str]
) -> bytes:
    """A page with a row for each run; `names` are the files of the zip."""
    pages = {run: f"{run.name}/{REPORT_FILE}" for run in runs}
    return _render(
        INDEX_PAGE,
        title=title,
        runs=[
            (pages[run] if pages[run] in names else "", summary, _ended_words(summary))
            for run, summary in runs.items()
        ],
        files=_about_all(names),
        names=sorted(IndicatorName, key=lambda name: not name.spec.counts),
        unit_text=unit_text,
        doubted=DOUBTED,
    )


def _about_all(names: Collection[str]) -> list[tuple[str, str]]:
    return [(name, words) for name, words in _OF_ALL.items() if name in names]


def readme(
    title: Sequence[str],
    runs: Mapping[Path, RunSummary],
    names: Collection[str],
    other_names: Sequence[str],
    left_out: Sequence[str],
) -> bytes:
    """What is in a zip, what is not, and what opens each kind of file.

    `names` are the files of the zip, `other_names` the team's, with their runs.
    """
    examples: dict[str, str] = {}
    for name in names:
        if name not in _OF_ALL:
            examples.setdefault(next(part for part in _OF_RUNS if part in name), name)
    of_runs = [(examples[part], _OF_RUNS[part]) for part in _OF_RUNS if part in examples]
    about = (
        (posixpath.basename(name), words.format(folder=name.partition("/")[0]))
        for name, words in of_runs
    )
    return _render(
        README_FILE,
        title=title,
        runs=[(run.name, _run_words(summary)) for run, summary in runs.items()],
        other_names=other_names,
        left_out=left_out,
        sums=SUMS_FILE,
        about=[*_about_all(names), *about],
    )


_UNOFFICIAL = {SourceKind.SIMULATED: "PRACTICE, simulated", SourceKind.REPLAY: "a REPLAY"}


def _run_words(run: RunSummary) -> str:
    """Which run it is, how it ended and what it is worth, or why its result cannot be used."""
    words = _ended_words(run)
    if run.problem is None and run.outcome is not None:
        words = f"condition {run.condition}, run {run.run_number}: {words}"
    return "; ".join(filter(None, (words, run.testbed, run.run_id)))


def _ended_words(run: RunSummary) -> str:
    if run.problem is not None or run.outcome is None:
        return run.problem or "no result, it was cut off"
    final = f"final, {run.team_word}" if run.final else "not final"
    if run.protest_filed is not None:
        final = "NOT FINAL, a PROTEST is open"
    practice = "PRACTICE" if run.practice else ""
    void = f"{VOID} ({run.reason})" if run.voided else ""
    said_elsewhere = (FlagKind.VOID, FlagKind.PROTEST)  # by the words before them
    flagged = [flag.words for flag in serious(run.flags) if flag.kind not in said_elsewhere]
    unofficial = next(
        (words for kind, words in _UNOFFICIAL.items() if run.source == kind), practice
    )
    if is_rehearsal(run.competition):
        unofficial = f"{REHEARSAL} {practice}".rstrip()
    return ", ".join(filter(None, (run.outcome, void, final, unofficial, *flagged)))
