"""A run's report as one HTML page without scripts, and without anything from elsewhere."""

from __future__ import annotations

from collections.abc import Iterator

from madrob_console.archive.folders import RESULT_FILE
from madrob_console.archive.history import OUTCOME_WORDS, VOID
from madrob_console.archive.scored import Scored
from madrob_console.cameras.run_pictures import NO_PICTURES, RunPictures
from madrob_console.referee.flags import FlagKind, undecided
from madrob_console.report import sections
from madrob_console.report.camera_pictures import anchors, pictures
from madrob_console.report.explanations import (
    INVALID,
    PRACTICE,
    UNOFFICIAL,
    VOIDED,
    date_text,
    since,
    task_text,
)
from madrob_console.report.markup import Content, Markup, element, link, page, said
from madrob_console.report.meanings import definitions
from madrob_console.report.shared_sections import issues, steps
from madrob_console.report.surroundings import NOWHERE, PagePlace
from madrob_console.report.ways import files, other_runs
from madrob_console.report.where_time_went import phases


def report_html(
    scored: Scored,
    software: str = "",
    place: PagePlace = NOWHERE,
    seen: RunPictures = NO_PICTURES,
) -> str:
    """The report of a run.

    The same run in the same place gives the same text.

    Args:
        scored: the run, its result and its data.
        software: the version that makes the report; empty = the one that recorded the run.
        place: what it can link to and compare with.
        seen: what the cameras saw.
    """
    from madrob_console.report.pictures import figures  # it loads matplotlib

    run, result = scored.run, scored.result
    happened = sections.events(result, anchors(seen))
    measured = element("div", steps(result.steps, result.start), happened, class_="pair")
    parts: tuple[tuple[str, str, Content], ...] = (
        ("protests", "protests", sections.protests(run)),
        ("time", "time", phases(scored, place)),
        ("indicators", "indicators", sections.indicators(result)),
        ("steps", "steps and events", measured),
        ("pictures", "pictures", pictures(seen, beside=bool(place.files))),
        ("figures", "figures", figures(scored)),
        ("decisions", "decisions", sections.decisions(run)),
        ("issues", "issued again", issues(run.reissues, place.earlier)),
        ("word", "the team's word", sections.team_word(run)),
        ("setup", "set-up", sections.set_up(scored.record, result)),
        ("quality", "data quality", sections.data_quality(run, result)),
        ("explained", "explanations", definitions(result)),
        ("runs", "other runs", other_runs(place)),
        ("files", "files", files(place)),
    )
    shown = [(name, title, part) for name, title, part in parts if part]
    contents = [link(f"#{name}", title) for name, title, _ in shown]
    return page(
        _title(scored),
        place.ways,
        _top(scored),
        element("nav", [(entry, " ") for entry in contents], aria_label="On this page"),
        element("main", [part for _, _, part in shown]),
        _foot(scored, software),
        journal=run.journal,
        team=place.digest,
    )


def _title(scored: Scored) -> str:
    """Whose run it is, which, and how it ended: tabs show the beginning only."""
    setup = scored.record.setup
    ended = (VOID if scored.run.voided else OUTCOME_WORDS[scored.result.outcome]).lower()
    team = f"{setup.team}: " if setup.team else ""
    which = f"run {setup.run_number} of subject {setup.subject}"
    return f"{team}{which} in condition {setup.condition.number}, {ended} (MADROB)"


def _top(scored: Scored) -> Markup:
    """Warnings first; then whose run it is, how it ended, and what a decision hangs on."""
    record, result = scored.record, scored.result
    setup = record.setup
    condition, task = setup.condition, task_text(setup.condition)
    ended = OUTCOME_WORDS[result.outcome].upper()
    waiting = undecided(scored.flags)
    warnings = (
        UNOFFICIAL.get(record.source, PRACTICE if setup.practice else None),
        INVALID.get(result.outcome),
        VOIDED if scored.run.voided else None,
        "; ".join(flag.words for flag in waiting),
    )
    team = (" · ", said(setup.team)) if setup.team else ()
    whole = result.ended == result.outcome_reason  # else the summary says how many steps count
    reason = (": ", said(result.ended)) if result.ended and whole else ()
    told = (FlagKind.PRACTICE, FlagKind.VOID)
    others = [f.words for f in scored.flags if f not in waiting and f.kind not in told]
    return element(
        "header",
        [element("p", words, class_="banner") for words in warnings if words],
        element("p", "MADROB ", said(record.competition), class_="competition"),
        element("h1", f"Run {setup.run_number} of subject {setup.subject}", team),
        element("p", f"Condition {condition.number}, {condition.benchmark_type}: {task}"),
        element("p", f"Started {date_text(result.start)}"),
        element("p", element("strong", ended), reason, class_="outcome"),
        element("p", element("strong", "; ".join(others)), class_="flags") if others else (),
        element("p", _summary(scored)),
    )


def _summary(scored: Scored) -> Iterator[Content]:
    """How far the robot came, how long it took, and whether that is the last word."""
    run, result = scored.run, scored.result
    done, stop = sum(record.done for record in result.steps), result.stop
    yield f"{done} of {len(result.steps)} steps count. "
    if stop is not None and stop >= result.start:
        took = element("span", f"{since(stop, result.start)} s", class_="whole")
        yield "The run took ", took, ". "
    if denied := [record.step.text for record in result.steps if record.denied]:
        yield f"The referee denies: {', '.join(denied)}. "
    issue = f", issue {run.issue}" if run.issue > 1 else ""
    if run.closure is None:
        yield f"The result is not final{issue}."
    else:
        yield f"The result is final{issue}; {run.closure.team_word} by the team."


def _foot(scored: Scored, software: str) -> Markup:
    record, run = scored.record, scored.run
    recorded, made = record.version, software or record.version
    return element(
        "footer",
        f"Issue {run.issue} of the result, ruleset {scored.result.ruleset}. ",
        f"Recorded with madrob-console {recorded}; this page was made with {made}. ",
        f"All numbers, and why there is none, are in {RESULT_FILE}.",
    )
