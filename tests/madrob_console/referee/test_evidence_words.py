"""What is said of the evidence of a run, live and in its account; nothing is scored from it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import pytest

from madrob_console.referee.evidence_account import (
    EvidenceAccount,
    EvidenceGap,
    EvidenceLoss,
    RecordedTopic,
)
from madrob_console.referee.evidence_state import EvidenceState, EvidenceTopic
from madrob_console.referee.records import FaultKind

START = 1_700_000_000.0
IMAGE = "sensor_msgs/msg/Image"
DISK = EvidenceLoss.DISK
LEFT = RecordedTopic("/left", IMAGE, messages=10, bytes=4_000_000)
RIGHT = RecordedTopic("/right", IMAGE, messages=1, bytes=500_000, left_out=3)
POOR = replace(LEFT, lost={DISK: 2}, problem="cannot be read")
GAP = EvidenceGap(2.0, 3.5, "its process ended")
OPEN = EvidenceGap(7.25, None, "its process ended")


@pytest.mark.parametrize(
    ("account", "words", "remarks"),
    [
        (EvidenceAccount(), "0 topics, 0 messages, 0.0 MB", []),
        (EvidenceAccount((LEFT,)), "1 topic, 10 messages, 4.0 MB", []),
        (
            EvidenceAccount((LEFT, RIGHT), unwritten=4),
            "2 topics, 11 messages, 4.5 MB, 4 of them still being written",
            ["/right: 3 left out by `recording.limits`"],
        ),
        (
            EvidenceAccount((POOR,), ("no room",), unwritten=None),
            "1 topic, 10 messages, 4.0 MB, 2 lost, not known how many of them are on disk",
            ["no room", f"/left: 2 lost (2 {DISK}), cannot be read"],
        ),
        (
            EvidenceAccount((POOR,), gaps=(GAP,)),
            "1 topic, 10 messages, 4.0 MB, at least 2 lost, missing from +2.0 s to +3.5 s",
            [f"/left: at least 2 lost (2 {DISK}), cannot be read"],
        ),
        (
            EvidenceAccount((LEFT,), gaps=(GAP, OPEN)),
            "1 topic, 10 messages, 4.0 MB, missing from +2.0 s to +3.5 s and 1 time more",
            ["missing from +2.0 s to +3.5 s, from +7.2 s to the end"],
        ),
        (
            EvidenceAccount((replace(LEFT, bytes=None),), file_bytes=9_000_000),
            "1 topic, 10 messages, 9.0 MB",
            [],
        ),
    ],
)
def test_an_account_says_what_is_there_and_what_is_missing(
    account: EvidenceAccount, words: str, remarks: list[str]
) -> None:
    assert (account.words, account.remarks()) == (words, remarks)


@pytest.mark.parametrize(
    ("counts", "topics", "size"),
    [
        ({"/left": (IMAGE, 10)}, (LEFT,), None),
        (
            {"/left": (IMAGE, 5)},
            (replace(LEFT, messages=5, bytes=2_000_000, lost={DISK: 5}),),
            None,
        ),
        ({}, (replace(LEFT, messages=0, bytes=0, lost={DISK: 10}),), None),
        ({"/left": (IMAGE, 12)}, (replace(LEFT, messages=12, bytes=4_800_000),), None),
        (
            {"/left": (IMAGE, 10), "/a": ("x/msg/Y", 2)},
            (RecordedTopic("/a", "x/msg/Y", messages=2, bytes=None), LEFT),
            77,
        ),
    ],
)
def test_an_account_is_settled_by_what_is_in_the_files(
    counts: Mapping[str, tuple[str, int]], topics: tuple[RecordedTopic, ...], size: int | None
) -> None:
    account = EvidenceAccount((LEFT,), ("before",), unwritten=3, gaps=(GAP,))
    settled = account.settled(counts, ["then"], 77)
    assert settled == EvidenceAccount(topics, ("before", "then"), 0, (GAP,), size)


def topic(name: str = "/left", **changes: object) -> EvidenceTopic:
    return replace(EvidenceTopic(name, IMAGE, messages=5, rate=10.0), **changes)  # type: ignore[arg-type]


SILENT = topic(rate=0.0, silent_since=START + 4.0)
LOSES = topic("/right", lost={DISK: 3})
GOES_ON = EvidenceGap(START + 2.0, None, "its process ended")
OVER = replace(GOES_ON, end=START + 3.5)


def recording(*topics: EvidenceTopic, **changes: object) -> EvidenceState:
    state = EvidenceState(recording=True, topics=topics, recorded=topics)
    return replace(state, **changes)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("state", "faults", "missing", "worst"),
    [
        (EvidenceState(problem="no room"), [], "", ""),
        (recording(topic()), [], "", ""),
        (
            recording(SILENT, LOSES),
            ["/left: silent since +4.0 s"],
            "",
            "/left silent since +4.0 s and 1 more",
        ),
        (recording(topic(), LOSES), [], "", "/right 3 lost"),
        (recording(replace(SILENT, durable=True)), [], "", "/left silent since +4.0 s"),
        (recording(replace(SILENT, messages=0)), [], "", "/left silent since +4.0 s"),
        (
            recording(topic(publishers=0, problem="cannot be read")),
            ["/left: cannot be read"],
            "",
            "/left cannot be read",
        ),
        (recording(LOSES, problem="no room"), ["no room"], "", "/right 3 lost"),
        (recording(stuck="the disk takes nothing"), ["the disk takes nothing"], "", ""),
        (
            recording(gaps=(GOES_ON,), problem="no room"),
            ["nothing is recorded since +2.0 s, it is starting again: its process ended"],
            "",
            "",
        ),
        (recording(LOSES, gaps=(OVER,)), [], "missing from +2.0 s to +3.5 s", "/right 3+ lost"),
        (
            recording(gaps=(OVER, OVER, GOES_ON)),
            ["nothing is recorded since +2.0 s, it is starting again: its process ended"],
            "missing 2 times",
            "",
        ),
        (recording(LOSES, gaps=(OVER,), recording=False), [], "", "/right 3 lost"),
        (recording(recording=False, finishing=True, problem="no room"), ["no room"], "", ""),
    ],
)
def test_what_a_run_loses_is_said_while_it_is_recorded(
    state: EvidenceState, faults: list[str], missing: str, worst: str
) -> None:
    assert list(state.faults(START)) == faults
    assert (state.missing_words(START), state.worst(START)) == (missing, worst)


def test_what_the_journal_and_the_account_get_is_told_by_topic() -> None:
    state = recording(SILENT, LOSES, problem="no room", gaps=(OVER,), unwritten=2)
    lost = f"messages are lost ({DISK})"
    assert state.silences == {"/left": START + 4.0}
    assert state.troubles == {
        ("/right", FaultKind.EVIDENCE): lost,
        ("recording", FaultKind.EVIDENCE): "no room",
    }
    assert ("recording", FaultKind.EVIDENCE) not in replace(state, gaps=(GOES_ON,)).troubles
    assert state.account_since(START) == EvidenceAccount(
        (
            RecordedTopic("/left", IMAGE, messages=5, problem="silent since +4.0 s"),
            RecordedTopic("/right", IMAGE, messages=5, lost={DISK: 3}),
        ),
        unwritten=2,
        gaps=(EvidenceGap(2.0, 3.5, "its process ended"),),
    )


def test_a_process_that_takes_over_adds_its_counts() -> None:
    before = topic(
        bytes=100, left_out=1, lost={DISK: 3}, problem="late", silent_since=START, rate=1.0
    )
    now = topic(bytes=20, left_out=2, lost={DISK: 1}, first=START + 9.0)
    whole = replace(now, messages=10, bytes=120, left_out=3, lost={DISK: 4}, problem="late")
    assert now.after(before) == whole
    assert now.after(None) is now
    untold = replace(before, bytes=None), replace(now, bytes=None)
    assert (now.after(untold[0]).bytes, untold[1].after(before).bytes) == (20, 100)
    assert replace(now, first=None).after(before).silent_since == START
