"""What is stored of a run has the digits that its recording gives, whoever reads it again."""

from __future__ import annotations

import io
import itertools
import json
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from madrob_console.archive import score
from recorder import Bag
from scoring import Condition, evaluate
from tests.stories import hands
from tests.stories.hands import Hall, Run


@pytest.fixture(scope="module")
def store() -> Typestore:
    return get_typestore(Stores.ROS2_JAZZY)


def scored_values(path: Path) -> dict[str, float | None]:
    (scored,) = score(path)
    return {str(name): one.value for name, one in scored.result.indicators.items()}


# Seen red: the replay lost the first message of each step.
def test_replay_has_the_stored_digits(hall: Hall) -> None:
    run = hands.make_run(hall, "slam")

    replay = hands.replay(hall, run)

    replay.wait_for("COMPLETED", hands.REPLAYED_ALIKE, timeout=60.0)
    assert scored_values(run.folder) == hands.values_of(run)


# Seen red: the new result was kept as the earlier issue, too.
def test_reissue_by_other_rules_keeps_both_issues(hall: Hall) -> None:
    run = hands.make_run(hall, "worn")
    before, level = hands.result_bytes(run), run.level()

    done = hands.reissue(hall, run, "rules of May", "eurobench-2020")

    assert (done.code, hands.earlier_issue(run, 1)) == (0, before)
    now = run.result(after=hands.REISSUED)
    assert (now["issue"], now["ruleset"], level, run.level()) == (2, "eurobench-2020", 6, 4)
    assert json.loads(before)["ruleset"] == "protocol"
    assert "rules of May" in [line["reason"] for line in run.journal()]
    checked = hands.check(hall)
    assert (checked.code, "same digits" in checked.output) == (0, True)


# Seen red: the check compared the quality of the data alone.
@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (hands.edit_result, "time_to_handle"),
        (hands.edit_journal, "stop"),
        (hands.edit_recording, ".mcap"),
    ],
)
def test_check_names_what_was_edited(edit: Callable[[Run], None], words: str, hall: Hall) -> None:
    run = hands.make_run(hall, "slam")
    assert hands.check(hall).code == 0

    edit(run)

    done = hands.check(hall)
    said = done.output + done.errors
    assert (done.code, run.folder.name in said, words in said) == (1, True, True)


# Seen red: messages were always read as they are stored.
def test_bag_by_mcap_in_other_orders_scores_alike(hall: Hall) -> None:
    run = hands.make_run(hall)
    bag = Bag(run.bag)
    messages = [*bag.messages()]
    blocks = [messages[start : start + 500] for start in range(0, len(messages), 500)]

    file, channels = io.BytesIO(), {}
    writer = Writer(file, compression=CompressionType.LZ4, chunk_size=50_000)
    writer.start(profile="ros2")
    for topic in bag.topics():
        schema = writer.register_schema(topic.type, "ros2msg", topic.definition.encode())
        channels[topic.name] = writer.register_channel(topic.name, "cdr", schema)
    for message in itertools.chain(*reversed(blocks)):
        times = message.receive_ns, message.data, message.publish_ns
        writer.add_message(channels[message.topic], *times)
    writer.finish()  # type: ignore[no-untyped-call]
    foreign = hall.home / "foreign"
    foreign.mkdir()
    (foreign / "foreign_0.mcap").write_bytes(file.getvalue())
    hands.copy_journal(run, foreign)

    assert scored_values(foreign) == hands.values_of(run)


# Seen red: the handle zero of a journal was not used.
def test_bag_by_rosbags_in_other_orders_scores_alike(hall: Hall, store: Typestore) -> None:
    run = hands.make_run(hall)
    bag = Bag(run.bag)
    topics = [topic for topic in bag.topics() if topic.type in store.types]
    backwards = sorted(bag.messages(), key=lambda message: message.topic, reverse=True)

    foreign = hall.home / "foreign"
    with RosbagsWriter(foreign, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {
            topic.name: writer.add_connection(topic.name, topic.type, typestore=store)
            for topic in topics
        }
        for message in backwards:
            if message.topic in connections:
                writer.write(connections[message.topic], message.receive_ns, message.data)
    hands.copy_journal(run, foreign)

    assert scored_values(foreign) == hands.values_of(run)


# Seen red: the handle zero was taken as 0 N.
def test_evaluate_has_the_digits_of_the_console(hall: Hall, store: Typestore) -> None:
    run = hands.make_run(hall, "worn")
    heard: dict[str, list[tuple[float, Any]]] = defaultdict(list)
    for message in Bag(run.folder).messages():
        if message.topic.startswith(("/madrob/door", "/madrob/handle", "/madrob/passage")):
            one: Any = store.deserialize_cdr(message.data, message.type)
            stamp = one.header.stamp
            heard[message.topic].append((stamp.sec + stamp.nanosec * 1e-9, one))

    def signal(topic: str, measured: Callable[[Any], object]) -> tuple[Any, Any]:
        times = np.array([time for time, _ in heard[topic]])
        return times, np.array([measured(one) for _, one in heard[topic]])

    strips = ("cw_left", "cw_right", "ccw_left", "ccw_right")
    stored = run.result()
    evaluated = evaluate(
        Condition.from_number(stored["condition_number"]),
        stored["start"],
        door=signal("/madrob/door/angle", lambda one: one.position[0]),
        handle=signal("/madrob/handle/force", lambda one: one.wrench.force.x),
        passage={s: signal(f"/madrob/passage/{s}", lambda one: one.ranges) for s in strips},
        handle_zero=stored["handle_zero"],
    )

    values = {str(name): one.value for name, one in evaluated.indicators.items()}
    assert values == hands.values_of(run)
    assert [e.time for e in evaluated.events] == [e["time"] for e in stored["events"]]
