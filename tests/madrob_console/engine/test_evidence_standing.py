from __future__ import annotations

import socket
from dataclasses import replace

import msgspec
import pytest

from madrob_console.common.clock import NS
from madrob_console.engine.evidence_client import EvidencePlace, WitnessStatus
from madrob_console.engine.evidence_recorder import EvidenceWritten
from madrob_console.engine.evidence_status import (
    COMES_BACK,
    MOST_GAPS,
    EvidenceNews,
    EvidenceRecording,
    FinishFile,
    LeaveDisk,
    ListenFor,
    standing,
)
from madrob_console.engine.evidence_worker import OrderLine
from madrob_console.engine.wire import frame
from madrob_console.referee.evidence_account import EvidenceAccount, EvidenceGap
from madrob_console.testbeds.evidence_choice import EvidenceChoice, TopicFlow, TopicPause

KILLED = "it was ended by SIGKILL"
USED_UP = "the budget is used up"
WRITTEN = EvidenceWritten({}, {}, {}, {}, 0, 0, 0.0, "", False)


class Recorded:
    """A recording of which its process tells; s of a monotonic clock."""

    def __init__(self) -> None:
        self.recording = EvidenceRecording(1, EvidencePlace(-1, "run", 0, 0, 10**9, 0))
        self.recording.next_file()

    def hears(self, at: float, first: dict[str, float], saved: float | None) -> WitnessStatus:
        """Topics that come since then, and up to when there is something in the file."""
        in_ns = {topic: round(time * NS) for topic, time in first.items()}
        saved_ns = None if saved is None else round(saved * NS)
        written = replace(WRITTEN, first_ns=in_ns, saved_ns=saved_ns)
        flows = tuple(TopicFlow(topic, "a/msg/B", 1, 10.0, 1e6, 0) for topic in first)
        news = EvidenceNews(settled=True, flows=flows, recordings={1: written})
        self.recording.hear(news, at)
        return standing(at, news, at, "", self.recording)

    def finds(
        self, at: float, *flows: TopicFlow, first: dict[str, float] | None = None
    ) -> WitnessStatus:
        """These topics, and when the first message came of some."""
        in_ns = {topic: round(time * NS) for topic, time in (first or {}).items()}
        written = replace(WRITTEN, messages=dict.fromkeys(in_ns, 9), first_ns=in_ns)
        news = EvidenceNews(settled=True, flows=flows, recordings={1: written})
        self.recording.hear(news, at)
        return standing(at, news, at, "", self.recording)

    def is_killed(self, at: float) -> WitnessStatus:
        self.recording.lose_process(KILLED)
        self.recording.next_file()
        return standing(at, None, 0.0, f"the evidence process is started again: {KILLED}", None)

    def says(self, at: float, problem: str, *, finished: bool = False) -> WitnessStatus:
        written = replace(WRITTEN, problem=problem, finished=finished)
        news = EvidenceNews(settled=True, recordings={1: written})
        self.recording.hear(news, at)
        return standing(at, news, at, "", self.recording)


@pytest.fixture
def run() -> Recorded:
    return Recorded()


def test_what_ended_a_recording_is_told_while_it_goes_on_and_holds_up_no_run_after_it(
    run: Recorded,
) -> None:
    assert run.says(1.0, USED_UP).problem == USED_UP
    run.recording.ended = 2.0
    over = run.says(2.5, USED_UP, finished=True)
    assert over.problem is None
    assert over.account.problems == (USED_UP,)


def test_what_goes_wrong_after_a_recording_is_told_until_the_next_one(run: Recorded) -> None:
    assert run.says(1.0, "").problem is None
    run.recording.ended = 2.0
    assert run.says(2.5, "it could not be finished", finished=True).problem is not None
    assert run.says(9.5, "it could not be finished", finished=True).problem is not None


def test_what_a_process_that_was_ended_had_on_its_way_is_not_known(run: Recorded) -> None:
    run.says(1.0, "")
    run.recording.lose_process("it was ended by SIGKILL")
    run.recording.next_file()
    account = run.says(2.0, "").account
    assert account.unwritten is None
    assert account.words.endswith(", not known how many of them are on disk")


def test_a_process_that_is_silent_at_the_end_of_a_recording_leaves_open_what_there_is(
    run: Recorded,
) -> None:
    told = run.says(1.0, "")
    assert (told.account.unwritten, told.account.problems) == (0, ())
    run.recording.ended = 14.0
    account = standing(14.5, None, 1.0, "", run.recording).account
    assert account.unwritten is None
    (problem,) = account.problems
    assert "said nothing in the last 13 s of the recording" in problem


def test_a_process_that_has_counted_all_has_said_what_there_is(run: Recorded) -> None:
    run.says(1.0, "")
    run.recording.ended = 2.0
    news = EvidenceNews(settled=True, recordings={1: replace(WRITTEN, ended=True)})
    run.recording.hear(news, 2.1)
    account = standing(2.2, news, 2.1, "", run.recording).account
    assert (account.unwritten, account.problems) == (0, ())


def test_what_was_told_before_a_process_fell_silent_is_not_told_as_what_comes_now(
    run: Recorded,
) -> None:
    fresh = run.hears(1.0, {"/left": 0.1}, saved=0.9)
    assert [topic.rate for topic in fresh.topics] == [10.0]
    news = EvidenceNews(settled=True, flows=(TopicFlow("/left", "a/msg/B", 1, 10.0, 1e6, 0),))
    old = standing(4.0, news, 1.0, "", run.recording)
    assert old.problem == "the evidence process is silent for 3 s"
    assert (old.topics, old.byte_rate) == ((), 0)
    assert old.account.topics == fresh.account.topics


@pytest.mark.parametrize(
    ("silent", "queued", "said"),
    [
        (1.0, 3_000_000, None),
        (9.8, 31_400_000, "the disk has taken nothing for 10 s, 31.4 MB wait in memory"),
    ],
)
def test_a_disk_that_takes_nothing_is_told_beside_what_still_comes(
    run: Recorded, silent: float, queued: int, said: str | None
) -> None:
    written = replace(WRITTEN, silent=silent, queued=queued)
    flows = (TopicFlow("/left", "a/msg/B", 1, 10.0, 1e6, 0),)
    news = EvidenceNews(settled=True, flows=flows, recordings={1: written})
    run.recording.hear(news, 1.0)
    status = standing(1.0, news, 1.0, "", run.recording)
    assert status.trouble(0.0) == said
    assert status.problem is None  # it may take all of it yet
    run.recording.ended = 2.0
    assert standing(2.0, news, 2.0, "", run.recording).trouble(0.0) is None


def test_a_file_that_waits_for_its_repair_is_a_fault_and_stands_in_no_start_s_way(
    run: Recorded,
) -> None:
    run.recording.ended = 2.0
    waits = "run_evidence_0.mcap is not complete and waits for its repair"
    written = replace(WRITTEN, finished=True, ended=True, unrepaired=waits)
    news = EvidenceNews(settled=True, recordings={1: written})
    run.recording.hear(news, 2.5)
    status = standing(2.5, news, 2.5, "", run.recording)
    assert status.faults(0.0) == (waits,)
    assert (status.problem, status.finishing) == (None, False)


def camera(*pauses: tuple[float, float | None]) -> TopicFlow:
    told = tuple(
        TopicPause(round(begin * NS), None if end is None else round(end * NS))
        for begin, end in pauses
    )
    return TopicFlow("/left", "a/msg/B", 1, 10.0, 1e6, 0, pauses=told)


def test_the_silence_of_a_camera_is_told_from_the_start_of_the_run_on(run: Recorded) -> None:
    start = 10.0
    silent = run.finds(20.0, camera((13.9, None)))
    assert silent.topics_since(start)[0].problem == "silent since +3.9 s"
    back = run.finds(25.0, camera((13.9, 18.5)))
    assert back.topics_since(start)[0].problem == "silent from +3.9 s to +8.5 s"
    assert back.account_since(start).remarks() == ["/left: silent from +3.9 s to +8.5 s"]
    twice = run.finds(40.0, camera((13.9, 18.5), (30.0, None)))
    assert twice.topics_since(start)[0].problem == "silent since +20.0 s"
    assert twice.account_since(start).remarks() == [
        "/left: silent from +3.9 s to +8.5 s and 1 time more"
    ]
    run.recording.ended = 41.0
    after = run.finds(60.0, camera((13.9, 18.5), (30.0, 33.0), (45.0, None)))
    assert after.account_since(start).remarks() == [
        "/left: silent from +3.9 s to +8.5 s and 1 time more"
    ]  # what comes after the recording is none of it


def test_a_camera_that_comes_again_by_a_new_process_was_silent_until_then(run: Recorded) -> None:
    run.finds(20.0, camera((13.9, None)))
    run.is_killed(21.0)
    assert run.finds(23.0).pauses["/left"][-1].end is None
    back = run.finds(26.0, camera(), first={"/left": 25.2})
    assert back.account_since(10.0).remarks()[1:] == ["/left: silent from +3.9 s to +15.2 s"]


def test_a_topic_that_appears_after_the_start_is_told_with_its_first_message(run: Recorded) -> None:
    run.finds(8.0)
    late = run.finds(25.0, camera(), first={"/left": 24.2})
    assert late.account_since(10.0).remarks() == ["/left: first message at +14.2 s"]
    assert late.account_since(24.5).remarks() == []  # in the countdown
    run.is_killed(26.0)
    again = run.finds(28.0, camera(), first={"/left": 27.0})
    assert again.appeared == {"/left": 24.2}
    there = Recorded()
    there.finds(8.0, camera())  # a publisher that has nothing to say yet
    assert there.finds(25.0, camera(), first={"/left": 24.2}).appeared == {}


def test_what_nobody_published_stands_in_the_account_and_a_dead_topic_is_silent() -> None:
    recording = EvidenceRecording(1, EvidencePlace(-1, "run", 0, 0, 10**9, 0))
    recording.next_file()
    flows = (
        TopicFlow("/camera/live", "a/msg/B", 1, 30.0, 6e6, 0),
        TopicFlow("/camera/dead", "a/msg/B", 0, 0.0, 0.0, 0, pauses=(TopicPause(round(0.2 * NS)),)),
        TopicFlow("/tf_static", "a/msg/C", 1, 0.0, 0.0, 0, kept=True),
        TopicFlow("/map", "a/msg/C", 0, 0.0, 0.0, 0, kept=True),
    )
    news = EvidenceNews(
        settled=True, flows=flows, recordings={1: WRITTEN}, unseen=("/camera/front", "/robot/a")
    )
    recording.hear(msgspec.structs.replace(news, settled=False), 0.5)
    assert recording.account().problems == ()  # it has only begun to look
    recording.hear(news, 1.0)
    status = standing(1.0, news, 1.0, "", recording)
    assert status.silent == ("/camera/dead", "/map")
    assert status.account.problems == ("nobody publishes /camera/front, /robot/a",)
    account = status.account_since(0.1)
    assert account.remarks()[1:] == ["/camera/dead: silent from +0.1 s to the end"]
    assert status.faults(0.1)[1:] == ("/camera/dead: silent since +0.1 s",)


def test_a_gap_lasts_from_what_is_in_the_file_until_all_that_came_is_back(run: Recorded) -> None:
    run.hears(6.0, {"/left": 0.1, "/right": 0.2}, saved=5.62)
    run.is_killed(6.5)
    starting = run.hears(8.0, {}, saved=None)
    assert starting.gap == EvidenceGap(5.62, None, KILLED)
    assert run.hears(8.5, {"/left": 8.2}, saved=None).gap is not None
    assert (
        starting.trouble(1.0) == f"nothing is recorded since +4.6 s, it is starting again: {KILLED}"
    )
    back = run.hears(9.0, {"/left": 8.2, "/right": 8.75}, saved=None)
    assert back.gap is None
    assert back.trouble(1.0) is None
    assert back.gaps == (EvidenceGap(5.62, 8.75, KILLED),)


def test_what_never_comes_back_keeps_no_gap_open(run: Recorded) -> None:
    run.hears(6.0, {"/left": 0.1, "/gone": 0.2}, saved=5.6)
    run.is_killed(6.5)
    run.hears(7.0, {"/left": 7.0}, saved=None)
    later = run.hears(7.1 + COMES_BACK, {"/left": 7.0}, saved=10.0)
    assert later.gaps == (EvidenceGap(5.6, 7.0, KILLED),)


def test_a_process_that_is_not_back_at_the_end_leaves_a_gap_up_to_the_end(run: Recorded) -> None:
    run.hears(6.0, {"/left": 0.1}, saved=5.6)
    run.is_killed(6.5)
    run.recording.ended = 7.0
    (gap,) = run.recording.gaps
    assert gap.words == "from +5.6 s to the end"
    account = replace(run.recording.account(), gaps=(gap,))
    assert account.words.startswith("1 topic, 0 messages, 0.0 MB, missing from +5.6 s to the end")


def test_of_many_ends_one_line_has_the_number_and_the_last_gap_all_that_came_later(
    run: Recorded,
) -> None:
    kills = MOST_GAPS + 5
    for number in range(kills):
        run.hears(number + 0.5, {"/left": number + 0.3}, saved=number + 0.4)
        run.is_killed(number + 0.6)
    account = run.hears(kills + 0.5, {"/left": kills + 0.3}, saved=None)
    told = f"the evidence process had to be started again {kills} times: {KILLED}"
    assert account.account.problems == (told,)
    assert len(account.gaps) == MOST_GAPS
    last = account.gaps[-1]
    assert (last.begin, last.end, last.number) == (MOST_GAPS - 0.6, kills + 0.3, 6)
    assert last.words == "from +19.4 s to +25.3 s, 6 times"
    told_in_short = EvidenceAccount(gaps=account.gaps).gap_words
    assert told_in_short == f"from +0.4 s to +1.3 s and {kills - 1} times more"


def test_a_recording_that_begins_before_its_process_listens_says_what_is_missing(
    run: Recorded,
) -> None:
    run.recording.wait_for_process()
    assert run.hears(2.0, {"/left": 1.5}, saved=None).gaps[0].end == 1.5


def test_an_order_that_comes_together_with_the_first_one_is_carried_out_too() -> None:
    listen = ListenFor(7, EvidenceChoice(("/camera/**",)), (), ())
    orders = listen, FinishFile(1), LeaveDisk(held=True)
    engine, process = socket.socketpair()
    with engine, process:
        engine.sendall(b"".join(map(frame, orders)))
        line = OrderLine(process)
        assert line.first_order() == listen
        assert line.orders() == [FinishFile(1), LeaveDisk(held=True)]
