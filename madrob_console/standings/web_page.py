"""A competition's standings as one HTML page without scripts, and nothing from elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

from madrob_console.archive.history import VOID, RunSummary
from madrob_console.referee.flags import weighty
from madrob_console.report.explanations import (
    MANUAL_START_NOTE,
    NONE,
    PRACTICE_STANDINGS,
    date_text,
    task_text,
)
from madrob_console.report.markup import (
    SKIP,
    Content,
    Markup,
    element,
    listed,
    page,
    said,
    scrolled,
    section,
    skip_link,
    table,
)
from madrob_console.standings.competition import (
    BY_NUMBER,
    CONDITION_NUMBERS,
    NUMBER_NOTES,
    CompetitionStandings,
    RulesetStandings,
    statistics_text,
)
from madrob_console.standings.tally import ALIKE, Overall, Tally, subjects_text
from scoring.indicator_table import IndicatorName, unit_text
from scoring.result import uncertainty_text


def standings_html(found: CompetitionStandings, software: str) -> str:
    """The standings as a page, readable on a phone and on paper.

    Args:
        found: the standings.
        software: the version that makes the page.
    """
    several = len(found.groups) > 1
    kind = "standings" if found.official else "PRACTICE standings"
    return page(
        f"MADROB {kind} {found.title}".rstrip(),
        skip_link(),
        _top(found),
        element(
            "main",
            [_group(group, several=several) for group in found.groups],
            element("p", "No run counts yet.") if not found.groups else (),
            section("Runs that count, with flags", listed(_flagged(found), "None.")),
            section("Runs that do not count", listed(_left_out(found), "None.")),
            section("How to read the numbers", how_to_read()),
            id=SKIP,
        ),
        _foot(software),
        wide=True,
    )


def _top(found: CompetitionStandings) -> Markup:
    banner = element("p", PRACTICE_STANDINGS, class_="banner")
    return element(
        "header",
        () if found.official else banner,
        element("p", "MADROB ", said(found.title), class_="competition"),
        element("h1", "Standings" if found.official else "PRACTICE standings"),
        element("p", f"As of {date_text(found.made)}"),
        [element("p", element("strong", said(remark))) for remark in found.remarks],
        element("p", found.basis),
        element("p", BY_NUMBER),
    )


def how_to_read() -> Content:
    """What the numbers of `teams_table` mean."""
    bold = (
        "Bold: the mean. +-: its expanded uncertainty (95 in 100). n: how many runs have a value, "
        "where not all have."
    )
    return [element("p", note) for note in (bold, *NUMBER_NOTES, MANUAL_START_NOTE)]


def _group(group: RulesetStandings, *, several: bool) -> Iterator[Markup]:
    title = f"All conditions together, ruleset {group.ruleset}"
    yield section(title, teams_table(group.overall, title))
    rules = f", ruleset {group.ruleset}" if several else ""
    for condition, standings in group.conditions.items():
        title = f"Condition {condition.number}, {condition.benchmark_type}{rules}"
        yield section(title, element("p", task_text(condition)), teams_table(standings, title))


def _name(tally: Tally) -> Content:
    return element("b", str(tally.subject), " ", said(tally.team))


def teams_table(
    tallies: Iterable[Tally], of: str, who: Callable[[Tally], Content] = _name
) -> Markup:
    """Teams with what their runs came to.

    Args:
        tallies: in the order of the rows.
        of: what the table is of, in words.
        who: how a team is named.
    """
    heads = [
        f"{name.words}{' *' if name.spec.with_the_start else ''}, {unit_text(name.spec.unit)}; "
        f"{name.spec.better} is better"
        for name in IndicatorName
    ]
    rows = ((who(tally), *_row(tally)) for tally in tallies)
    made = table(("team", "runs", *heads), rows, class_="standings", caption=f"Means. {of}.")
    return scrolled(made, of)


def _row(tally: Tally) -> Iterator[Content]:
    lines = list(counts(tally))
    if isinstance(tally, Overall):
        lines.append(f"in {len(tally.conditions)} of {len(CONDITION_NUMBERS)} conditions")
    lines += [f"on {name}" for name in tally.testbeds]
    yield [element("small", said(line)) for line in lines]
    for name in IndicatorName:
        yield _indicator(tally, name)


def counts(tally: Tally) -> Iterator[str]:
    """How many runs ended how: `3 completed`, `1 timeout`; and whether a protest is open."""
    for count, word in (
        (tally.completed, "completed"),
        (tally.timeout, "timeout"),
        (tally.aborted, "INVALID"),
        (tally.voided, VOID),
        (tally.interrupted, "INTERRUPTED"),
        (tally.without_result, "without a result yet"),
    ):
        if count:
            yield f"{count} {word}"
    if tally.not_final_words:
        yield tally.not_final_words


def _indicator(tally: Tally, name: IndicatorName) -> Content:
    """The mean large, the others small below it."""
    aggregate = tally.aggregates.get(name)
    doubts, signs = tally.doubts.get(name, 0), tally.signs(name)
    below = [f"{doubts} doubt{'s' if doubts > 1 else ''}"] if doubts else []
    if alike := tally.alike.get(name):
        below.append(f"{ALIKE} {subjects_text(alike)}")
    if aggregate is None:
        return f"{NONE}{signs}", [element("small", line) for line in below]
    found = statistics_text(aggregate, name)
    lines = [uncertainty_text(aggregate.uncertainty)] if aggregate.uncertainty else []
    lines += [f"{word} {text}" for word, text in found.items() if word != "mean"]
    if aggregate.count != tally.counted:
        lines.append(f"n = {aggregate.count}")
    return element("b", f"{found['mean']}{signs}"), [
        element("small", line) for line in filter(None, (*lines, *below))
    ]


def _left_out(found: CompetitionStandings) -> Iterator[Content]:
    for run, why in found.left_out:
        yield f"{run_words(run)}: ", element("strong", run.outcome_word), ": ", said(why)


def _flagged(found: CompetitionStandings) -> Iterator[Content]:
    for run in found.flagged:
        yield f"{run_words(run)}: ", element("strong", flag_words(run))


def flag_words(run: RunSummary) -> str:
    """What a decision on a run hangs on."""
    return "; ".join(flag.words for flag in weighty(run.flags))


def run_words(run: RunSummary) -> str:
    """A run in words: `run 2 of subject 3 in condition 7, 21 Nov 14:28`."""
    of = f"run {run.run_number} of subject {run.subject} in condition {run.condition}"
    return f"{of}, {run.started_text}"


def _foot(software: str) -> Markup:
    return element("footer", f"Made with madrob-console {software or 'unknown'}.")
