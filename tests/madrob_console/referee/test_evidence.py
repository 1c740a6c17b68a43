"""What is said of topics that were recorded beside the run."""

from __future__ import annotations

from madrob_console.common.formatting import time_of_day
from madrob_console.referee.evidence import Evidence, EvidenceTopic

KILLED = "the recorder of the evidence is started again: it was ended by SIGKILL"
EVIDENCE = Evidence({"/camera": EvidenceTopic(600, 12, 1103.5), "/tf": EvidenceTopic(1)}, KILLED)


def test_words_count_topics_messages_and_losses() -> None:
    assert EVIDENCE.words == "2 topics, 601 messages, 12 lost"
    assert Evidence({"/tf": EvidenceTopic(1)}).words == "1 topic, 1 message"


def test_remarks_name_the_problem_the_losses_and_the_silence() -> None:
    lost = "/camera: 12 messages lost"
    silent = "/camera: silent since +3.5 s"
    assert [*EVIDENCE.remarks(1100.0)] == [KILLED, lost, silent]
    assert [*EVIDENCE.remarks(None)][2] == f"/camera: silent since {time_of_day(1103.5)}"
    assert [*Evidence({"/tf": EvidenceTopic(1)}).remarks(0.0)] == []


def test_counts_of_an_earlier_recording_are_added() -> None:
    later = Evidence({"/camera": EvidenceTopic(50, 1), "/late": EvidenceTopic(2)})
    topics = {
        "/camera": EvidenceTopic(650, 13),
        "/tf": EvidenceTopic(1),
        "/late": EvidenceTopic(2),
    }
    assert later.added_to(EVIDENCE) == Evidence(topics)
