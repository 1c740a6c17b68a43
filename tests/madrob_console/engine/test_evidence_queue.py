from __future__ import annotations

from collections import Counter

from hypothesis import given
from hypothesis import strategies as st

from madrob_console.engine.process.evidence_queue import EvidenceQueue
from recorder.message import RawMessage

SMALL, LARGE = 10_000, 1_000_000


def message(topic: str, number: int, size: int = SMALL) -> RawMessage:
    return RawMessage(topic, "a/msg/B", bytes(size), number, number)


def test_messages_come_out_in_the_order_in_which_they_came() -> None:
    queue = EvidenceQueue(LARGE)
    for number in range(10):
        assert queue.put(message(f"/{number % 3}", number), 0) == []
    assert [m.publish_ns for m in queue.take(3 * SMALL)] == [0, 1, 2]
    assert [m.publish_ns for m in queue.take(LARGE)] == list(range(3, 10))
    assert queue.take(LARGE) == []
    assert queue.size == len(queue) == 0


def test_the_topic_that_takes_most_room_gives_way_and_no_other_pays_for_it() -> None:
    queue = EvidenceQueue(4 * LARGE)
    lost: Counter[str] = Counter()
    for number in range(100):
        for topic, size in (("/huge", LARGE), ("/left", SMALL), ("/right", SMALL)):
            lost.update(m.topic for m in queue.put(message(topic, number, size), 0))
    assert set(lost) == {"/huge"}
    assert lost["/huge"] > 95
    taken = queue.take(100 * LARGE)
    assert Counter(m.topic for m in taken)["/left"] == 100
    assert [m.publish_ns for m in taken if m.topic == "/huge"][-1] == 99  # the oldest went


def test_where_not_all_finds_room_the_higher_priority_stays() -> None:
    queue = EvidenceQueue(LARGE)
    for number in range(200):
        queue.put(message("/important", number), 5)
        queue.put(message("/spare", number), -1)
    topics = Counter(m.topic for m in queue.take(10 * LARGE))
    assert topics["/spare"] == 0
    assert topics["/important"] > 90
    assert queue.put(message("/important", 1, LARGE // 2), 5) == []
    assert [m.topic for m in queue.put(message("/spare", 2, LARGE), -1)] == ["/spare"]


def test_what_is_larger_than_the_queue_is_refused_and_costs_no_other_topic_anything() -> None:
    queue = EvidenceQueue(LARGE)
    queue.put(message("/small", 1), 0)
    assert [m.topic for m in queue.put(message("/huge", 2, 2 * LARGE), 0)] == ["/huge"]
    assert len(queue) == 1


@given(
    st.lists(
        st.tuples(st.integers(0, 3), st.integers(1, 300_000), st.integers(-1, 1), st.booleans())
    )
)
def test_every_message_is_taken_gives_way_or_waits_and_memory_is_bounded(
    steps: list[tuple[int, int, int, bool]],
) -> None:
    queue = EvidenceQueue(LARGE)
    came = left = 0
    for number, (topic, size, priority, takes) in enumerate(steps):
        left += len(queue.put(message(f"/{topic}", number, size), priority))
        came += 1
        assert queue.size <= LARGE
        if takes:
            left += len(queue.take(size))
    assert came == left + len(queue)
