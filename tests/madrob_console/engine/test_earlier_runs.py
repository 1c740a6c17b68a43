"""What a referee and a team can rely on when an earlier run is opened again or replayed."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from madrob_console.archive import score
from madrob_console.archive.appeal import EQUAL
from madrob_console.archive.check import Grade, check_run
from madrob_console.archive.folders import next_run_number
from madrob_console.archive.history import History
from madrob_console.archive.rule_change import RuleChange, next_issue, write_next_issue
from madrob_console.archive.run_paths import RunPath
from madrob_console.archive.unfinished_runs import is_held
from madrob_console.common.errors import MadrobError
from madrob_console.engine.playback import (
    Faster,
    JumpTo,
    PlaybackCommand,
    PlayOrPause,
    SetSpeed,
    Skip,
    Slower,
)
from madrob_console.engine.snapshot import Snapshot
from madrob_console.pages.competition import competition_standings
from madrob_console.referee.acts import (
    ACTS,
    Abort,
    Act,
    DeclareTimeout,
    Finalise,
    Rule,
    SetUp,
    Start,
)
from madrob_console.referee.journal import HOLD_FILE, Entry, Origin
from madrob_console.referee.records import TeamWord
from madrob_console.referee.run import Phase
from scoring.indicator_table import RulesetName
from scoring.protocol import Outcome, Step
from tests.madrob_console.engine.drive import Deck, Drive, document, make_setup
from tests.madrob_console.engine.held_disk import HeldDisk
from tests.madrob_console.recorded_runs import (
    INCIDENT_AT,
    STOP_AT,
    appealed,
    completed,
    note_again,
)
from tests.madrob_console.run_folders import summary
from tests.slowly import slow_but_for

SIGNED = Finalise(TeamWord.ACKNOWLEDGED, "Ada")


def finished(results: Path, run_number: int = 1) -> Path:
    """A completed run on disk."""
    source = completed(run_number)
    return shutil.copytree(source, results / source.name)


def cut_off(results: Path, *acts: Act) -> Path:
    """A run whose engine was killed: no stop in the journal, no result, no end of the bag."""
    drive = Drive(results.with_name("before"))
    drive.start(make_setup())
    drive.wait(6.0)
    for act in acts:
        drive.engine.submit(act, lambda _refused: None)
    folder = drive.cut_off_copy(results)
    drive.engine.close()
    return folder


def files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def issued_by_other_rules(folder: Path) -> None:
    change = RuleChange("rules of May", RulesetName.EUROBENCH_2020, "Ada", 1_700_000_100.0)
    issue = next_issue(RunPath(folder), change)
    assert issue is not None
    write_next_issue(issue, 1_700_000_101.0)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return finished(tmp_path)


@contextmanager
def opened(folder: Path) -> Iterator[Drive]:
    drive = Drive(folder.parent)
    assert drive.open(folder) is None
    yield drive
    drive.engine.close()


def test_an_opened_run_shows_the_same_digits_and_writes_nothing(drive: Drive) -> None:
    drive.start(make_setup())
    live, folder = drive.scored_result(), drive.folder
    drive.engine.close()
    before = files(folder)
    with opened(folder) as later:
        snapshot = later.engine.snapshot()
        assert (snapshot.opened, snapshot.result) == (True, live)
        assert (snapshot.run.phase, snapshot.run.issue) == (Phase.STOPPED, 1)
        assert files(folder) == before | {HOLD_FILE: b""}
    assert files(folder) == before


@pytest.mark.parametrize("final", [False, True])
def test_a_run_re_issued_while_it_was_read_is_read_again_and_goes_on_by_its_rules(
    folder: Path, *, final: bool
) -> None:
    if final:
        with opened(folder) as drive:
            drive.act(SIGNED)
    drive = Drive(folder.parent)
    read = drive.engine.read_run(folder).result()
    issued_by_other_rules(folder)
    before, told = files(folder), list[str | None]()
    drive.engine.open_run(read, told.append)
    assert told == [f"{folder.name}: was changed meanwhile: open it once more"]
    assert (drive.engine.run.phase, drive.engine.folder) == (Phase.IDLE, None)
    assert not is_held(folder / "journal.jsonl")
    assert files(folder) == before
    with opened(folder) as drive:
        run = drive.engine.run
        assert (run.issue, run.phase, run.ruleset) == (
            *(2, Phase.STOPPED, RulesetName.EUROBENCH_2020),
        )
        drive.act(Rule(Step.CROSS, False, "came back"), SIGNED)
    stored = document(folder)
    assert (stored["issue"], stored["ruleset"], stored["closure"]["team_word"]) == (
        *(2, "eurobench-2020", "acknowledged"),
    )
    assert check_run(RunPath(folder)).grade is Grade.SAME


@pytest.mark.parametrize(
    ("acts", "outcome"),
    [((), Outcome.INTERRUPTED), ((DeclareTimeout("gave up"),), Outcome.TIMEOUT)],
    ids=["interrupted", "after a timeout"],
)
def test_a_run_that_was_cut_off_is_found_and_scored_as_it_stopped(
    tmp_path: Path, acts: Sequence[Act], outcome: Outcome
) -> None:
    results = tmp_path / "results"
    folder = cut_off(results, *acts)
    finished(results, run_number=2)
    (unfinished,) = Drive(results).engine.snapshot().unfinished
    assert (unfinished.folder, unfinished.phase) == (f"practice/{folder.name}", Phase.RUNNING)
    assert unfinished.recorded == sum(p.stat().st_size for p in folder.glob("*.mcap")) > 0
    words = "practice run 1 of subject 3 Delft was cut off while running, last line +"
    assert unfinished.words.startswith(words)
    assert acts or unfinished.last_event == "door opens"
    for _ in range(2):
        drive = Drive(results)
        assert drive.open(folder) is None
        drive.finish()
        shown, stored = drive.engine.snapshot(), document(folder)
        assert (shown.run.outcome, shown.unfinished, stored["outcome"]) == (outcome, (), outcome)
        assert 0 < (shown.elapsed or 0) < 10
        assert stored["outcome_reason"] == shown.run.outcome_reason
        assert not acts or shown.run.outcome_reason == "gave up"
        assert stored["indicators"]["time_to_handle"]["value"] is not None
        assert check_run(RunPath(folder)).differences == ()
        drive.engine.close()


def test_no_run_is_opened_while_one_goes_on_nor_by_two_consoles(
    folder: Path, tmp_path: Path, drive: Drive
) -> None:
    drive.start(make_setup(run_number=2))
    with closing(Drive(tmp_path).engine) as other:
        assert other.snapshot().unfinished == ()  # it was not cut off
        with pytest.raises(MadrobError, match="another console works on this run"):
            other.read_run(drive.folder).result()
    assert drive.open(folder) == "a run is going on"
    drive.act(Abort("enough"))
    assert drive.open(folder) == "the result of the last run is being written"
    drive.finish()
    assert drive.open(folder) is None


def test_the_handle_zero_of_today_outlives_a_look_at_an_earlier_run(
    folder: Path, drive: Drive
) -> None:
    drive.prepare(make_setup(run_number=2))
    zero = drive.engine.run.handle_zero
    assert drive.open(folder) is None
    drive.act(SetUp(make_setup(run_number=2)))
    assert drive.engine.run.handle_zero == zero != 0
    assert not drive.engine.snapshot().opened


def test_a_run_that_is_set_up_while_another_one_is_opened_leaves_that_one_to_others(
    folder: Path,
) -> None:
    disk, answers = HeldDisk(), list[str | None]()
    drive = Drive(folder.parent, disk=disk.threads())
    read = drive.engine.read_run(folder).result()
    disk.held = True
    drive.engine.open_run(read, answers.append)
    drive.act(SetUp(make_setup(run_number=4)))
    disk.come_back()
    drive.engine.step(0.0)
    assert "run 4 of subject 3 was set up meanwhile, and stays" in str(answers)
    assert not is_held(folder / "journal.jsonl")


def test_losses_that_only_the_stored_result_knows_are_kept(folder: Path) -> None:
    lost = "/madrob/door/angle: 3 messages were lost on the way"
    changed = document(folder)
    changed["quality"]["lost"].append(lost)
    (folder / "result.json").write_bytes(msgspec.json.encode(changed))
    note_again(folder)
    with opened(folder) as drive:
        result = drive.engine.snapshot().result
        assert result is not None
        assert result.quality.lost == (lost,)


def test_a_folder_without_its_journal_gets_one_again(folder: Path) -> None:
    (folder / "journal.jsonl").unlink()
    with opened(folder) as drive:
        drive.act(Finalise(TeamWord.ABSENT, "Ada"))
    with opened(folder) as drive:
        assert drive.engine.run.phase is Phase.FINAL


def never_started(results: Path) -> Path:
    """A run whose engine was killed when its folder was made and its countdown had not begun."""
    folder = finished(results)
    for path in folder.iterdir():
        if path.suffix not in (".mcap", ".jsonl") and path.name != "metadata.yaml":
            path.unlink()
    journal = folder / "journal.jsonl"
    before, _, _ = journal.read_text().partition('"what": "countdown begins"')
    journal.write_text(before[: before.rindex("\n") + 1])
    return folder


@pytest.mark.parametrize("why", ["", "the disk did not take it within 2 s"])
def test_a_run_that_was_never_started_is_not_asked_about_and_counts_nowhere(
    tmp_path: Path, why: str
) -> None:
    folder = never_started(tmp_path)
    if why:
        line = Entry(3.0, Origin.SYSTEM, "withdrawn", reason=why, details={"act": "start"})
        with (folder / "journal.jsonl").open("a") as journal:
            journal.write(line.to_json() + "\n")
    drive = Drive(tmp_path)
    assert drive.engine.snapshot().unfinished == ()
    with pytest.raises(MadrobError, match="the run was never started"):
        drive.open(folder)
    (run,) = History(tmp_path).refresh()
    never = "the run was never started" + (f": {why}" if why else "")
    assert (run.outcome_word, run.problem, run.team, run.never_ran) == (
        *("never ran", None, "Delft", never),
    )
    valid = summary(subject=3, condition=1, team="Delft", ruleset="protocol", source="simulated")
    standings = competition_standings([run, valid], made=0.0, official=False)
    assert not standings.left_out
    assert standings.groups[0].overall[0].without_result == 0
    assert next_run_number(tmp_path, 3, 1) == 2


DOOR = "/madrob/door/angle"
NAN, INF = float("nan"), float("inf")


@pytest.fixture(scope="module")
def run_folder() -> Path:
    return appealed()


@pytest.fixture
def deck(run_folder: Path) -> Deck:
    return Deck(run_folder)


# ---------------------------------------------------------------- what is shown


def test_at_its_end_a_replay_shows_the_stored_result_to_the_last_digit(run_folder: Path) -> None:
    deck = Deck(run_folder, speed=0)
    shown, stored = deck.to_the_end(), document(run_folder)
    scored = next(score(run_folder)).result
    assert (shown.result, shown.result_source) == (scored, "replay")
    values = {str(name): i.value for name, i in scored.indicators.items()}
    assert values == {name: i["value"] for name, i in stored["indicators"].items()}
    assert (deck.at.comparison, deck.at.agrees) == (EQUAL, True)
    # the later decisions stand on it
    assert shown.run.closure is not None
    assert (shown.run.closure.team_word, shown.run.issue) == (TeamWord.ACKNOWLEDGED, 2)
    assert [line.text for line in shown.log if line.origin == "referee"][-5:] == [
        "referee denies step 3: a draught",
        "result signed by R. Eferee, protested by the team: they saw it differently",
        "re-issue: appeal granted",
        "referee confirms step 3: video",
        "result signed by R. Eferee, acknowledged by the team",
    ]


def test_what_sensors_and_referee_say_is_shown_as_it_was_at_that_time(deck: Deck) -> None:
    def shown_at(time: float) -> Snapshot:
        deck.do(JumpTo(time))
        return deck.shown

    counting = shown_at(-0.1).run  # what was up before the countdown is no false start
    assert (counting.phase, counting.false_starts) == (Phase.COUNTDOWN, ())
    before = shown_at(INCIDENT_AT - 0.1)
    assert [w.reason for w in before.run.waivers] == ["spring is warm"]
    assert (before.run.incidents, before.run.notes, before.steps[2].final) == ((), (), None)
    after = shown_at(INCIDENT_AT + 0.1)
    assert [mark.note for mark in after.run.incidents] == ["frame"]
    assert after.log[-2].text == "incident: collision: frame"
    assert after.log[-2].relative == pytest.approx(INCIDENT_AT, abs=0.03)
    late, stopped = shown_at(STOP_AT - 0.5), shown_at(STOP_AT + 0.5)
    assert (late.run.phase, late.door.is_open) == (Phase.RUNNING, True)
    assert late.steps[2].final is not None
    assert (stopped.run.outcome, stopped.result) == (Outcome.TIMEOUT, None)
    assert essence(shown_at(INCIDENT_AT - 0.1)) == essence(before)


# ---------------------------------------------------------------- controls


def test_it_plays_as_fast_as_is_asked(run_folder: Path) -> None:
    deck = Deck(run_folder, speed=0, work=0.002)
    deck.step(5)  # as fast as possible, which can be left where it is
    for speed in (1.0, 0.5, 2.0, 5.0):
        deck.do(SetSpeed(speed))
        before = deck.at.position
        deck.let_pass(0.4)
        assert deck.at.position - before == pytest.approx(0.4 * speed, abs=0.04 * speed + 0.02)
    deck.do(*[Slower()] * 5)
    found = [deck.at.speed]
    for _ in range(6):
        deck.do(Faster())
        found.append(deck.at.speed)
    assert found == [0.5, 1.0, 2.0, 5.0, 10.0, 10.0, 10.0]


def test_paused_it_stands_still_and_a_machine_that_slept_skips_nothing(
    deck: Deck,
) -> None:
    deck.let_pass(1.0)
    deck.do(PlayOrPause())
    before, position = deck.shown, deck.at.position
    deck.let_pass(5.0)
    assert deck.shown == before
    deck.do(PlayOrPause())
    deck.let_pass(1.0)
    assert deck.at.position == pytest.approx(position + 1.0, abs=0.03)
    deck.world.now += 3600.0
    deck.step()
    assert deck.at.position <= position + 1.15


def test_a_step_is_one_sample_of_the_door_there_and_back_and_steps_add_up(deck: Deck) -> None:
    deck.do(JumpTo(3.5), Skip(0.02))
    first, position = deck.shown, deck.at.position
    deck.do(Skip(0.02))
    assert deck.at.paused
    assert deck.at.position == pytest.approx(position + 0.02)
    door = [next(t for t in s.topics if t.topic == DOOR) for s in (first, deck.shown)]
    assert door[1].received == door[0].received + 1
    deck.do(Skip(-0.02))
    assert essence(deck.shown) == essence(first)
    for _ in range(5):
        assert deck.engine.control(Skip(-0.4)) is None
    deck.do(Skip(0.0))
    assert deck.at.position == pytest.approx(position - 2.0, abs=0.011)


@pytest.mark.parametrize(
    ("command", "words"),
    [
        *((JumpTo(to), "the recording goes from -2.0 to 6.4 s") for to in (-60.0, 60.0, NAN, INF)),
        *((Skip(by), "give a number of seconds") for by in (NAN, -INF, 1e308)),
        *((SetSpeed(speed), "use 0 to 1000") for speed in (-1.0, NAN, INF, 1001.0)),
    ],
)
def test_what_leads_out_of_the_recording_is_refused_in_words(
    run_folder: Path, command: PlaybackCommand, words: str
) -> None:
    deck = Deck(run_folder)
    assert words in str(deck.engine.control(command))
    assert deck.at.jumping_to is None
    if isinstance(command, SetSpeed):
        with pytest.raises(MadrobError, match=words):
            Deck(run_folder, command.speed)


def test_at_the_end_it_stays_until_it_is_sent_back(deck: Deck) -> None:
    deck.to_the_end()
    end = deck.at.position
    deck.let_pass(2.0)
    assert deck.at.position == end == deck.at.end
    assert "goes back" in str(deck.engine.control(PlayOrPause()))
    deck.do(Skip(-1.0))
    assert deck.at.position == pytest.approx(end - 1.0)
    assert deck.shown.result is None


def test_long_work_comes_in_slices_so_that_keys_are_heeded(run_folder: Path) -> None:
    work = 0.002
    deck = Deck(run_folder, work=work)
    for stops in (False, True):
        assert deck.engine.control(JumpTo(5.0 - 4.0 * stops)) is None
        while deck.at.jumping_to is not None:
            began = deck.world.now
            deck.step()
            assert deck.world.now - began <= 10 * work
            if stops:
                deck.do(PlayOrPause())  # a pause ends a jump where it is
        assert deck.at.position == pytest.approx(5.0, abs=0.011) or stops
    assert deck.at.paused
    assert deck.at.position < 1.0


COMMANDS = st.lists(
    st.one_of(
        st.builds(PlayOrPause),
        st.builds(Faster),
        st.builds(Slower),
        st.builds(SetSpeed, st.sampled_from([0.0, 3.0, 1000.0])),
        st.builds(Skip, st.sampled_from([0.02, -0.02, 1.0, -1.0, 0.3])),
        st.builds(JumpTo, st.floats(-2.0, 6.0)),
    ),
    max_size=6,
)


def essence(shown: Snapshot) -> Snapshot:
    """Without the numbers of the log's lines and what the keys have set."""
    lines = tuple(replace(line, number=0) for line in shown.log)
    return replace(shown, log=lines, playback=None)


@pytest.mark.slow
def test_what_is_shown_at_a_time_depends_on_no_key(
    run_folder: Path, request: pytest.FixtureRequest
) -> None:
    @settings(max_examples=request.config.getoption("--runs"))
    @given(commands=COMMANDS, at=st.floats(-2.0, 6.0))
    def prove(commands: list[PlaybackCommand], at: float) -> None:
        straight, pressed = Deck(run_folder), Deck(run_folder)
        straight.do(JumpTo(at))
        for command in commands:
            pressed.engine.control(command)
            pressed.step(3)
        pressed.do(JumpTo(at))
        assert essence(pressed.shown) == essence(straight.shown)
        assert essence(pressed.to_the_end()) == essence(straight.to_the_end())

    prove()


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """The same run, to be spoilt."""
    return shutil.copytree(appealed(), tmp_path / appealed().name)


# ---------------------------------------------------------------- nobody's record


def everything_in(root: Path) -> dict[str, tuple[int, bytes]]:
    return {
        str(path): (path.stat().st_mtime_ns, path.read_bytes() if path.is_file() else b"")
        for path in root.rglob("*")
    }


def test_a_replay_writes_nothing_anywhere_near_the_results(copy: Path) -> None:
    before = everything_in(copy.parent)
    deck = Deck(copy)
    deck.do(JumpTo(4.0), JumpTo(1.0))
    deck.to_the_end()
    deck.engine.close()
    assert everything_in(copy.parent) == before


def test_no_act_does_anything_and_each_is_refused_with_the_reason(deck: Deck) -> None:
    deck.do(JumpTo(4.0))
    before = deck.shown
    acts = (Abort("x"), DeclareTimeout(), Rule(Step.TOUCH, confirmed=True, reason="x"))
    for act in (*acts, SetUp(make_setup()), Finalise(TeamWord.ABSENT, "me"), Start()):
        assert "nothing can be done to the run" in str(deck.engine.perform(act))
    assert set(deck.shown.refusals) >= {act.name for act in ACTS}
    assert deck.shown == before
    assert "leave it to open another one" in str(deck.engine.opening_refusal())


# ---------------------------------------------------------------- appeals


@pytest.mark.parametrize(
    ("edit", "words", "agrees"),
    [
        (lambda value: value + 1e-12, "equals the stored result to 1e-9: ", True),
        (lambda value: value * (1 + 2e-9), "differs from the stored result: ", False),
    ],
)
def test_a_stored_result_that_the_bag_does_not_give_is_told_value_by_value(
    copy: Path, edit: Callable[[float], float], words: str, agrees: bool
) -> None:
    stored = document(copy)
    indicator = stored["indicators"]["execution_time"]
    measured, indicator["value"] = indicator["value"], edit(indicator["value"])
    (copy / "result.json").write_text(json.dumps(stored))
    note_again(copy)  # else it would be told as a changed file
    deck = Deck(copy)
    deck.to_the_end()
    told = f"execution time {measured!r}, stored {indicator['value']!r}"
    assert deck.at.comparison.startswith(f"{words}{told}")
    assert deck.at.agrees is agrees


@pytest.mark.parametrize(
    ("content", "told"),
    [("{", "result.json is damaged"), (None, "no stored result lies beside the recording")],
)
def test_without_a_usable_stored_result_it_says_so(
    copy: Path, content: str | None, told: str
) -> None:
    path = copy / "result.json"
    path.unlink()
    if content is not None:
        path.write_text(content)
    deck = Deck(copy)
    deck.to_the_end()
    assert told in deck.at.comparison


def test_a_journal_that_lost_a_line_is_told_from_the_one_in_the_bag(copy: Path) -> None:
    journal = copy / "journal.jsonl"
    lines = journal.read_text().splitlines(keepends=True)
    journal.write_text("".join(line for line in lines if "collision" not in line))
    assert any("the journal lacks 1 of the" in fault for fault in Deck(copy).shown.faults)


# ---------------------------------------------------------------- bad recordings


def test_a_bag_alone_is_played_with_the_decisions_that_it_holds(copy: Path) -> None:
    (bag,) = copy.glob("*.mcap")
    run = Deck(bag).to_the_end().run
    assert (run.outcome, len(run.incidents), run.rulings) == (Outcome.TIMEOUT, 1, ())


def test_a_replay_of_a_run_without_a_stop_is_interrupted(copy: Path) -> None:
    journal = copy / "journal.jsonl"
    before, _, _ = journal.read_text().partition(f'"what": "{DeclareTimeout.name}"')
    journal.write_text(before[: before.rindex("\n") + 1])
    (copy / "result.json").unlink()
    shown = Deck(copy).to_the_end()
    assert (shown.run.outcome, shown.result) == (Outcome.INTERRUPTED, next(score(copy)).result)


@pytest.mark.parametrize("share", slow_but_for([0.4, 0.8], 0.4))
def test_a_torn_bag_is_played_to_where_it_ends_and_that_is_said(copy: Path, share: float) -> None:
    (bag,) = copy.glob("*.mcap")
    os.truncate(bag, int(bag.stat().st_size * share))
    deck = Deck(copy)
    assert any("what comes before that is read" in fault for fault in deck.shown.faults)
    shown, scored = deck.to_the_end(), next(score(copy)).result
    assert (shown.result, shown.run.phase) == (scored, Phase.FINAL)
    assert any("what comes before" in remark for remark in scored.quality.remarks)
