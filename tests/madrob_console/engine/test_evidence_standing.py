"""What the engine says of a recording, through all the processes that recorded it."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from madrob_console.engine.evidence_client import EvidencePlace, EvidenceStatus
from madrob_console.engine.evidence_status import (
    COMES_BACK,
    EvidenceNews,
    EvidenceRecording,
    status_of,
)
from madrob_console.referee.evidence_account import (
    EvidenceAccount,
    EvidenceGap,
    EvidenceLoss,
    EvidenceTopic,
)

KILLED = "it was ended by SIGKILL"
USED_UP = "the budget is used up"
LEFT = "/left"


class Recorded:
    """A recording of which its process tells; s of a monotonic clock, which is steady time here."""

    def __init__(self) -> None:
        self.recording = EvidenceRecording(1, EvidencePlace("run", 0, 0, 10**9, 0))
        self.recording.next_file()

    def told(self, at: float, *topics: EvidenceTopic, **news: object) -> EvidenceStatus:
        """Its process says this of the recording."""
        told = EvidenceNews(settled=True, topics=topics, number=1)
        told = replace(told, **news)
        self.recording.hear(told, at)
        return status_of(at, told, at, "", self.recording)

    def comes(self, at: float, first: dict[str, float], saved: float | None) -> EvidenceStatus:
        """Topics that come since then, and up to when there is something in the file."""
        return self.told(
            at, *(topic(name, first=when) for name, when in first.items()), saved=saved
        )

    def is_killed(self) -> None:
        self.recording.lose_process(KILLED)
        self.recording.next_file()


def topic(name: str = LEFT, silent_since: float | None = None, **more: object) -> EvidenceTopic:
    return EvidenceTopic(
        name,
        "a/msg/B",
        rate=10.0,
        byte_rate=1e6,
        silent_since=silent_since,
        **more,  # type: ignore[arg-type]
    )


@pytest.fixture
def run() -> Recorded:
    return Recorded()


def test_what_ended_a_recording_is_told_while_it_goes_on_and_holds_up_no_run_after_it(
    run: Recorded,
) -> None:
    assert run.told(1.0, failed=USED_UP).problem == USED_UP
    run.recording.ended = 2.0
    over = run.told(2.5, failed=USED_UP, ended=True, finished=True)
    assert over.problem is None
    assert over.problems == (USED_UP,)


def test_what_goes_wrong_after_a_recording_is_told_until_the_next_one(run: Recorded) -> None:
    assert run.told(1.0).problem is None
    run.recording.ended = 2.0
    for at in (2.5, 9.5):
        assert run.told(at, failed="it could not be finished", finished=True).problem is not None


@pytest.mark.parametrize(
    ("spoil", "unwritten", "problem"),
    [
        ("nothing", 0, ""),
        ("killed", None, f"the evidence process had to be started again: {KILLED}"),
        ("silent", None, "said nothing in the last 13 s of the recording"),
    ],
)
def test_what_a_process_had_on_its_way_is_known_only_if_it_has_counted_all(
    run: Recorded, spoil: str, unwritten: int | None, problem: str
) -> None:
    told = run.told(1.0, topic())
    assert (told.unwritten, told.problems) == (0, ())
    if spoil == "killed":
        run.is_killed()
    run.recording.ended = 14.0
    if spoil != "silent":
        run.told(14.1, topic(), ended=True)
    account = status_of(14.5, None, 14.1, "", run.recording).account_since(0.0)
    assert account.unwritten == unwritten
    assert problem in "".join(account.problems)
    assert account.words.endswith("not known how many of them are on disk") is (unwritten is None)


def test_what_was_told_before_a_process_fell_silent_is_not_told_as_what_comes_now(
    run: Recorded,
) -> None:
    fresh = run.told(1.0, topic())
    assert [one.rate for one in fresh.topics] == [10.0]
    old = status_of(4.0, EvidenceNews(settled=True, topics=(topic(),)), 1.0, "", run.recording)
    assert old.problem == "the evidence process is silent for 3 s"
    assert (old.topics, old.byte_rate, old.ready) == ((), 0, False)
    assert old.recorded == fresh.recorded


@pytest.mark.parametrize(
    ("unsynced", "queued", "said"),
    [
        (1.0, 3_000_000, None),
        (9.8, 31_400_000, "the disk has taken nothing for 10 s, 31.4 MB wait in memory"),
    ],
)
def test_a_disk_that_takes_nothing_is_told_beside_what_still_comes(
    run: Recorded, unsynced: float, queued: int, said: str | None
) -> None:
    status = run.told(1.0, topic(), unsynced=unsynced, queued=queued)
    assert status.trouble(0.0) == said
    assert status.problem is None  # it may take all of it yet
    run.recording.ended = 2.0
    assert run.told(2.0, topic(), unsynced=unsynced, queued=queued).trouble(0.0) is None


# One function says live and afterwards what is wrong with a topic.


@pytest.mark.parametrize(
    ("told", "words"),
    [
        (topic(), ""),
        (topic(LEFT, 13.9), "silent since +3.9 s"),
        (
            topic(LEFT, lost={EvidenceLoss.BEHIND: 3}, problem="it is also a/B"),
            "it is also a/B, 3 lost",
        ),
    ],
)
def test_the_same_words_are_told_of_a_topic_live_and_in_the_account(
    run: Recorded, told: EvidenceTopic, words: str
) -> None:
    start = 10.0
    status = run.told(40.0, told)
    assert status.view(start, None).worst == (words and f"{LEFT} {words}")
    remark = ", ".join(filter(None, (told.lost_words, told.words_since(start))))
    account = status.account_since(start)
    assert account.remarks() == ([f"{LEFT}: {remark}"] if remark else [])
    assert set(remark.split(", ")) >= {one for one in words.split(", ") if "lost" not in one}
    run.recording.ended = 41.0
    run.told(41.1, told, ended=True)
    after = run.told(60.0, topic(LEFT, 45.0), ended=True)
    assert after.account_since(start) == account  # what comes after the recording is none of it


def test_of_several_topics_the_worst_is_told_a_silent_one_before_others(run: Recorded) -> None:
    losing = [topic(f"/c{number}", lost={EvidenceLoss.BEHIND: number}) for number in range(9)]
    assert run.told(1.0, *losing).view(0.0, None).worst == "/c8 8 lost and 7 more"
    silent = topic("/hall", 0.5)
    worst = run.told(1.0, *losing, silent).view(0.0, None).worst
    assert worst == "/hall silent since +0.5 s and 8 more"


def test_a_camera_that_comes_again_by_a_new_process_was_silent_until_then(run: Recorded) -> None:
    run.told(20.0, topic(LEFT, 13.9))
    run.is_killed()
    assert run.told(23.0, topic()).recorded[0].silent_since == 13.9
    back = run.told(26.0, topic(first=25.2))
    assert back.account_since(10.0).remarks()[1:] == []


def test_what_all_processes_counted_is_in_the_account(run: Recorded) -> None:
    lost = {EvidenceLoss.BEHIND: 2}
    run.told(1.0, topic(messages=10, bytes=100, lost=lost), size=1000)
    run.is_killed()
    both = run.told(2.0, topic(messages=5, bytes=50, left_out=1, lost=lost), size=600)
    (one,) = both.recorded
    assert (one.messages, one.bytes, one.left_out, one.lost) == (15, 150, 1, {"behind": 4})
    assert both.size == 1600


def test_what_nobody_published_stands_in_the_account_and_a_dead_topic_is_silent(
    run: Recorded,
) -> None:
    topics = (
        EvidenceTopic("/camera/live", "a/msg/B", rate=30.0, byte_rate=6e6),
        EvidenceTopic("/camera/dead", "a/msg/B", publishers=0, silent_since=0.2),
        EvidenceTopic("/tf_static", "a/msg/C", kept=True),
        EvidenceTopic("/map", "a/msg/C", publishers=0, kept=True),
    )
    unseen = ("/camera/front", "/robot/a")
    begun = run.told(0.5, *topics, unseen=unseen, settled=False)
    assert begun.problems == ()  # it has only begun to look
    status = run.told(1.0, *topics, unseen=unseen)
    assert status.silent == ("/camera/dead", "/map")
    assert status.problems == ("nobody publishes /camera/front, /robot/a",)
    assert list(status.faults(0.1))[1:] == ["/camera/dead: silent since +0.1 s"]
    assert status.account_since(0.1).remarks()[1:] == ["/camera/dead: silent since +0.1 s"]


# Gaps: when nothing was recorded at all.


def test_a_gap_lasts_from_what_is_in_the_file_until_all_that_came_is_back(run: Recorded) -> None:
    run.comes(6.0, {"/left": 0.1, "/right": 0.2}, saved=5.62)
    run.is_killed()
    starting = run.comes(8.0, {}, saved=None)
    assert starting.gap == EvidenceGap(5.62, None, KILLED)
    assert (
        starting.trouble(1.0) == f"nothing is recorded since +4.6 s, it is starting again: {KILLED}"
    )
    assert run.comes(8.5, {"/left": 8.2}, saved=None).gap is not None
    back = run.comes(9.0, {"/left": 8.2, "/right": 8.75}, saved=None)
    assert (back.gap, back.trouble(1.0)) == (None, None)
    assert back.gaps == (EvidenceGap(5.62, 8.75, KILLED),)
    assert back.view(1.0, None).missing == "missing from +4.6 s to +7.8 s"


def test_what_never_comes_back_keeps_no_gap_open(run: Recorded) -> None:
    run.comes(6.0, {"/left": 0.1, "/gone": 0.2}, saved=5.6)
    run.is_killed()
    run.comes(7.0, {"/left": 7.0}, saved=None)
    later = run.comes(7.1 + COMES_BACK, {"/left": 7.0}, saved=10.0)
    assert later.gaps == (EvidenceGap(5.6, 7.0, KILLED),)


def test_a_process_that_is_not_back_at_the_end_leaves_a_gap_up_to_the_end(run: Recorded) -> None:
    run.comes(6.0, {"/left": 0.1}, saved=5.6)
    run.is_killed()
    run.recording.ended = 7.0
    account = status_of(7.0, None, 0.0, "", run.recording).account_since(0.0)
    assert account.words.startswith("1 topic, 0 messages, 0.0 MB, missing from +5.6 s to the end")


def test_of_many_ends_one_line_has_the_number_and_the_first_gap(run: Recorded) -> None:
    kills = 5
    for number in range(kills):
        run.comes(number + 0.5, {"/left": number + 0.3}, saved=number + 0.4)
        run.is_killed()
    status = run.comes(kills + 0.5, {"/left": kills + 0.3}, saved=None)
    assert status.problems == (
        f"the evidence process had to be started again {kills} times: {KILLED}",
    )
    told_in_short = EvidenceAccount(gaps=status.gaps).gap_words
    assert told_in_short == f"from +0.4 s to +1.3 s and {kills - 1} times more"
    assert status.view(0.0, None).missing == f"missing {kills} times"


def test_a_recording_that_begins_before_its_process_listens_says_what_is_missing(
    run: Recorded,
) -> None:
    run.recording.open_gap("its process was only being started")
    assert run.comes(2.0, {"/left": 1.5}, saved=None).gaps[0].end == 1.5
