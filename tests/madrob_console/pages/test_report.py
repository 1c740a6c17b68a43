"""The report of a run, as a page, and `madrob report`."""

from __future__ import annotations

import json
import os
import re
import shutil
import sys
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from madrob_console.archive.scored import Scored, score_opened
from madrob_console.common.names import SourceKind, terminal_safe
from madrob_console.common.version import software_version
from madrob_console.pages.related_runs import (
    NOWHERE,
    ComparedRun,
    LinkedRun,
    PagePlace,
    RelatedRuns,
)
from madrob_console.pages.report import report_html
from madrob_console.referee.acts import (
    Abort,
    AddNote,
    Finalise,
    MarkIncident,
    Reissue,
    Rule,
    Void,
)
from madrob_console.referee.records import (
    AcceptedDoubts,
    CheckName,
    Closure,
    FalseStart,
    Incident,
    IncidentKind,
    Note,
    TeamWord,
    Voiding,
    Waiver,
)
from madrob_console.referee.records import TestbedFault as Fault
from madrob_console.referee.run_summary import RunSummary
from madrob_console.testbeds.simulated import Scenario
from scoring.figure_table import FigureName
from scoring.indicator_table import IndicatorName, RulesetName
from scoring.procedure import Ruling
from scoring.protocol import EventName, Outcome, Step
from scoring.result import EventRecord, Indicator, Uncertainty, value_text
from tests.madrob_console.cli.typed import Madrob
from tests.madrob_console.engine.drive import make_setup
from tests.madrob_console.pages.page import Page
from tests.madrob_console.recorded_runs import (
    aborted,
    ended_after,
    new_drive,
    note_again,
    publish,
    recorded,
)
from tests.madrob_console.run_folders import VALUES, summary, write


@cache
def signed() -> Path:
    """A whole run with everything that a referee can say."""
    drive = new_drive()
    drive.start(make_setup())
    drive.wait(2.0)
    drive.act(MarkIncident(IncidentKind.COLLISION, "door <frame> & hinge"))
    drive.act(MarkIncident(IncidentKind.FALL), AddNote("lights flickered"))
    drive.finish()
    drive.act(Rule(Step.CROSS, confirmed=True, reason="seen from the side"))
    drive.act(Finalise(TeamWord.PROTESTED, "R. Eferee", "the robot was slower"))
    drive.engine.close()
    return drive.folder


def reissued() -> Path:
    """A run in which nothing was done, ruled, signed, issued again and void."""
    drive = new_drive(Scenario.NO_TOUCH)
    drive.whole_run(make_setup(timeout=1.0))
    drive.act(Rule(Step.TOUCH, confirmed=True, reason="seen <b>by all</b>"))
    drive.act(Finalise(TeamWord.PROTESTED, "R. Eferee", "unfair"))
    drive.act(Reissue("the video shows more"))
    drive.act(Finalise(TeamWord.ACKNOWLEDGED, "R. Eferee"))
    drive.act(Void("the floor was wet"))
    drive.engine.close()
    return drive.folder


RUNS: Mapping[str, Callable[[], Path]] = {
    "signed": signed,
    "timeout": partial(recorded, Scenario.TOUCH_ONLY),
    "reissued": reissued,
    "aborted": aborted,
    "aborted in the countdown": partial(ended_after, 0.5, Abort("not ready")),
    "interrupted": partial(ended_after, 6.0),
}


@cache
def run_of(kind: str) -> tuple[Path, Scored]:
    folder = RUNS[kind]()
    return folder, score_opened(folder)


@cache
def page_of(kind: str) -> str:
    folder, scored = run_of(kind)
    return report_html(scored, place=RelatedRuns().place_of(folder, scored))


@pytest.fixture(scope="module")
def scored() -> Scored:
    return run_of("signed")[1]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A copy of that run's folder."""
    source, _ = run_of("signed")
    return shutil.copytree(source, tmp_path / "results" / source.name)


# ---------------------------------------------------------------- every page


TOLD: dict[str, dict[str, tuple[str, ...]]] = {
    "signed": {
        "title": ("Delft: run 1 of subject 3 in condition 1, completed (MADROB)",),
        "header": (
            "Run 1 of subject 3 · Delft",
            "COMPLETED: all six steps done",
            "6 of 6 steps count",
            "final; protested by the team",
            "PROTESTED by the team; step 4 confirmed 2 incidents (collision, fall)",
        ),
        "Set-up": (
            *("Delft, subject 3", "1: No Force", "pull the door, from side CCW to side CW"),
            *("x 1.5 m, y 0 m, yaw 0°", "60 s, after a countdown of 2 s", "protocol"),
            *("a door that stays closed", "R. Eferee"),
        ),
        "Indicators": (
            "Handle at rest: 5.",
            "execution time and time to handle include the delay",
            *("execution time *", "time to handle *"),
        ),
        "Referee decisions": (
            "step 4, cross the threshold: confirmed by R. Eferee: seen from the side",
        ),
        "Notes": ("lights flickered",),
        "False starts": ("None.",),
        "Incidents": ("fall", "collision: door <frame> & hinge"),
        "Figures": ("1.96 N to either side, it counts as touched",),
        "Where the time went": ("There is nothing to compare with",),
        "Data quality": ("Nothing to remark.",),
        "nav": ("steps and events",),
        "footer": ("ruleset protocol",),
        "What the words mean": tuple(name.spec.definition[1:] for name in IndicatorName),
    },
    "timeout": {
        "header": ("TIMEOUT",),
        "Indicators": (
            "none: robot never approached on the starting side",
            "none: door never opened",
        ),
        "Figures": ("Figure 4 is missing: the door never opened.",),
    },
    "reissued": {
        "Issued again": (
            "by R. Eferee: the video shows more; was: level",
            ", timeout, final",
            "by R. Eferee (void): the floor was wet; was: level",
        ),
    },
    "aborted": {
        "header": ("robot on fire", "INVALID"),
        "Figures": ("None: the run was aborted and is invalid.",),
        "Indicators": ("None: run aborted: invalid.",),
    },
    "aborted in the countdown": {"header": ("INVALID",)},
    "interrupted": {"Indicators": ("none: no benchmark stop",)},
}


@pytest.mark.parametrize("kind", RUNS)
def test_the_page_of_any_run_is_whole_by_itself_and_has_the_numbers_of_its_result(
    kind: str,
) -> None:
    folder, scored = run_of(kind)
    result, place = scored.result, RelatedRuns().place_of(folder, scored)
    text = page_of(kind)
    page = Page(text)
    assert report_html(scored, place=place) == text
    assert text.startswith("<!DOCTYPE html>")
    assert len(text.encode()) < 300_000
    assert not re.search(r"http(?!-equiv)|<script|@import|\son\w+=|\ssrc=", text)
    assert not {"script", "link", "iframe", "object", "img", "form"} & set(page.tags)
    ids = Counter(page.found("id"))
    assert max(ids.values()) == 1
    assert set(re.findall(r'(?:url\(#|href="#)([^)"]+)', text)) <= set(ids)
    files = {one for one in page.found("href") if one[0] != "#"}
    assert "result.json" in files
    assert all((folder / name).is_file() for name in files)
    assert [page.tags.count(tag) for tag in ("header", "nav", "main", "footer")] == [1] * 4
    assert f": {result.outcome_reason}" in page.part("header")
    told = page.part("Indicators")
    for name, one in result.indicators.items():
        unit = one.unit.replace("^2", "²").replace("^3", "³")
        shown = one.value is not None and f"{value_text(one.value, one.uncertainty)}{one.sign}"
        assert (f"{unit}" in told and shown in told) if shown else str(one.reason) in told, name
    aborted = result.outcome is Outcome.ABORTED
    assert aborted or all(name.spec.explanation in told for name in IndicatorName)
    seconds = {
        "The six steps": [one.final - result.start for one in result.steps if one.final],
        "Events": [event.since_start for event in result.events],
    }
    page.tells({part: tuple(f"{time:.2f}" for time in times) for part, times in seconds.items()})
    rows = tuple(f"{one.signal.value} {one.samples}" for one in result.quality.signals)
    page.tells({"Data quality": rows})
    page.tells(TOLD[kind])
    untimed = kind in {"aborted in the countdown", "interrupted"}
    assert ("The run took" in page.text, "svg" in page.tags) == (not untimed, "aborted" not in kind)


def test_numbers_beside_the_indicators_are_those_of_the_run(scored: Scored) -> None:
    page = Page(page_of("signed"))
    record, result, samples = scored.record, scored.result, scored.record.zero_samples
    crossed, seconds = result.steps[3].sensors, {e.event: e.since_start for e in result.events}
    assert samples is not None
    assert crossed is not None
    at = f"{crossed - result.start:.2f}"
    page.tells(
        {
            "Set-up": (f"{record.handle_zero:.3f} N", samples.scatter),
            "The six steps": (f"4 cross the threshold {at} confirmed", f"seen from the side {at}"),
            "Figures": (f"zeroed at {result.handle_zero:.2f} N",),
            "Events": tuple(f"{time:.2f} {event.words}" for event, time in seconds.items()),
        }
    )
    rest = r"Handle at rest: 5\.\d{3} N before; 5\.\d{3} N after, drift -0\.[45]"
    assert re.search(rest, page.part("Indicators"))
    assert len(re.findall(r"\d [a-z]+ the \w+ ", page.part("The six steps"))) == 6
    spoken = [words for words in page.found("aria-label") if words.startswith("Figure")]
    assert [words[:8] for words in spoken] == [f"Figure {name.number}" for name in FigureName]
    assert page.tags.count("figure") == page.tags.count("figcaption") == len(FigureName) + 1
    unsafety = result.indicators[IndicatorName.UNSAFETY_OF_DOOR_OPERATION]
    assert value_text(unsafety.value or 0.0, unsafety.uncertainty) in spoken[0]
    assert any(words.startswith("Passage sensors") for words in page.found("aria-label"))


# ---------------------------------------------------------------- the same run, otherwise


def of_run(scored: Scored, **fields: object) -> Scored:
    return replace(scored, run=replace(scored.run, **fields))  # type: ignore[arg-type]


def of_result(scored: Scored, **fields: object) -> Scored:
    return replace(scored, result=replace(scored.result, **fields))  # type: ignore[arg-type]


def of_source(scored: Scored, source: SourceKind, *, practice: bool = False) -> Scored:
    setup = replace(scored.record.setup, practice=practice)
    return replace(scored, record=replace(scored.record, source=source, setup=setup))


def ended(scored: Scored, reason: str = "as told") -> Scored:
    """The same run aborted; it has no figures and is quick to write."""
    return of_result(scored, outcome=Outcome.ABORTED, outcome_reason=reason)


def trusted(scored: Scored, known: Mapping[IndicatorName, Indicator]) -> Scored:
    """With what is known of some indicators, and nothing of the others."""
    plain = scored.result.indicators.items()
    rest = {name: replace(one, uncertainty=None, doubts=()) for name, one in plain}
    return of_result(scored, indicators={**rest, **known})


def steps_of(scored: Scored, keep: Callable[[Step], bool]) -> Scored:
    """With those steps done only."""
    steps = scored.result.steps
    return of_result(
        scored, steps=tuple(one if keep(one.step) else replace(one, final=None) for one in steps)
    )


def started(scored: Scored) -> float:
    assert scored.run.start is not None
    return scored.run.start


def false_start(
    scored: Scored, before: float, event: EventName, accepted: str | None = None
) -> FalseStart:
    return FalseStart(started(scored) - before, event, accepted)


def beside(subject: int, run_number: int, crossed: float = 3.0) -> ComparedRun:
    """A run of 4 s whose steps came a second after each other, but for the crossing."""
    steps = {Step.TOUCH: 1.0, Step.OPEN: 2.0, Step.CROSS: crossed, Step.CLOSE: 4.0}
    values = {**VALUES, "execution_time": 4.0}
    return ComparedRun(summary(subject, 1, run_number, values=values), steps)


@dataclass(frozen=True)
class Otherwise:
    """What is changed of the signed run, and what its page tells then, or no more."""

    change: Callable[[Scored], Scored]
    told: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    untold: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    place: PagePlace = NOWHERE


TOUCH = "the touch rests on 1 sample"
UNCERTAINTY = Uncertainty(0.009, 0.018)
KNOWN = {
    IndicatorName.EXECUTION_TIME: Indicator(13.8621, "s", None, UNCERTAINTY),
    IndicatorName.TIME_TO_HANDLE: Indicator(3.2, "s", None, UNCERTAINTY, (TOUCH,)),
    IndicatorName.PASSAGE_TIME: Indicator(None, "s", "never closed", None, (TOUCH,)),
}
ACCEPTED = AcceptedDoubts(
    5.0, "seen on video: right", "Ada", {IndicatorName.TIME_TO_HANDLE: (TOUCH,)}
)
DENIAL = Ruling(Step.CROSS, confirmed=False, time=0.0, reason="arm only", referee="R")
WORDS = {
    TeamWord.ACKNOWLEDGED: "The team acknowledged the result.",
    TeamWord.PROTESTED: "The team PROTESTED against the result.",
    TeamWord.ABSENT: "Nobody of the team was there.",
}
OTHERWISE: dict[str, Otherwise] = {
    "how far values can be trusted": Otherwise(
        lambda s: of_run(trusted(s, KNOWN), accepted_doubts=(ACCEPTED,)),
        {
            "Indicators": (
                *("13.86 +- 0.02 s", "3.20? +- 0.02 s", "none: never closed?"),
                f"time to handle, passage time: {TOUCH}.",
                "repeats within it, 95 of 100",
            ),
            "What the words mean": ("the steps of the encoder look like jerk",),
            "Referee decisions": (
                f"doubt accepted (time to handle: {TOUCH}): seen on video: right",
            ),
        },
    ),
    "no uncertainty is known": Otherwise(
        lambda s: trusted(s, {}),
        {"Indicators": ("no uncertainty is known of them",)},
        {"Indicators": ("expanded uncertainty",)},
    ),
    "a denied step": Otherwise(
        lambda s: ended(
            of_result(
                s,
                steps=tuple(
                    replace(one, referee=DENIAL, final=None, reason="denied by the referee")
                    if one.step is Step.CROSS
                    else one
                    for one in s.result.steps
                ),
            )
        ),
        {
            "header": ("The referee denies: cross the threshold.",),
            "The six steps": ("denied by the referee",),
        },
    ),
    "what a decision hangs on": Otherwise(
        lambda s: of_run(
            s,
            false_starts=(false_start(s, 1, EventName.HANDLE_IS_TOUCHED),),
            faults=(Fault(started(s) + 2, "/madrob/door/angle: <lost>"),),
        ),
        {
            "header": ("1 false start UNDECIDED (handle touched)", "1 testbed fault"),
            "Testbed faults": ("+2.00 s /madrob/door/angle: <lost>",),
        },
    ),
    "waivers and false starts": Otherwise(
        lambda s: ended(
            of_run(
                s,
                waivers=(Waiver(CheckName.DISK, "small disk, short run", "Ann", 0.0),),
                false_starts=(
                    false_start(s, 1, EventName.HANDLE_IS_TOUCHED, "a cable hung on it"),
                    false_start(s, 0.5, EventName.DOOR_OPENS),
                ),
            )
        ),
        {
            "Referee decisions": ("check “disk space” waived by Ann: small disk, short run",),
            "False starts": (
                "-1.00 s handle touched (handle_is_touched); accepted: a cable hung on it",
                "-0.50 s door opens (door_opens); not decided",
            ),
        },
    ),
    "remarks": Otherwise(
        lambda s: ended(
            of_result(s, quality=replace(s.result.quality, remarks=("door angle: 3 gaps",)))
        ),
        {"Data quality": ("door angle: 3 gaps",)},
    ),
    **{
        f"the team's word: {word}": Otherwise(
            lambda s, word=word: ended(  # type: ignore[misc]
                of_run(s, closure=Closure(1_700_000_000.0, "R. Eferee", word, "as they said"))
            ),
            {"The team's word": (words, "as they said", "Signed by referee R. Eferee")},
        )
        for word, words in WORDS.items()
    },
    "not final": Otherwise(
        lambda s: ended(of_run(s, closure=None, issue=2)),
        {"The team's word": ("NOT FINAL",), "header": ("not final, version 2",)},
    ),
    "a door that flickers": Otherwise(
        lambda s: ended(
            of_result(
                s,
                events=tuple(
                    EventRecord(s.result.start + n, float(n), EventName.DOOR_OPENS)
                    for n in range(100)
                ),
            )
        ),
        {"Events": ("0.00 door opens", "40 more", "99.00 door opens")},
    ),
    "the team's best": Otherwise(
        lambda s: s,
        {
            "Where the time went": (
                "This is the team's best run in this condition so far; the next is run 2",
                "team's best other, s",
            )
        },
        place=PagePlace(
            field=(beside(3, 2),),
            itself=summary(3, 1, 9, values={**VALUES, "execution_time": 1.0}),
        ),
    ),
    "a failed run": Otherwise(
        lambda s: steps_of(
            of_result(s, outcome=Outcome.TIMEOUT, stop=s.result.steps[1].final + 2.5),  # type: ignore[operator]
            lambda step: step <= Step.OPEN,
        ),
        {
            "Where the time went": (
                "no further step 2.50",
                "A completed run is compared with the other completed ones of condition 1",
            )
        },
    ),
    "other runs and files": Otherwise(
        ended,
        {
            "Other runs of the team": (
                "from CCW to CW): run 2 (level 6, completed in 17.4320 s)",
                "run 1 (level 6, timeout)",
            )
        },
        place=PagePlace(
            files=("result.json", 'javascript:"x" #1.csv'),
            team=(
                LinkedRun(summary(3, 1, 2), "../other/report.html"),
                LinkedRun(summary(3, 7, 1, outcome=Outcome.TIMEOUT), ""),
            ),
        ),
    ),
    "versions": Otherwise(
        lambda s: ended(replace(s, record=replace(s.record, version="1.2.3"))),
        {"footer": ("Recorded with madrob-console 1.2.3; this page was made with 4.5.6",)},
    ),
    "other rules": Otherwise(
        lambda s: ended(of_result(s, ruleset=RulesetName.EUROBENCH_2020)),
        {"Indicators": ("four things happened, in any order", "of 4 events")},
        {"Indicators": (IndicatorName.CAPABILITY_LEVEL.spec.explanation,)},
    ),
    "a real testbed": Otherwise(
        lambda s: of_source(ended(s), SourceKind.ROS), {}, {"body": ("official",)}
    ),
    "signed as it is": Otherwise(
        lambda s: s, {}, {"header": ("UNDECIDED",), "Where the time went": ("median",)}
    ),
}


@pytest.mark.parametrize("case", OTHERWISE)
def test_a_page_tells_what_is_known_and_no_more(case: str, scored: Scored) -> None:
    one = OTHERWISE[case]
    page = Page(report_html(one.change(scored), "4.5.6", one.place))
    page.tells(one.told)
    said = [(part, each) for part, words in one.untold.items() for each in words]
    assert [(part, each) for part, each in said if each in page.part(part)] == []
    links = {"../other/report.html", "result.json", "javascript%3A%22x%22%20%231.csv"}
    assert not one.place.files or links <= set(page.found("href"))


@pytest.mark.parametrize(
    ("kind", "words", "source", "practice"),
    [
        ("aborted", "SIMULATED: not an official result.", SourceKind.SIMULATED, True),
        ("aborted", "REPLAY: not an official result.", SourceKind.REPLAY, False),
        ("aborted", "PRACTICE: not an official result.", SourceKind.ROS, True),
        ("aborted", "INVALID: the referee aborted this run.", SourceKind.ROS, False),
        (
            "interrupted",
            "INTERRUPTED: the machine failed during this run.",
            *(SourceKind.ROS, False),
        ),
    ],
)
def test_a_page_begins_with_why_its_run_is_none_that_counts(
    kind: str, words: str, source: SourceKind, *, practice: bool
) -> None:
    page = Page(report_html(of_source(run_of(kind)[1], source, practice=practice)))
    assert page.part("body").startswith(words)
    assert ("PRACTICE: not an official result." in page.part("header")) == practice


def test_where_the_time_went_is_told_beside_median_and_best(scored: Scored) -> None:
    place = PagePlace(field=(beside(3, 2), beside(3, 4), beside(8, 1, crossed=3.5)))
    page = Page(report_html(scored, place=place))
    done = {one.step: one.final or 0.0 for one in scored.result.steps}
    touched = done[Step.TOUCH] - scored.result.start
    lost = done[Step.CROSS] - done[Step.OPEN]
    page.tells(
        {
            "Where the time went": (
                f"start to touch {touched:.2f} 1.00 1.00",
                f"opening to crossed {lost:.2f} 1.00 1.00",
                f"most time was lost from opening to crossed: {lost - 1:.2f} s",
                "3 other completed runs of 2 teams",
                "the team's other runs in this condition is run 2.",
            )
        }
    )


def test_each_indicator_stands_beside_the_team_s_best_and_the_field_s(scored: Scored) -> None:
    def other(subject: int, number: int, **own: float) -> RunSummary:
        sure = {IndicatorName.TIME_TO_HANDLE: Uncertainty(0.01, 0.02)} if subject == 8 else {}
        return summary(subject, 1, number, values={**VALUES, **own}, uncertainties=sure)

    field = (
        beside(3, 2),
        ComparedRun(other(8, 1, time_to_handle=1.5, smoothness_of_door_actuation=0.5), {}),
        ComparedRun(other(9, 1, smoothness_of_door_actuation=0.01), {}),
    )
    place = PagePlace(field=field, itself=other(3, 9, passage_time=0.25))
    page = Page(report_html(scored, place=place))
    told = {
        "time to handle": "3.2140 1.50 +- 0.02",
        "smoothness of door actuation": "0.0625 0.5000",
        "passage time": "0.2500 0.2500",
        "capability level": "6 6",
    }
    for name, bests in told.items():
        (row,) = (row for row in page.rows if row.startswith(name))
        assert " ".join(row.split()).endswith(f" {bests}"), name
    assert "field's best" not in Page(report_html(scored)).part("Indicators")


BESIDE: dict[str, RunSummary] = {
    "own": summary(3, 1, 2, source="simulated"),
    "own, another condition": summary(3, 2, 1, source="simulated"),
    "of another team": summary(5, 1, 1, source="simulated"),
    "official": summary(6, 1, 1),
    "other rules": summary(6, 1, 2, source="simulated", ruleset="eurobench-2020"),
    "invalid": summary(6, 1, 3, source="simulated", outcome=Outcome.ABORTED),
    "failed": summary(6, 1, 5, source="simulated", outcome=Outcome.TIMEOUT),
    "without steps": summary(6, 1, 4, source="simulated"),
    "of another team 3": summary(3, 1, 6, source="simulated", competition="Spring Cup"),
}


def test_a_page_in_its_folder_knows_files_team_and_field(folder: Path, scored: Scored) -> None:
    scored = replace(scored, record=replace(scored.record, competition="Autumn Cup"))
    for name, run in BESIDE.items():
        path = write(folder.parent, run)
        done = [{"step": step, "name": "", "final": run.started + step} for step in Step]
        told = {"stop": run.started + 6, "steps": [] if name == "without steps" else done}
        path.write_text(json.dumps(json.loads(path.read_text()) | told))
        (path.parent / "report.html").write_text(name)
    place = RelatedRuns().place_of(folder, scored)
    named = {run.folder: name for name, run in BESIDE.items()}
    assert [named[one.summary.folder] for one in place.field] == ["own", "of another team"]
    assert [named[one.summary.folder] for one in place.team] == ["own", "own, another condition"]
    assert all((folder / one.page).is_file() for one in place.team)
    assert place.field[0].steps[Step.CROSS] == 4.0
    assert {"result.json", "report.html"} & set(place.files) == {"result.json"}
    assert place.itself is not None
    for fields in ({"outcome": Outcome.TIMEOUT}, {"voided": Voiding(1.0, "wrong door", "Ada")}):
        assert RelatedRuns().place_of(folder, of_run(scored, **fields)).field == ()


def test_an_earlier_issue_that_is_damaged_costs_what_it_was_alone(tmp_path: Path) -> None:
    source, scored = run_of("reissued")
    folder = shutil.copytree(source, tmp_path / source.name)
    (folder / "result_issue_1.json").write_text("{")
    page = Page(report_html(scored, place=RelatedRuns().place_of(folder, scored)))
    assert page.part("Issued again").endswith("the video shows more")


@pytest.fixture(scope="module")
def harmless(scored: Scored) -> Page:
    return Page(report_html(_typed(scored, ["x"] * 8)))


anything = st.text(max_size=80) | st.sampled_from(
    ["<script>alert(1)</script>", "</title><b>", "\" onload='x", "&lt;&amp;", "\u202eabc", "\ud800"]
)


@settings(max_examples=60)
@given(st.lists(anything, min_size=8, max_size=8))
def test_whatever_people_typed_is_text_and_nothing_else(
    scored: Scored, harmless: Page, typed: list[str]
) -> None:
    text = report_html(_typed(scored, [f"x{words}" for words in typed]))
    page = Page(text.encode().decode())
    assert page.tags == harmless.tags
    assert [name for name, _ in page.attributes] == [name for name, _ in harmless.attributes]
    for words in typed:
        assert " ".join(terminal_safe(f"x{words}").split()) in page.text


def _typed(scored: Scored, typed: list[str]) -> Scored:
    team, referee, competition, note, incident, ruling, waiver, outcome = typed
    setup = replace(scored.record.setup, team=team, referee=referee)
    record = replace(scored.record, setup=setup, competition=competition)
    said = of_run(
        replace(scored, record=record),
        notes=(Note(0.0, note),),
        incidents=(Incident(0.0, IncidentKind.OTHER, incident),),
        rulings=(Ruling(Step.OPEN, confirmed=True, time=0.0, reason=ruling, referee=referee),),
        waivers=(Waiver(CheckName.POSE, waiver, referee, 0.0),),
        false_starts=(FalseStart(0.0, EventName.DOOR_OPENS, waiver),),
        closure=Closure(0.0, referee, TeamWord.PROTESTED, note),
    )
    return ended(said, outcome)


# ---------------------------------------------------------------- the command


def files_below(root: Path) -> set[str]:
    return {str(path.relative_to(root)) for path in root.rglob("[!.]*") if path.is_file()}


def _put(folder: Path, to: str) -> Path:
    """A copy of a run, of its recording alone or of what is published of it."""
    place = folder.parents[1] / to
    if to == "published":
        publish(folder, place)
        return place
    if to.endswith(".mcap"):
        return Path(shutil.copy(next(folder.glob("*.mcap")), place))
    return shutil.copytree(folder, place / folder.name)


RUN = "subject_003_cond_001_run_001"
IN_FOLDER = rf"results/{RUN}_\d+_\d+/report\.html"
OF_PUBLISHED = {r"published/.*\.(csv|yaml)": -1}
Arguments = Callable[[Path], tuple[object, ...]]
REPORTS: dict[str, tuple[str, Arguments, int, dict[str, int], tuple[str, ...]]] = {
    "a results folder stands for its runs": (
        *("", lambda run: (run.parent,)),
        *(0, {IN_FOLDER: 1}, ()),
    ),
    "a folder of their own": (
        *("--output", lambda run: (run.parents[1] / "to" / "take home", run)),
        *(0, {rf"to/take home/{RUN}_\d+_\d+_report\.html": 1}, ()),
    ),
    "beside a bag alone": (
        *("", lambda run: (_put(run, "alone.mcap"),)),
        *(0, {r"alone\.mcap": 1, r"alone_report\.html": 1}, ()),
    ),
    "a bad folder is named and the rest is reported": (
        *("", lambda run: (run.parents[1] / "nothing", run)),
        *(2, {IN_FOLDER: 1}, ("nothing",)),
    ),
    "published files have no report": (
        *("", lambda run: (_put(run, "published"),)),
        *(2, OF_PUBLISHED, ("result.figures()",)),
    ),
    "two runs of one name do not overwrite each other": (
        *("--output", lambda run: (run.parents[1] / "out", run, _put(run, "other"))),
        *(2, {"other/.*": -1, "out/.*": 1}, ("choose another --output",)),
    ),
    "an output that is a file": (
        *("--output", lambda run: (run / "result.json", run)),
        *(2, {}, ("",)),
    ),
}


@pytest.mark.parametrize("case", REPORTS)
def test_reports_lie_where_they_are_asked_for(
    case: str, folder: Path, tmp_path: Path, madrob: Madrob
) -> None:
    options, paths, code, made, told = REPORTS[case]
    before = files_below(tmp_path)
    said = madrob.say(f"report {options}", *paths(folder))
    new = files_below(tmp_path) - before
    for pattern, count in made.items():
        found = {name for name in new if re.fullmatch(pattern, name)}
        assert len(found) == count or count < 0
        new -= found
    lines = said.err.splitlines()
    assert (said.code, new, len(lines)) == (code, set(), len(told))
    assert all(words in line for words, line in zip(told, lines, strict=True))


def test_without_matplotlib_a_report_says_what_is_missing_and_has_all_else(
    folder: Path, madrob: Madrob, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in ("scoring.figures", "madrob_console.pages.report_figures"):
        monkeypatch.delitem(sys.modules, module, raising=False)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    remedy = "need matplotlib: install madrob-console with its extra `report`"
    madrob("report", folder)
    page = Page((folder / "report.html").read_text())
    page.tells({"Figures": (remedy,), "Indicators": ("execution time",)})


@pytest.mark.parametrize("share", [0.35, 0.66])
def test_a_recording_torn_after_its_result_draws_no_figures(
    folder: Path, madrob: Madrob, share: float
) -> None:
    (bag,) = folder.glob("*.mcap")
    os.truncate(bag, int(share * bag.stat().st_size))
    madrob("report", folder)
    page = Page((folder / "report.html").read_text())
    page.tells({"Figures": ("None",), "Data quality": ("no figure shows the rest of it",)})


def test_the_report_made_later_is_that_of_the_run_and_of_what_its_result_alone_says(
    folder: Path, scored: Scored, madrob: Madrob
) -> None:
    page, result = folder / "report.html", folder / "result.json"
    assert madrob("report", folder) == f"{page}\n"
    place = RelatedRuns().place_of(folder, scored)
    assert page.read_text() == report_html(scored, software_version(), place)
    dropped = "recorder: 7 messages dropped"
    result.write_text(result.read_text().replace('"lost": []', f'"lost": ["{dropped}"]'))
    note_again(folder)
    madrob("report", folder)
    Page(page.read_text()).tells({"Data quality": (dropped,)})
