"""A replay leaves the record of a run alone, and says where it is not whole or not the same."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from madrob_console.archive import score
from madrob_console.archive.run_record import RECORD_NAME
from madrob_console.engine.shown.playback import (
    JumpTo,
)
from madrob_console.errors import MadrobError
from madrob_console.messages.codec import DEFAULT_MAPPINGS, MessageTypes, describe_topic
from madrob_console.referee.acts import (
    ACTS,
    Abort,
    DeclareTimeout,
    Finalise,
    Rule,
    SetUp,
    Start,
)
from madrob_console.referee.on_record import TeamWord
from recorder.message import RawMessage
from recorder.writer import BagWriter
from scoring.indicator_table import IndicatorName
from scoring.protocol import Outcome, Step
from tests.madrob_console.engine.deck import Deck
from tests.madrob_console.engine.drive import make_setup
from tests.madrob_console.recorded_runs import STOP_AT, appealed, without_digests
from tests.slowly import slow_but_for


@pytest.fixture(scope="module")
def folder() -> Path:
    return appealed()


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """The same run, to be spoilt."""
    return shutil.copytree(appealed(), tmp_path / appealed().name)


def edit_result(folder: Path, **indicators: float) -> None:
    """What somebody does who wants another result."""
    without_digests(folder)  # else it would be told as a changed file
    path = folder / "result.json"
    document = json.loads(path.read_text())
    for name, value in indicators.items():
        document["indicators"][name]["value"] = value
    path.write_text(json.dumps(document))


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


def test_no_act_does_anything_and_each_is_refused_with_the_reason(folder: Path) -> None:
    deck = Deck(folder)
    deck.do(JumpTo(4.0))
    before = deck.shown
    acts = (Abort("x"), DeclareTimeout(), Rule(Step.TOUCH, confirmed=True, reason="x"))
    for act in (*acts, SetUp(make_setup()), Finalise(TeamWord.ABSENT, "me"), Start()):
        assert "nothing can be done to the run" in str(deck.engine.perform(act))
    assert set(deck.shown.refusals) >= {act.name for act in ACTS}
    assert deck.shown == before
    assert "leave it to open another one" in str(deck.engine.opening_refusal())


# ---------------------------------------------------------------- appeals


def test_a_stored_result_that_the_bag_does_not_give_is_told_value_by_value(copy: Path) -> None:
    edit_result(copy, execution_time=STOP_AT + 0.25, roughness_of_door_actuation=1.0)
    deck = Deck(copy)
    result = deck.to_the_end().result
    assert result is not None
    measured = result.indicators[IndicatorName.EXECUTION_TIME].value
    assert deck.at.comparison.startswith(
        f"differs from the stored result: execution time {measured:.2f}, stored 5.25; roughness"
    )
    assert not deck.at.agrees


def test_a_difference_in_the_last_digit_is_told_and_agrees_to_1e_9(copy: Path) -> None:
    stored = json.loads((copy / "result.json").read_text())
    value = stored["indicators"]["execution_time"]["value"]
    edit_result(copy, execution_time=value + 1e-12)
    deck = Deck(copy)
    deck.to_the_end()
    assert deck.at.comparison.startswith(
        "equals the stored result to 1e-9: "
        f"execution time {value!r}, stored {value + 1e-12!r} (the same libraries (Python "
    )
    assert deck.at.agrees


def test_a_difference_beyond_1e_9_is_told_in_the_digits_that_show_it(copy: Path) -> None:
    stored = json.loads((copy / "result.json").read_text())
    value = stored["indicators"]["execution_time"]["value"]
    edit_result(copy, execution_time=value * (1 + 2e-9))
    deck = Deck(copy)
    deck.to_the_end()
    assert f"execution time {value!r}, stored {value * (1 + 2e-9)!r}" in deck.at.comparison
    assert deck.at.comparison.startswith("differs from")
    assert not deck.at.agrees


def test_without_a_usable_stored_result_it_says_so(copy: Path) -> None:
    (copy / "result.json").write_text("{")
    deck = Deck(copy)
    deck.to_the_end()
    assert "result.json is damaged" in deck.at.comparison
    (copy / "result.json").unlink()
    deck = Deck(copy)
    deck.to_the_end()
    assert deck.at.comparison == "no stored result lies beside the recording"


def test_a_journal_that_lost_a_line_is_told_from_the_one_in_the_bag(copy: Path) -> None:
    journal = copy / "journal.jsonl"
    lines = journal.read_text().splitlines(keepends=True)
    journal.write_text("".join(line for line in lines if "collision" not in line))
    assert any("the journal lacks 1 of the" in fault for fault in Deck(copy).shown.faults)


# ---------------------------------------------------------------- bad recordings


def torn(copy: Path, share: float) -> Path:
    """The bag of a run folder, cut off."""
    (bag,) = copy.glob("*.mcap")
    data = bag.read_bytes()
    bag.write_bytes(data[: int(len(data) * share)])
    return copy


@pytest.mark.parametrize("share", slow_but_for([0.4, 0.8], 0.4))
def test_a_torn_bag_is_played_to_where_it_ends_and_that_is_said(copy: Path, share: float) -> None:
    deck = Deck(torn(copy, share))
    assert any("what comes before that is read" in fault for fault in deck.shown.faults)
    shown = deck.to_the_end()
    assert shown.result == next(score(copy)).result
    assert shown.run.closure is not None
    assert any("what comes before" in remark for remark in shown.result.quality.remarks)


def test_a_bag_alone_is_played_with_the_decisions_that_it_holds(copy: Path) -> None:
    (bag,) = copy.glob("*.mcap")
    shown = Deck(bag).to_the_end()
    assert shown.run.outcome is Outcome.TIMEOUT
    assert len(shown.run.incidents) == 1
    assert shown.run.rulings == ()


def test_a_run_without_a_stop_is_interrupted(copy: Path) -> None:
    journal = copy / "journal.jsonl"
    lines = journal.read_text().splitlines(keepends=True)
    journal.write_text("".join(lines[: [i for i, t in enumerate(lines) if "timeout" in t][-1]]))
    (copy / "result.json").unlink()
    shown = Deck(torn(copy, 0.4)).to_the_end()
    assert shown.run.outcome is Outcome.INTERRUPTED
    assert shown.result == next(score(copy)).result


def bags_of_no_run(folder: Path) -> Iterator[tuple[Path, str]]:
    """Bags that cannot be replayed, with the words that say why."""
    types = MessageTypes()
    door = describe_topic(types, DEFAULT_MAPPINGS[0].topic, DEFAULT_MAPPINGS[0].type)
    data = types.encode(door.type, types.make(door.type))
    message = RawMessage(door.name, door.type, data, 10**18, 10**18)
    for name, records, messages, words in (
        ("foreign", {}, [message], "a bag without a MADROB run cannot be replayed"),
        ("empty", {}, [], "holds no messages"),
        ("odd", {RECORD_NAME: {"run": "{}"}}, [message], "damaged"),
    ):
        with BagWriter(folder / name, [door], records) as writer:
            for one in messages:
                writer.put(one)
        yield folder / name, words
    (folder / "notes.mcap").write_text("no bag")
    yield folder / "notes.mcap", "is no bag"
    yield folder / "missing", "cannot read"


def test_what_cannot_be_replayed_is_refused_in_one_line(tmp_path: Path) -> None:
    for path, words in bags_of_no_run(tmp_path):
        with pytest.raises(MadrobError) as refused:
            Deck(path)
        assert words in str(refused.value)
        assert path.name in str(refused.value)
        assert "\n" not in str(refused.value)


def test_a_run_that_was_never_started_is_refused_in_one_line(copy: Path) -> None:
    journal = copy / "journal.jsonl"
    journal.write_text(journal.read_text().splitlines(keepends=True)[0])
    with pytest.raises(MadrobError, match="never started"):
        Deck(copy)


@pytest.mark.parametrize("speed", [-1.0, float("nan"), float("inf"), 1001.0])
def test_an_impossible_speed_is_refused(folder: Path, speed: float) -> None:
    with pytest.raises(MadrobError, match="use 0 to 1000"):
        Deck(folder, speed)
