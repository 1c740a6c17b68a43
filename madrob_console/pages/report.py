"""The report of a run: `report.html`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from madrob_console.archive.pictures import Picture
from madrob_console.archive.scored import Scored
from madrob_console.pages.camera_pictures import Anchors, anchors, pictures
from madrob_console.pages.notes import (
    BIAS_NOTE,
    INVALID,
    LOCKED_BY,
    MANUAL_START_NOTE,
    NO_UNCERTAINTY_NOTE,
    SOURCES,
    TEAM_WORDS,
    UNCERTAINTY_NOTE,
    VOIDED,
    unofficial_words,
)
from madrob_console.pages.phases import TimedPhase, phases
from madrob_console.pages.related_runs import NOWHERE, PagePlace
from madrob_console.pages.templates import NONE, render
from madrob_console.referee.flags import FlagKind, common_reason, data_remarks, serious, undecided
from madrob_console.referee.records import Reissuing
from madrob_console.referee.run_summary import OUTCOME_WORDS, VOID, RunSummary
from scoring.figure_table import FigureName, FigurePart
from scoring.indicator_table import IndicatorName, ruleset
from scoring.result import Indicator, Result, doubts_of, uncertainty_text

NO_MATPLOTLIB = "they need matplotlib: install madrob-console with its extra `report`"

_MOST_EVENTS = 30
"""From the beginning, and from the end."""

_MOST_ISSUES = 20
"""The latest ones; the journal has all."""

_QUALITY = (
    "signal",
    "samples",
    "rate, Hz",
    "longest gap, ms",
    "gaps",
    "jitter, ms",
    "clock skew, ms",
    "dropped",
    "shifted",
    "no reading",
)

_NOTES = {
    "MANUAL_START_NOTE": MANUAL_START_NOTE,
    "UNCERTAINTY_NOTE": UNCERTAINTY_NOTE,
    "NO_UNCERTAINTY_NOTE": NO_UNCERTAINTY_NOTE,
    "BIAS_NOTE": BIAS_NOTE,
}


def report_html(
    scored: Scored,
    software: str = "",
    place: PagePlace = NOWHERE,
    shown: Sequence[Picture] = (),
) -> str:
    """The report of a run; the same run in the same place gives the same text.

    `software` is the version that makes it; empty = the one that recorded the run.
    """
    run, result, record = scored.run, scored.result, scored.record
    return render(
        "report.html",
        run=run,
        result=result,
        record=record,
        place=place,
        software=software,
        rules=ruleset(result.ruleset),
        title=_title(scored),
        notes=_NOTES,
        locked_by=LOCKED_BY,
        sources=SOURCES,
        team_words=TEAM_WORDS,
        quality_columns=_QUALITY,
        quality_remarks=data_remarks(result.quality),
        pictures=pictures(shown),
        events=_events(result, anchors(shown)),
        issued=_issued(run.reissues, place.earlier),
        issues_left_out=max(0, len(run.reissues) - _MOST_ISSUES),
        bests=_bests(scored, place),
        definitions=definitions_of(result),
        phase_ends=[phase.words for phase in TimedPhase if phase.step is not None],
        **_indicators(result.indicators),
        **phases(scored, place),
        **_figures(scored),
        **_top(scored),
    )


def _figures(scored: Scored) -> dict[str, object]:
    """Return what the report shows of the figures: those that are drawn, and why others are not."""
    shown: dict[str, object] = {"touch_force": scored.rows.thresholds.touch_force}
    try:
        from madrob_console.pages.report_figures import figures
        from scoring.figures import missing_figures
    except ModuleNotFoundError:
        return shown | {"figures": {}, "missing": dict.fromkeys(FigureName, NO_MATPLOTLIB)}
    missing = missing_figures(scored.result, scored.rows)
    return shown | {"figures": figures(scored), "missing": missing}


def _indicators(indicators: Mapping[IndicatorName, Indicator]) -> dict[str, object]:
    uncertainties = [indicator.uncertainty for indicator in indicators.values()]
    return {
        "common_reason": common_reason(indicators),
        "doubts": doubts_of(indicators),
        "uncertain": any(uncertainty_text(uncertainty) for uncertainty in uncertainties),
        "unknown": any(
            indicator.uncertainty is None and indicator.value is not None and not name.spec.counts
            for name, indicator in indicators.items()
        ),
    }


def _events(result: Result, pictured: Anchors) -> list[tuple[str, str, str | None]]:
    """Time, words, and the anchor of its pictures."""
    times: list[tuple[str, str, str | None]] = [
        (
            f"{event.since_start:.2f}",
            event.event.words,
            pictured.get((event.time, event.event.value)),
        )
        for event in result.events
    ]
    left_out = len(times) - 2 * _MOST_EVENTS
    if left_out > 0:
        between = (NONE, f"{left_out} more, in the csv file of the events", None)
        times = [*times[:_MOST_EVENTS], between, *times[-_MOST_EVENTS:]]
    return times


def _issued(
    reissues: Sequence[Reissuing], earlier: Sequence[RunSummary]
) -> list[tuple[Reissuing, str]]:
    """The latest re-issues, newest first, each with what the result was before."""
    words_of_issue = {issue.issue: f"{issue.result_words}, {issue.closing}" for issue in earlier}
    return [
        (reissue, words_of_issue.get(reissue.issue - 1, ""))
        for reissue in reversed(reissues[-_MOST_ISSUES:])
    ]


def _bests(scored: Scored, place: PagePlace) -> dict[IndicatorName, tuple[str, str]]:
    """Of each indicator the team's best and the field's, this run included; empty without a field.

    They are of completed runs in its condition.
    """
    if not place.field:
        return {}
    field = [run.summary for run in place.field]
    if place.itself is not None and place.itself.comparable:
        field.append(place.itself)
    team = [run for run in field if run.subject == scored.record.setup.subject]
    return {name: (_best(team, name), _best(field, name)) for name in IndicatorName}


def _best(runs: Sequence[RunSummary], name: IndicatorName) -> str:
    choose = max if name.spec.higher_is_better else min
    having = [run for run in runs if name in run.values]
    if not having:
        return NONE
    return choose(having, key=lambda run: run.values[name]).value_words(name)


def _title(scored: Scored) -> str:
    """Whose run it is, which, and how it ended: tabs show the beginning only."""
    setup = scored.record.setup
    ended = (VOID if scored.run.voided else OUTCOME_WORDS[scored.result.outcome]).lower()
    team = f"{setup.team}: " if setup.team else ""
    which = f"run {setup.run_number} of subject {setup.subject}"
    return f"{team}{which} in condition {setup.condition.number}, {ended} (MADROB)"


def _top(scored: Scored) -> dict[str, object]:
    record, result, run = scored.record, scored.result, scored.run
    waiting = undecided(scored.flags)
    banners = (
        *unofficial_words(record),
        INVALID.get(result.outcome),
        VOIDED if run.voided else None,
        "; ".join(flag.words for flag in waiting),
    )
    said_elsewhere = (FlagKind.PRACTICE, FlagKind.VOID)
    others = [f for f in scored.flags if f not in waiting and f.kind not in said_elsewhere]
    heavy = serious(others)
    whole = result.ended == result.outcome_reason  # else the summary says how many steps count
    return {
        "banners": [words for words in banners if words],
        "ended": OUTCOME_WORDS[result.outcome].upper(),
        "reason": result.ended if whole else "",
        "heavy": "; ".join(flag.words for flag in heavy),
        "light": "; ".join(flag.words for flag in others if flag not in heavy),
        "denied": ", ".join(step.step.text for step in result.steps if step.denied),
        "issue": f", version {run.issue}" if run.issue > 1 else "",
    }


def definitions_of(result: Result) -> Iterator[tuple[IndicatorName, str, FigureName | None]]:
    """Each indicator, what it means, and the figure that shows it."""
    rules = ruleset(result.ruleset)
    for name in IndicatorName:
        said = rules.explanation(name)
        own = said != name.spec.explanation  # these rules have it otherwise than the protocol
        text = said if own else name.spec.definition
        yield name, f"{text[0].upper()}{text[1:]}", _figure_of(name)


def _figure_of(name: IndicatorName) -> FigureName | None:
    whole = (figure for figure in FigureName if figure.spec.part is FigurePart.WHOLE)
    return next((figure for figure in whole if figure.spec.indicator is name), None)
