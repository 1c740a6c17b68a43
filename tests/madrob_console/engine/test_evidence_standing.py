from __future__ import annotations

from dataclasses import replace

import msgspec

from madrob_console.engine.live.witness import EvidencePlace, WitnessStatus
from madrob_console.engine.process.evidence_messages import EvidenceNews
from madrob_console.engine.process.evidence_recorder import EvidenceWritten
from madrob_console.engine.process.evidence_standing import EvidenceRecording, standing
from madrob_console.testbeds.evidence_flow import TopicFlow

USED_UP = "the budget is used up"
WRITTEN = EvidenceWritten({}, {}, {}, {}, 0, 0, 0.0, "", False)


class Recorded:
    """A recording of which its process tells; s of a monotonic clock."""

    def __init__(self) -> None:
        self.recording = EvidenceRecording(1, EvidencePlace(-1, "run", 0, 0, 10**9, 0))
        self.recording.next_file()

    def says(self, at: float, problem: str, *, finished: bool = False) -> WitnessStatus:
        written = replace(WRITTEN, problem=problem, finished=finished)
        news = EvidenceNews(settled=True, recordings={1: written})
        self.recording.hear(news, at)
        return standing(at, news, at, "", self.recording)


def test_what_ended_a_recording_is_told_while_it_goes_on_and_holds_up_no_run_after_it() -> None:
    run = Recorded()
    assert run.says(1.0, USED_UP).problem == USED_UP
    run.recording.ended = 2.0
    over = run.says(2.5, USED_UP, finished=True)
    assert over.problem is None
    assert over.account.problems == (USED_UP,)


def test_what_goes_wrong_after_a_recording_is_told_until_the_next_one() -> None:
    run = Recorded()
    assert run.says(1.0, "").problem is None
    run.recording.ended = 2.0
    assert run.says(2.5, "it could not be finished", finished=True).problem is not None
    assert run.says(9.5, "it could not be finished", finished=True).problem is not None


def test_what_a_process_that_was_ended_had_on_its_way_is_not_known() -> None:
    run = Recorded()
    run.says(1.0, "")
    run.recording.lose_process("it was ended by SIGKILL")
    run.recording.next_file()
    account = run.says(2.0, "").account
    assert account.unwritten is None
    assert account.words.endswith(", not known how many of them are on disk")


def test_a_process_that_is_silent_at_the_end_of_a_recording_leaves_open_what_there_is() -> None:
    run = Recorded()
    told = run.says(1.0, "")
    assert (told.account.unwritten, told.account.problems) == (0, ())
    run.recording.ended = 14.0
    account = standing(14.5, None, 1.0, "", run.recording).account
    assert account.unwritten is None
    (problem,) = account.problems
    assert "said nothing in the last 13 s of the recording" in problem


def test_a_process_that_has_counted_all_has_said_what_there_is() -> None:
    run = Recorded()
    run.says(1.0, "")
    run.recording.ended = 2.0
    news = EvidenceNews(settled=True, recordings={1: replace(WRITTEN, ended=True)})
    run.recording.hear(news, 2.1)
    account = standing(2.2, news, 2.1, "", run.recording).account
    assert (account.unwritten, account.problems) == (0, ())


def test_what_nobody_published_stands_in_the_account_and_a_dead_topic_is_silent() -> None:
    recording = EvidenceRecording(1, EvidencePlace(-1, "run", 0, 0, 10**9, 0))
    recording.next_file()
    flows = (
        TopicFlow("/camera/live", "a/msg/B", 1, 30.0, 6e6, 0),
        TopicFlow("/camera/dead", "a/msg/B", 0, 0.0, 0.0, 0, "silent since 10:00:00"),
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
    assert status.account.remarks()[1:] == ["/camera/dead: silent since 10:00:00"]
