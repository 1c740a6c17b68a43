"""The report of a run: `report.html`."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import groupby

from madrob_console.archive.folders import RESULT_FILE
from madrob_console.archive.history import OUTCOME_WORDS, VOID, condition_words
from madrob_console.archive.run_pictures import NO_PICTURES, RunPictures
from madrob_console.archive.run_record import RunRecord
from madrob_console.archive.scored import Scored
from madrob_console.pages.camera_pictures import Anchors, anchor, anchors, definitions, pictures
from madrob_console.pages.markup import (
    NOTHING,
    Content,
    Markup,
    element,
    link,
    listed,
    page,
    said,
    section,
    table,
)
from madrob_console.pages.shared_sections import (
    INVALID,
    LOCKED_BY,
    NONE,
    PRACTICE,
    SOURCES,
    TEAM_WORDS,
    UNOFFICIAL,
    VOIDED,
    date_text,
    indicator_section,
    issues,
    phases,
    since,
    star,
    steps,
    task_text,
)
from madrob_console.pages.surroundings import NOWHERE, LinkedRun, PagePlace
from madrob_console.referee.acts.during import RULED
from madrob_console.referee.flags import FlagKind, undecided, untold_remarks, weighty
from madrob_console.referee.records import (
    AcceptedDoubts,
    Correction,
    FalseStart,
    Incident,
    Protest,
    TakenBack,
    Voiding,
    Waiver,
)
from madrob_console.referee.run import Run
from scoring.indicator_table import IndicatorName
from scoring.procedure import Ruling
from scoring.result import EventRecord, Result
from scoring.rulesets import ruleset

# The parts of a report, from set-up to data quality.


_MOST_EVENTS = 30
"""From the beginning, and from the end."""

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


def set_up(record: RunRecord, result: Result) -> Markup:
    setup, pose = record.setup, record.setup.start_pose
    condition = setup.condition
    rows: list[tuple[str, Content]] = [
        ("competition", said(record.competition) if record.competition else NONE),
        ("team", (said(setup.team) if setup.team else NONE, f", subject {setup.subject}")),
        ("run", str(setup.run_number)),
        ("condition", f"{condition.number}: {condition.benchmark_type}"),
        ("task", task_text(condition)),
        ("door opens to", f"side {condition.opening_side.upper()}"),
        ("started", date_text(result.start)),
        ("start pose", f"x {pose.x:g} m, y {pose.y:g} m, yaw {pose.yaw:g}°"),
        ("timeout", f"{setup.timeout:g} s, after a countdown of {setup.countdown:g} s"),
        ("ruleset", result.ruleset),
        ("locking judged by", LOCKED_BY[result.lock_detection]),
        ("handle zero", _zero(record)),
        ("referee", said(setup.referee) if setup.referee else NONE),
        ("data from", SOURCES[record.source]),
        ("testbed", said(setup.testbed) if setup.testbed else NONE),
    ]
    pairs = [element("div", element("dt", name), element("dd", what)) for name, what in rows]
    return section("Set-up", element("dl", pairs), name="setup")


def _zero(record: RunRecord) -> Content:
    samples, zero = record.zero_samples, f"{record.handle_zero:.3f} N"
    return zero if samples is None else (zero, element("small", samples.scatter))


def indicators(result: Result) -> Markup:
    rules = ruleset(result.ruleset)

    def title(name: IndicatorName) -> Content:
        words = element("b", link(f"#{anchor(name)}", name.words), star(name))
        return words, element("small", rules.explanation(name))

    rest = element("p", f"Handle at rest: {result.rest.words}.") if result.rest else NOTHING
    return indicator_section(result.indicators, title, rest)


def events(result: Result, pictured: Anchors) -> Markup:
    def row(event: EventRecord) -> tuple[Content, Content]:
        place = pictured.get((event.time, event.event.value))
        words = event.event.words
        return f"{event.since_start:.2f}", link(f"#{place}", words) if place else words

    times = [row(event) for event in result.events]
    left_out = len(times) - 2 * _MOST_EVENTS
    if left_out > 0:
        between = (NONE, f"{left_out} more, in the csv file of the events")
        times = [*times[:_MOST_EVENTS], between, *times[-_MOST_EVENTS:]]
    return section(
        "Events",
        element("p", "Times in s from the start."),
        table(("time", "event"), times, class_="events") if times else element("p", "None."),
        name="events",
    )


def decisions(run: Run) -> Markup:
    said_so = [
        *([_voiding(run.voided)] if run.voided else []),
        *map(_correction, run.corrections),
        *map(_accepted_doubts, run.accepted_doubts),
        *map(_waiver, run.waivers),
        *((_at(r.time, run), _ruling(r)) for r in run.rulings),
        *map(_taken_back, run.taken_back),
    ]
    ruled = listed(said_so, "None: what the sensors found counts.")
    lists = [
        section("Referee decisions", ruled, name="decisions"),
        _marks("False starts", ((_at(f.time, run), _false_start(f)) for f in run.false_starts)),
        _marks("Testbed faults", ((_at(f.time, run), f.text) for f in run.faults)),
        _marks("Incidents", ((_at(i.time, run), _incident(i)) for i in run.incidents)),
        _marks("Notes", ((_at(n.time, run), said(n.text)) for n in run.notes)),
    ]
    if run.removed_evidence:
        gone = [f"on {date_text(one.time)}: {one.words}" for one in run.removed_evidence]
        lists.append(_marks("Evidence removed", gone))
    return element("div", lists, class_="lists")


def protests(run: Run) -> Content:
    if not run.protests:
        return NOTHING
    return section("Protests", [_protest(one, run) for one in run.protests], name="protests")


def _protest(one: Protest, run: Run) -> Markup:
    filed: list[Content] = [date_text(one.time)]
    if one.late:
        filed += [", late; admitted: ", said(one.late)]
    if one.referee:
        filed += [", taken by ", said(one.referee)]
    answer = one.answer
    if answer is None:
        state = element("strong", "OPEN")
        decision: Content = state, f": to be decided by {date_text(one.due)}"
    else:
        state = element("strong", answer.end.upper())
        by = said(answer.referee or "the referee")
        came = f"; {one.late_decision}" if one.late_decision else ""
        decided = f" ({date_text(answer.time)}{came}, "
        decision = state, ": ", said(answer.reason), decided, by, ")"
    rows: list[tuple[str, Content]] = [
        ("by", said(one.team)),
        ("about", said(one.about_words(run.start))),
        ("the team says", ("“", said(one.text), "”")),
        ("filed", filed),
        ("decision", decision),
    ]
    pairs = [element("div", element("dt", name), element("dd", what)) for name, what in rows]
    return element("div", element("p", element("b", f"Protest {one.number}")), element("dl", pairs))


def team_word(run: Run) -> Markup:
    closure = run.closure
    if closure is None:
        not_yet = element("p", "The result is NOT FINAL: it was not finalised yet.")
        return section("The team's word", not_yet, name="word")
    note = element("p", "“", said(closure.note), "”") if closure.note else NOTHING
    signed = ("Signed by referee ", said(closure.referee), f", {date_text(closure.time)}.")
    word = element("p", element("strong", TEAM_WORDS[closure.team_word]))
    return section("The team's word", word, note, element("p", signed), name="word")


def data_quality(run: Run, result: Result) -> Markup:
    quality = result.quality
    remarks = untold_remarks(run, quality)
    rows = ((q.signal.value, *q.cells()) for q in quality.signals)
    return section(
        "Data quality",
        listed(remarks, "Nothing to remark."),
        table(_QUALITY, rows, class_="quality") if quality.signals else NOTHING,
        _evidence(run),
        name="quality",
    )


def _evidence(run: Run) -> Markup:
    if (evidence := run.evidence) is None:
        return NOTHING
    words = f"Evidence, of which nothing is scored: {evidence.words}"
    gone = run.evidence_removed(date_text)
    told = element("p", words, ("; ", element("strong", gone)) if gone else NOTHING, ".")
    missing = evidence.remarks()
    return Markup(told + listed(missing, "")) if missing else told


def _marks(title: str, marks: Iterable[Content]) -> Markup:
    return section(title, listed(marks, "None."))


def _waiver(waiver: Waiver) -> Content:
    by = said(waiver.referee or "the referee")
    return f"check “{waiver.check}” waived by ", by, ": ", said(waiver.reason)


def _voiding(voided: Voiding) -> Content:
    return "the run is void: ", said(voided.reason), *_by(voided)


def _correction(correction: Correction) -> Content:
    what = f"corrected after the stop: {correction.words}; "
    return what, said(correction.reason), *_by(correction)


def _accepted_doubts(one: AcceptedDoubts) -> Content:
    what = "; ".join(f"{name.words}: {', '.join(told)}" for name, told in one.doubts.items())
    return f"doubt accepted ({what}): ", said(one.reason), *_by(one)


def _taken_back(one: TakenBack) -> Content:
    return element("del", said(one.words)), " taken back: ", said(one.reason), *_by(one)


def _by(decision: Voiding | Correction | AcceptedDoubts | TakenBack) -> tuple[Content, ...]:
    return ", by ", said(decision.referee or "the referee"), f", {date_text(decision.time)}"


def _ruling(ruling: Ruling) -> Content:
    words = f"step {ruling.step:d}, {ruling.step.text}: {RULED[ruling.confirmed]} by "
    return words, said(ruling.referee or "the referee"), ": ", said(ruling.reason)


def _false_start(mark: FalseStart) -> Content:
    what = f"{mark.event.words} ({mark.event})"
    if mark.accepted is None:
        return f"{what}; not decided"
    return f"{what}; accepted: ", said(mark.accepted)


def _incident(mark: Incident) -> Content:
    words = (mark.kind, ": ", said(mark.note)) if mark.note else mark.kind
    if mark.withdrawn is None:
        return words
    return element("del", words), " withdrawn: ", said(mark.withdrawn)


def _at(time: float, run: Run) -> Content:
    if run.start is None:
        return NOTHING
    return element("span", f"{time - run.start:+.2f} s", class_="time"), " "


# Links of a page: the team's other runs, and the files of this one.


def other_runs(place: PagePlace) -> Markup:
    if not place.team:
        return NOTHING
    entries = []
    for condition, runs in groupby(place.team, key=lambda run: run.summary.condition):
        words = ", ".join(filter(None, reversed(condition_words(condition))))
        linked = [(", ", _run(run)) for run in runs]
        linked[0] = ("", linked[0][1])
        entries.append(element("li", f"Condition {condition} ({words}): ", linked))
    told = element("p", "As known when this page was made.")
    return section("Other runs of the team", element("ul", entries), told, name="runs")


def files(place: PagePlace) -> Markup:
    """All files of the run; nothing where the page lies elsewhere."""
    if not place.files:
        return NOTHING
    entries = [element("li", link(name, name)) for name in place.files]
    told = element("p", "They lie beside this page.")
    return section("Files of this run", told, element("ul", entries, class_="files"), name="files")


def _run(run: LinkedRun) -> Content:
    known = run.summary
    words = f"run {known.run_number}"
    time = known.values.get(IndicatorName.EXECUTION_TIME)
    said = f" ({known.outcome_word}" + (f", {time:.2f} s)" if known.valid and time else ")")
    return link(run.page, words) if run.page else words, said


def report_html(
    scored: Scored,
    software: str = "",
    place: PagePlace = NOWHERE,
    seen: RunPictures = NO_PICTURES,
) -> str:
    """The report of a run; the same run in the same place gives the same text.

    `software` is the version that makes it; empty = the one that recorded the run.
    """
    from madrob_console.pages.report_pictures import figures  # it loads matplotlib

    run, result = scored.run, scored.result
    happened = events(result, anchors(seen))
    measured = element("div", steps(result.steps, result.start), happened, class_="pair")
    parts: tuple[tuple[str, str, Content], ...] = (
        ("protests", "protests", protests(run)),
        ("time", "time", phases(scored, place)),
        ("indicators", "indicators", indicators(result)),
        ("steps", "steps and events", measured),
        ("pictures", "pictures", pictures(seen, beside=bool(place.files))),
        ("figures", "figures", figures(scored)),
        ("decisions", "decisions", decisions(run)),
        ("issues", "issued again", issues(run.reissues, place.earlier)),
        ("word", "the team's word", team_word(run)),
        ("setup", "set-up", set_up(scored.record, result)),
        ("quality", "data quality", data_quality(run, result)),
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
    others = [f for f in scored.flags if f not in waiting and f.kind not in told]
    heavy = "; ".join(flag.words for flag in weighty(others))
    light = "; ".join(flag.words for flag in others if flag not in weighty(others))
    return element(
        "header",
        [element("p", words, class_="banner") for words in warnings if words],
        element("p", "MADROB ", said(record.competition), class_="competition"),
        element("h1", f"Run {setup.run_number} of subject {setup.subject}", team),
        element("p", f"Condition {condition.number}, {condition.benchmark_type}: {task}"),
        element("p", f"Started {date_text(result.start)}"),
        element("p", element("strong", ended), reason, class_="outcome"),
        element("p", element("strong", heavy), class_="flags") if heavy else (),
        element("p", light) if light else (),
        element("p", _summary(scored)),
    )


def _summary(scored: Scored) -> Iterator[Content]:
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
        yield f"The result is final{issue}; {run.closure.team_word.told}."


def _foot(scored: Scored, software: str) -> Markup:
    record, run = scored.record, scored.run
    recorded, made = record.version, software or record.version
    return element(
        "footer",
        f"Issue {run.issue} of the result, ruleset {scored.result.ruleset}. ",
        f"Recorded with madrob-console {recorded}; this page was made with {made}. ",
        f"All numbers, and why there is none, are in {RESULT_FILE}.",
    )
