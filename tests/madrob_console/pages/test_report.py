"""The report of a run, as a page, and `madrob report`."""

from __future__ import annotations

import argparse
import json
import re
import shutil
import sys
from collections import Counter
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from madrob_console.archive.history import RunSummary
from madrob_console.archive.scored import Scored
from madrob_console.cli.report_command import report as report_command
from madrob_console.common.names import SourceKind, terminal_safe
from madrob_console.common.version import software_version
from madrob_console.pages import PictureFormat, report_pictures
from madrob_console.pages.report import report_html
from madrob_console.pages.surroundings import ComparedRun, LinkedRun, PagePlace, Surroundings
from madrob_console.referee.acts import (
    Abort,
    AddNote,
    Finalise,
    MarkIncident,
    Rule,
    Start,
    WithdrawIncident,
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
from madrob_console.testbeds.simulated import Scenario
from scoring.figures.run_drawings import TimedPhase
from scoring.indicator_table import FigureName, IndicatorName
from scoring.procedure import Ruling
from scoring.protocol import EventName, Outcome, Step
from scoring.result import EventRecord, Indicator, Uncertainty, value_text
from scoring.rulesets import RulesetName
from tests.madrob_console.engine.drive import Drive, make_setup
from tests.madrob_console.recorded_runs import without_digests
from tests.madrob_console.run_folders import VALUES, summary, write

VOID = {"meta", "br"}


class Page(HTMLParser):
    """A page taken apart; every element must be closed where it was opened."""

    def __init__(self, page: str) -> None:
        super().__init__(convert_charrefs=True)
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str]] = []
        self.words: list[tuple[tuple[str, ...], str]] = []
        self._open: list[str] = []
        self.feed(page)
        self.close()
        assert self._open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += [(name, value or "") for name, value in attrs]
        if tag not in VOID:
            self._open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        assert "svg" in self._open, f"<{tag}/> outside of a picture"
        self.tags.append(tag)
        self.attributes += [(name, value or "") for name, value in attrs]

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.words.append((tuple(self._open), data))

    @property
    def text(self) -> str:
        """All words, on one line."""
        shown = (data for tags, data in self.words if "style" not in tags)
        return " ".join("".join(shown).split())

    def inside(self, tag: str) -> str:
        """All words within elements of a kind."""
        return " ".join("".join(data for tags, data in self.words if tag in tags).split())

    def section(self, title: str) -> str:
        """The text from a heading to the next one."""
        titles = [data for tags, data in self.words if tags[-1:] == ("h2",)]
        after = self.text[self.text.index(title) + len(title) :]
        later = [after.index(t) for t in titles[titles.index(title) + 1 :] if t in after]
        return after[: min(later, default=len(after))].strip()


@pytest.fixture(scope="module")
def driven(tmp_path_factory: pytest.TempPathFactory) -> tuple[Scored, Path]:
    """A whole run with everything that a referee can say."""
    drive = Drive(tmp_path_factory.mktemp("results"))
    drive.start(make_setup())
    drive.wait(2.0)
    drive.act(MarkIncident(IncidentKind.COLLISION, "door <frame> & hinge"))
    drive.act(WithdrawIncident("it was the wind"))
    drive.act(MarkIncident(IncidentKind.FALL), AddNote("lights flickered"))
    drive.finish()
    drive.act(Rule(Step.CROSS, confirmed=True, reason="seen from the side"))
    drive.act(Finalise(TeamWord.PROTESTED, "R. Eferee", "the robot was slower"))
    scored, folder = drive.scored(), drive.engine.folder
    drive.engine.close()
    assert folder is not None
    return scored, folder


@pytest.fixture(scope="module")
def scored(driven: tuple[Scored, Path]) -> Scored:
    return driven[0]


@pytest.fixture
def folder(driven: tuple[Scored, Path], tmp_path: Path) -> Path:
    """A copy of the run's folder."""
    copy = tmp_path / "results" / driven[1].name
    shutil.copytree(driven[1], copy)
    return copy


@pytest.fixture(scope="module")
def text(scored: Scored) -> str:
    return report_html(scored)


@pytest.fixture(scope="module")
def page(text: str) -> Page:
    return Page(text)


def ended(scored: Scored, outcome: Outcome, reason: str = "as told") -> Scored:
    """The same run with another outcome; an aborted one has no figures and is quick to write."""
    result = replace(scored.result, outcome=outcome, outcome_reason=reason)
    return replace(scored, result=result)


def of_source(scored: Scored, source: SourceKind) -> Scored:
    """The same, and official where the testbed is a real one."""
    setup = replace(scored.record.setup, practice=source is SourceKind.SIMULATED)
    return replace(scored, record=replace(scored.record, source=source, setup=setup))


def test_the_page_needs_nothing_from_elsewhere_and_runs_nothing(text: str, page: Page) -> None:
    assert text.startswith("<!DOCTYPE html>")
    assert not re.search("http(?!-equiv)", text)
    assert "<script" not in text
    assert "@import" not in text
    assert not {"script", "link", "iframe", "object", "img", "form"} & set(page.tags)
    assert not [name for name, _ in page.attributes if name.startswith("on") or name == "src"]
    assert all(value.startswith("#") for name, value in page.attributes if name.endswith("href"))


def test_every_picture_refers_to_its_own_parts(text: str, page: Page) -> None:
    ids = Counter(value for name, value in page.attributes if name == "id")
    assert max(ids.values()) == 1
    referred = set(re.findall(r'(?:url\(#|href="#)([^)"]+)', text))
    assert referred
    assert referred <= set(ids)


def test_the_same_run_gives_the_same_page(text: str, scored: Scored) -> None:
    assert report_html(scored) == text


def test_a_page_is_small_enough_to_be_sent_around(text: str) -> None:
    assert len(text.encode()) < 300_000


def test_the_set_up_is_told(page: Page, scored: Scored) -> None:
    told = page.section("Set-up")
    for words in (
        "Delft, subject 3",
        "1: No Force",
        "pull the door, from side CCW to side CW",
        "x 1.5 m, y 0 m, yaw 0°",
        "60 s, after a countdown of 2 s",
        "protocol",
        "a door that stays closed",
        f"{scored.record.handle_zero:.3f} N",
        "R. Eferee",
    ):
        assert words in told
    samples = scored.record.zero_samples
    assert samples is not None
    assert samples.scatter in told


def test_the_outcome_is_told_in_words(page: Page) -> None:
    top = page.inside("header")
    assert "Run 1 of subject 3 · Delft" in top
    assert "COMPLETED: all six steps done" in top
    assert "6 of 6 steps count" in top
    assert "final; protested by the team" in top


def test_every_indicator_has_value_unit_and_explanation(page: Page, scored: Scored) -> None:
    told = page.section("Indicators")
    assert len(scored.result.indicators) == len(IndicatorName)
    for name, indicator in scored.result.indicators.items():
        value = indicator.value
        assert value is not None
        unit = indicator.unit.replace("^2", "²").replace("^3", "³")
        assert f"{value_text(value, indicator.uncertainty)}{indicator.sign}" in told
        assert f" {unit}" in told
        assert name.spec.explanation in told
        assert name.replace("_", " ") in told


def test_the_handle_at_rest_and_its_drift_are_told(page: Page, scored: Scored) -> None:
    rest = scored.result.rest
    assert rest is not None
    assert rest.drift is not None
    told = page.section("Indicators")
    assert re.search(r"Handle at rest: 5\.\d{3} N before; 5\.\d{3} N after, drift [+-]0\.0", told)


def test_a_report_says_how_far_its_values_can_be_trusted(scored: Scored) -> None:
    touch = "the touch rests on 1 sample"
    plain = {
        name: replace(one, uncertainty=None, doubts=())
        for name, one in scored.result.indicators.items()
    }
    known = {
        IndicatorName.EXECUTION_TIME: Indicator(13.8621, "s", None, Uncertainty(0.009, 0.018)),
        IndicatorName.TIME_TO_HANDLE: Indicator(
            3.2, "s", None, Uncertainty(0.009, 0.018), (touch,)
        ),
        IndicatorName.PASSAGE_TIME: Indicator(None, "s", "never closed", None, (touch,)),
    }
    result = replace(scored.result, indicators={**plain, **known})
    accepted = AcceptedDoubts(
        5.0, "seen on video: right", "Ada", {IndicatorName.TIME_TO_HANDLE: (touch,)}
    )
    run = replace(scored.run, accepted_doubts=(accepted,))
    page = Page(report_html(replace(scored, result=result, run=run)))
    told = page.section("Indicators")
    assert "13.86 +- 0.02 s" in told
    assert "3.20? +- 0.02 s" in told
    assert "none: never closed?" in told
    assert f"time to handle, passage time: {touch}." in told
    assert "lies within it of what happened 95 times in 100" in told
    assert "the steps of the encoder look like jerk" in page.section("What the words mean")
    answer = f"doubt accepted (time to handle: {touch}): seen on video: right"
    assert answer in page.section("Referee decisions")
    untold = Page(report_html(replace(scored, result=replace(result, indicators=plain))))
    told = untold.section("Indicators")
    assert "expanded uncertainty" not in told
    assert "no uncertainty is known of them" in told


def test_the_manual_start_is_told_beside_the_times_that_include_it(page: Page) -> None:
    told = page.section("Indicators")
    assert "execution time and time to handle include the delay" in told
    assert "execution time *" in told
    assert "time to handle *" in told


def test_an_indicator_without_a_value_has_a_reason(tmp_path: Path) -> None:
    drive = Drive(tmp_path, Scenario.TOUCH_ONLY)
    drive.whole_run(make_setup(timeout=6.0))
    page = Page(report_html(drive.scored()))
    told = page.section("Indicators")
    assert "none: robot never approached on the starting side" in told
    assert told.count("none: door never opened") == 2
    assert "TIMEOUT" in page.inside("header")
    assert "Figure 4 is missing: the door never opened." in page.section("Figures")


def test_each_step_shows_sensors_referee_and_what_counts(page: Page, scored: Scored) -> None:
    told = page.section("The six steps")
    crossed = scored.result.steps[3]
    assert crossed.sensors is not None
    at = f"{crossed.sensors - scored.result.start:.2f}"
    words = rf"4 cross the threshold {at} confirmed ?seen from the side {at}"
    assert re.search(words, told), told
    assert len(re.findall(r"\d [a-z]+ the \w+ ", told)) == 6


def test_a_denied_step_is_told_on_top(scored: Scored) -> None:
    steps = list(scored.result.steps)
    denial = Ruling(Step.CROSS, confirmed=False, time=0.0, reason="arm only", referee="R")
    steps[3] = replace(steps[3], referee=denial, final=None, reason="denied by the referee")
    denied = replace(scored, result=replace(scored.result, steps=tuple(steps)))
    page = Page(report_html(ended(denied, Outcome.ABORTED)))
    assert "The referee denies: cross the threshold." in page.inside("header")
    assert "denied by the referee" in page.section("The six steps")


def test_what_a_decision_hangs_on_is_told_on_top(page: Page, scored: Scored) -> None:
    head = page.inside("header")
    assert "PROTESTED by the team; step 4 confirmed 1 incident (fall)" in head
    assert "UNDECIDED" not in head
    assert scored.run.start is not None
    touched = FalseStart(scored.run.start - 1, EventName.HANDLE_IS_TOUCHED)
    fault = Fault(scored.run.start + 2, "/madrob/door/angle: <lost>")
    run = replace(scored.run, false_starts=(touched,), faults=(fault,))
    marked = Page(report_html(replace(scored, run=run)))
    assert marked.inside("header").count("1 false start UNDECIDED (handle touched)") == 1
    assert "1 testbed fault" in marked.inside("header")
    assert "+2.00 s /madrob/door/angle: <lost>" in marked.section("Testbed faults")


def test_what_the_referee_said_is_told(page: Page) -> None:
    assert "step 4, cross the threshold: confirmed by R. Eferee: seen from the side" in (
        page.section("Referee decisions")
    )
    assert "lights flickered" in page.section("Notes")
    assert page.section("False starts") == "None."
    assert "fall" in page.section("Incidents")


def test_a_withdrawn_incident_is_struck_through_with_its_reason(page: Page) -> None:
    assert page.inside("del") == "collision: door <frame> & hinge"
    assert "withdrawn: it was the wind" in page.section("Incidents")


def test_waivers_and_false_starts_are_told_once(scored: Scored) -> None:
    assert scored.run.start is not None
    run = replace(
        scored.run,
        waivers=(Waiver(CheckName.DISK, "small disk, short run", "Ann", 0.0),),
        false_starts=(
            FalseStart(scored.run.start - 1, EventName.HANDLE_IS_TOUCHED, "a cable hung on it"),
            FalseStart(scored.run.start - 0.5, EventName.DOOR_OPENS),
        ),
    )
    quality = replace(scored.result.quality, remarks=("door angle: 3 gaps", *run.remarks()))
    result = replace(scored.result, quality=quality)
    page = Page(report_html(ended(replace(scored, run=run, result=result), Outcome.ABORTED)))
    told = page.section("Referee decisions")
    assert "check “disk space” waived by Ann: small disk, short run" in told
    told = page.section("False starts")
    assert "-1.00 s handle touched (handle_is_touched); accepted: a cable hung on it" in told
    assert "-0.50 s door opens (door_opens); not decided" in told
    assert "door angle: 3 gaps" in page.section("Data quality")
    assert page.text.count("small disk") == 1


@pytest.mark.parametrize(
    ("word", "sentence"),
    [
        (TeamWord.ACKNOWLEDGED, "The team acknowledged the result."),
        (TeamWord.PROTESTED, "The team PROTESTED against the result."),
        (TeamWord.ABSENT, "Nobody of the team was there."),
    ],
)
def test_the_teams_word_is_told_and_signed(word: TeamWord, sentence: str, scored: Scored) -> None:
    closure = Closure(1_700_000_000.0, "R. Eferee", word, "as they said")
    final = replace(scored, run=replace(scored.run, closure=closure))
    told = Page(report_html(ended(final, Outcome.ABORTED))).section("The team's word")
    assert sentence in told
    assert "as they said" in told
    assert "Signed by referee R. Eferee" in told


def test_a_result_that_is_not_final_says_so(scored: Scored) -> None:
    still_open = replace(scored, run=replace(scored.run, closure=None, issue=2))
    page = Page(report_html(ended(still_open, Outcome.ABORTED)))
    assert "NOT FINAL" in page.section("The team's word")
    assert "not final, issue 2" in page.inside("header")


def test_the_figures_are_pictures_with_words_and_this_runs_numbers(
    page: Page, scored: Scored
) -> None:
    assert page.tags.count("figure") == page.tags.count("figcaption") == len(FigureName) + 1
    spoken = [value for name, value in page.attributes if name == "aria-label"]
    told = [words for words in spoken if words.startswith("Figure")]
    assert [words[:8] for words in told] == [f"Figure {name.number}" for name in FigureName]
    unsafety = scored.result.indicators[IndicatorName.UNSAFETY_OF_DOOR_OPERATION]
    assert unsafety.value is not None
    assert value_text(unsafety.value, unsafety.uncertainty) in told[0]
    touch = next(e for e in scored.result.events if e.event is EventName.HANDLE_IS_TOUCHED)
    assert all(f"touch at {touch.since_start:.2f} s" in told[n] for n in (0, 1, 4))
    assert len(set(told)) == len(told)


def test_the_force_figure_tells_zero_and_touch_band(page: Page, scored: Scored) -> None:
    told = page.section("Figures")
    assert f"zeroed at {scored.result.handle_zero:.2f} N" in told
    assert "1.96 N to either side, it counts as touched" in told


def test_the_passage_sensors_show_occupation_approach_and_leaving(page: Page) -> None:
    (spoken,) = [value for _, value in page.attributes if value.startswith("Passage sensors")]
    assert re.search(r"approach CCW at ([0-9.]+) s; leave CW at ([0-9.]+) s; stop at", spoken)
    begin, end = re.findall(r"(?:approach CCW|leave CW) at ([0-9.]+)", spoken)
    assert f"occupation: {begin} to {end} s" in spoken
    assert "ccw_right[0]: " in spoken
    assert f"door occupation time {float(end) - float(begin):.1f}" in page.section("Figures")


def test_all_events_are_told_with_their_times(page: Page, scored: Scored) -> None:
    told = page.section("Events")
    for event in scored.result.events:
        assert f"{event.since_start:.2f} {event.event.words}" in told


def test_a_door_that_flickers_has_its_first_and_last_events(scored: Scored) -> None:
    flicker = tuple(
        EventRecord(scored.result.start + n, float(n), EventName.DOOR_OPENS) for n in range(100)
    )
    many = replace(scored, result=replace(scored.result, events=flicker))
    told = Page(report_html(ended(many, Outcome.ABORTED))).section("Events")
    assert "0.00 door opens" in told
    assert "40 more" in told
    assert "99.00 door opens" in told


def test_a_page_has_landmarks_and_its_parts_are_linked(page: Page) -> None:
    assert [page.tags.count(tag) for tag in ("header", "nav", "main", "footer")] == [1, 1, 1, 1]
    assert "steps and events" in page.inside("nav")
    targets = {value for name, value in page.attributes if name == "href"}
    assert {f"#explained-{name}" for name in IndicatorName} <= targets
    for name in IndicatorName:
        assert name.spec.definition[1:] in page.section("What the words mean")


def test_figures_are_dark_where_the_page_is(text: str) -> None:
    body = text[text.index("</head>") :]
    assert "var(--orange)" in body
    assert re.findall(r"(?:fill|stroke|background): ?#", body) == []
    names = set(re.findall(r"var\((--[a-z-]+)\)", text))
    dark = text[text.index("(prefers-color-scheme: dark)") :]
    assert all(f"{name}: #" in text for name in names)
    assert all(f"{name}: #" in dark for name in names if name != "--phase-open")


def test_the_title_begins_with_whose_run_it_is_and_which(page: Page) -> None:
    (title,) = [words for tags, words in page.words if tags[-1:] == ("title",)]
    assert title == "Delft: run 1 of subject 3 in condition 1, completed (MADROB)"


def beside(subject: int, run_number: int, *slower: float) -> ComparedRun:
    """A run whose phases lasted a second each, and what is added."""
    lasted = [1.0 + more for more in (*slower, *(0.0,) * (4 - len(slower)))]
    phases = dict(zip(list(TimedPhase)[:4], lasted, strict=True))
    values = {**VALUES, "execution_time": sum(lasted)}
    return ComparedRun(summary(subject, 1, run_number, values=values), phases)


def test_where_the_time_went_is_told_beside_median_and_best(scored: Scored) -> None:
    place = PagePlace(field=(beside(3, 2), beside(3, 4, 0.5), beside(8, 1, 0.0, 9.0)))
    page = Page(report_html(scored, place=place))
    told = page.section("Where the time went")
    done = {record.step: record.final for record in scored.result.steps}
    touched, opened, crossed = (done[step] for step in (Step.TOUCH, Step.OPEN, Step.CROSS))
    assert touched is not None
    assert opened is not None
    assert crossed is not None
    assert f"start to touch {touched - scored.result.start:.2f} 1.00 1.00" in told
    lost = crossed - opened
    assert f"opening to crossed {lost:.2f} 1.00 1.00" in told
    assert f"most time was lost from opening to crossed: {lost - 1:.2f} s" in told
    assert "3 other completed runs of 2 teams" in told
    assert "the team's other runs in this condition is run 2." in told
    (spoken,) = [value for _, value in page.attributes if value.startswith("Where the time")]
    assert "median 4.00 s: start to touch 1.00 s" in spoken


def test_a_run_that_is_the_teams_best_is_told_so(scored: Scored) -> None:
    itself = summary(3, 1, 9, values={**VALUES, "execution_time": 1.0})
    place = PagePlace(field=(beside(3, 2),), itself=itself)
    told = Page(report_html(scored, place=place)).section("Where the time went")
    assert "This is the team's best run in this condition so far; the next is run 2" in told
    assert "team's next, s" in told


def test_a_run_with_nothing_beside_it_says_so(page: Page) -> None:
    told = page.section("Where the time went")
    assert "There is nothing to compare with" in told
    assert "median" not in told


def test_a_failed_run_says_how_long_nothing_happened_and_is_compared_with_nothing(
    scored: Scored,
) -> None:
    steps = tuple(
        replace(one, final=None) if one.step > Step.OPEN else one for one in scored.result.steps
    )
    failed = replace(scored, result=replace(scored.result, steps=steps, outcome=Outcome.TIMEOUT))
    told = Page(report_html(failed)).section("Where the time went")
    opened = next(one.final for one in steps if one.step is Step.OPEN)
    assert opened is not None
    assert scored.result.stop is not None
    assert f"For the last {scored.result.stop - opened:.2f} s no further step was done" in told
    assert "A completed run is compared with the other completed ones of condition 1" in told


def test_files_and_other_runs_are_linked_by_relative_paths(scored: Scored) -> None:
    runs = (
        LinkedRun(summary(3, 1, 2), "../other/report.html"),
        LinkedRun(summary(3, 7, 1, outcome=Outcome.TIMEOUT), ""),
    )
    place = PagePlace(files=("result.json", 'javascript:"x" #1.csv'), team=runs)
    page = Page(report_html(ended(scored, Outcome.ABORTED), place=place))
    targets = [value for name, value in page.attributes if name == "href"]
    assert "../other/report.html" in targets
    assert "result.json" in targets
    assert "javascript%3A%22x%22%20%231.csv" in targets
    told = page.section("Other runs of the team")
    assert "Condition 1 (No Force, pull, from CCW to CW): run 2 (completed, 17.43 s)" in told
    assert "run 1 (timeout, 17.43 s)" in told


def test_a_page_in_its_folder_knows_files_team_and_field(folder: Path, scored: Scored) -> None:
    results = folder.parent
    scored = replace(scored, record=replace(scored.record, competition="Autumn Cup"))

    def put(name: str, run: RunSummary, *, steps: bool = True) -> RunSummary:
        path = write(results, run)
        document = json.loads(path.read_text())
        done = [{"step": step, "name": "", "final": run.started + step} for step in Step]
        document |= {"stop": run.started + 6, "steps": done} if steps else {}
        path.write_text(json.dumps(document))
        (path.parent / "report.html").write_text(name)
        return run

    put("own", summary(3, 1, 2, source="simulated"))
    put("own, another condition", summary(3, 2, 1, source="simulated"))
    put("of another team", summary(5, 1, 1, source="simulated"))
    put("official", summary(6, 1, 1))
    put("other rules", summary(6, 1, 2, source="simulated", ruleset="eurobench-2020"))
    put("invalid", summary(6, 1, 3, source="simulated", outcome=Outcome.ABORTED))
    put("failed", summary(6, 1, 5, source="simulated", outcome=Outcome.TIMEOUT))
    put("without steps", summary(6, 1, 4, source="simulated"), steps=False)
    put("of another team 3", summary(3, 1, 6, source="simulated", competition="Spring Cup"))
    place = Surroundings().place_of(folder, scored)
    assert [(one.summary.subject, one.summary.run_number) for one in place.field] == [
        (3, 2),
        (5, 1),
    ]
    assert [(one.summary.condition, one.summary.run_number) for one in place.team] == [
        (1, 2),
        (2, 1),
    ]
    assert all((folder / one.page).is_file() for one in place.team)
    assert place.field[0].phases[TimedPhase.CROSS] == 1.0
    assert "result.json" in place.files
    assert "report.html" not in place.files
    assert place.itself is not None
    for mine in (
        replace(scored.run, outcome=Outcome.TIMEOUT),
        replace(scored.run, voided=Voiding(1.0, "wrong door", "Ada")),
    ):
        assert Surroundings().place_of(folder, replace(scored, run=mine)).field == ()


def test_data_quality_has_a_row_for_each_signal(page: Page, scored: Scored) -> None:
    told = page.section("Data quality")
    assert "Nothing to remark." in told
    for signal in scored.result.quality.signals:
        assert f"{signal.signal.value} {signal.samples}" in told


def test_ruleset_and_versions_are_told(scored: Scored) -> None:
    record = replace(scored.record, version="1.2.3")
    aborted = ended(replace(scored, record=record), Outcome.ABORTED)
    told = Page(report_html(aborted, "4.5.6")).inside("footer")
    assert "ruleset protocol" in told
    assert "Recorded with madrob-console 1.2.3; this page was made with 4.5.6" in told


def test_explanations_are_those_of_the_ruleset(scored: Scored) -> None:
    result = replace(scored.result, ruleset=RulesetName.EUROBENCH_2020)
    page = Page(report_html(ended(replace(scored, result=result), Outcome.ABORTED)))
    told = page.section("Indicators")
    assert "four things happened, in any order" in told
    assert IndicatorName.CAPABILITY_LEVEL.spec.explanation not in told


@pytest.mark.parametrize("source", [SourceKind.SIMULATED, SourceKind.REPLAY])
def test_a_run_on_no_testbed_is_marked_as_not_official(source: SourceKind, scored: Scored) -> None:
    page = Page(report_html(of_source(ended(scored, Outcome.ABORTED), source)))
    assert page.inside("body").startswith(f"{source.upper()}: not an official result.")


def test_a_rehearsal_on_a_real_testbed_is_marked_too(scored: Scored) -> None:
    real = of_source(ended(scored, Outcome.ABORTED), SourceKind.ROS)
    setup = replace(real.record.setup, practice=True)
    page = Page(report_html(replace(real, record=replace(real.record, setup=setup))))
    assert page.inside("body").startswith("PRACTICE: not an official result.")


def test_a_run_on_a_testbed_is_not(scored: Scored) -> None:
    page = Page(report_html(of_source(ended(scored, Outcome.ABORTED), SourceKind.ROS)))
    assert "official" not in page.text


def test_an_aborted_run_is_invalid_on_top_and_has_no_figures(drive: Drive) -> None:
    drive.start(make_setup())
    drive.wait(3.0)
    drive.act(Abort("robot on fire"))
    drive.finish()
    page = Page(report_html(of_source(drive.scored(), SourceKind.ROS)))
    assert page.inside("body").startswith("INVALID: the referee aborted this run.")
    assert "robot on fire" in page.inside("header")
    assert page.section("Figures") == "None: the run was aborted and is invalid."
    assert page.section("Indicators").startswith("None: run aborted: invalid.")
    assert page.section("Indicators").count("run aborted") == 1


def test_a_run_that_was_cut_off_says_so_on_top_and_shows_what_there_is(tmp_path: Path) -> None:
    drive = Drive(tmp_path)
    drive.start(make_setup())
    drive.wait(4.0)
    drive.engine.close()
    page = Page(report_html(of_source(drive.scored(), SourceKind.ROS)))
    assert page.inside("body").startswith("INTERRUPTED: the machine failed during this run.")
    assert "none: no benchmark stop" in page.section("Indicators")
    assert "The run took" not in page.text
    assert "svg" in page.tags


def test_a_run_aborted_in_the_countdown_has_a_page(drive: Drive) -> None:
    drive.prepare(make_setup())
    drive.act(Start())
    drive.wait(0.5)
    drive.act(Abort("not ready"))
    drive.finish()
    page = Page(report_html(drive.scored()))
    assert "INVALID" in page.inside("header")
    assert "The run took" not in page.text


anything = st.text(max_size=80) | st.sampled_from(
    ["<script>alert(1)</script>", "</title><b>", "\" onload='x", "&lt;&amp;", "\u202eabc", "\ud800"]
)


@settings(max_examples=60)
@given(st.lists(anything, min_size=9, max_size=9))
def test_whatever_people_typed_is_text_and_nothing_else(scored: Scored, typed: list[str]) -> None:
    aborted = ended(scored, Outcome.ABORTED)
    harmless = Page(report_html(_typed(aborted, ["x"] * 9)))
    text = report_html(_typed(aborted, [f"x{words}" for words in typed]))
    page = Page(text.encode().decode())
    assert page.tags == harmless.tags
    assert [name for name, _ in page.attributes] == [name for name, _ in harmless.attributes]
    for words in typed:
        assert " ".join(terminal_safe(f"x{words}").split()) in page.text


def _typed(scored: Scored, typed: list[str]) -> Scored:
    team, referee, competition, note, incident, withdrawn, ruling, waiver, outcome = typed
    setup = replace(scored.record.setup, team=team, referee=referee)
    run = replace(
        scored.run,
        notes=(Note(0.0, note),),
        incidents=(Incident(0.0, IncidentKind.OTHER, incident, withdrawn),),
        rulings=(Ruling(Step.OPEN, confirmed=True, time=0.0, reason=ruling, referee=referee),),
        waivers=(Waiver(CheckName.POSE, waiver, referee, 0.0),),
        false_starts=(FalseStart(0.0, EventName.DOOR_OPENS, waiver),),
        closure=Closure(0.0, referee, TeamWord.PROTESTED, note),
    )
    record = replace(scored.record, setup=setup, competition=competition)
    return ended(replace(scored, record=record, run=run), Outcome.ABORTED, outcome)


def report(*paths: Path, figures: PictureFormat | None = None, output: Path | None = None) -> int:
    return report_command.main(
        argparse.Namespace(paths=list(paths), figures=figures, output=output)
    )


def test_the_report_made_later_is_that_of_the_run(
    folder: Path, scored: Scored, capsys: pytest.CaptureFixture[str]
) -> None:
    before = {path.name for path in folder.iterdir()}
    assert report(folder) == 0
    place = Surroundings().place_of(folder, scored)
    assert (folder / "report.html").read_text() == report_html(scored, software_version(), place)
    assert {path.name for path in folder.iterdir()} - before == {"report.html"}
    assert capsys.readouterr().out == f"{folder / 'report.html'}\n"


def test_without_matplotlib_a_report_says_what_is_missing_and_has_all_else(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in ("plots", "drawing"):
        monkeypatch.delitem(sys.modules, f"scoring.figures.{module}", raising=False)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    report_pictures.figures.cache_clear()
    assert report(folder) == 0
    page = Page((folder / "report.html").read_text())
    remedy = "need matplotlib: install madrob-console with its extra `report`"
    assert remedy in page.section("Figures")
    assert "execution time" in page.section("Indicators")
    capsys.readouterr()
    assert report(folder, figures=PictureFormat.SVG) == 2
    assert remedy in capsys.readouterr().err
    report_pictures.figures.cache_clear()


def test_what_only_the_stored_result_says_of_the_data_is_in_the_report(folder: Path) -> None:
    result = folder / "result.json"
    remark = '"remarks": [\n      "recorder: 7 messages dropped"'
    changed = re.sub(r'"remarks": \[\]', remark + "]", result.read_text())
    result.write_text(changed)
    without_digests(folder)
    assert report(folder) == 0
    page = Page((folder / "report.html").read_text())
    assert "recorder: 7 messages dropped" in page.section("Data quality")


def test_a_bad_folder_is_named_and_the_rest_is_reported(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    empty = tmp_path / "empty"
    empty.mkdir()
    assert report(empty, tmp_path / "nothing", folder) == 2
    complaints = capsys.readouterr().err.splitlines()
    assert len(complaints) == 2
    assert str(empty) in complaints[0]
    assert str(tmp_path / "nothing") in complaints[1]
    assert (folder / "report.html").exists()


def test_a_results_folder_stands_for_its_runs(folder: Path) -> None:
    assert report(folder.parent) == 0
    assert (folder / "report.html").exists()


def test_reports_can_go_to_a_folder_of_their_own(folder: Path, tmp_path: Path) -> None:
    output = tmp_path / "to" / "take home"
    assert report(folder, output=output) == 0
    assert [path.name for path in output.iterdir()] == [f"{folder.name}_report.html"]
    assert not (folder / "report.html").exists()


def test_a_bag_alone_has_a_report_beside_it(folder: Path, tmp_path: Path) -> None:
    shutil.copy(next(folder.glob("*.mcap")), tmp_path / "alone.mcap")
    assert report(tmp_path / "alone.mcap") == 0
    assert "COMPLETED" in (tmp_path / "alone_report.html").read_text()


@pytest.mark.parametrize("kind", list(PictureFormat))
def test_figures_alone_are_files_named_after_what_they_show(
    kind: PictureFormat, folder: Path, tmp_path: Path
) -> None:
    assert report(folder, figures=kind, output=tmp_path / "figures") == 0
    names = {path.name for path in (tmp_path / "figures").iterdir()}
    assert names == {f"{folder.name}_{name}.{kind}" for name in FigureName}
    start = b"\x89PNG" if kind is PictureFormat.PNG else b"<?xml"
    assert all(path.read_bytes().startswith(start) for path in (tmp_path / "figures").iterdir())


def test_published_files_have_figures_but_no_report(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    published = tmp_path / "published"
    published.mkdir()
    for pattern in ("*.csv", "run_info*.yaml", "condition*.yaml"):
        for path in folder.glob(pattern):
            shutil.copy(path, published)
    assert report(published) == 2
    assert "--figures" in capsys.readouterr().err
    assert report(published, figures=PictureFormat.SVG) == 0
    assert len(list(published.glob("subject_003_cond_001_run_001_figure_*.svg"))) == len(FigureName)


def test_two_runs_of_one_name_do_not_overwrite_each_other(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = tmp_path / "other" / folder.name
    shutil.copytree(folder, other)
    assert report(folder, other, output=tmp_path / "out") == 2
    assert "choose another --output" in capsys.readouterr().err
    assert len(list((tmp_path / "out").iterdir())) == 1


def test_an_output_that_is_a_file_is_refused_in_one_line(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("in the way")
    assert report(folder, output=tmp_path / "file") == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_an_aborted_run_has_no_pictures_and_says_why(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drive = Drive(tmp_path)
    drive.start(make_setup())
    drive.wait(1.0)
    drive.act(Abort("enough"))
    drive.finish()
    folder = drive.engine.folder
    drive.engine.close()
    assert folder is not None
    assert report(folder, figures=PictureFormat.SVG) == 0
    assert list(folder.glob("figure*")) == []
    assert "invalid" in capsys.readouterr().err
