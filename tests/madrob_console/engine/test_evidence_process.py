"""Evidence over real DDS: publishers, recording process and this one."""

from __future__ import annotations

import itertools
import math
import os
import signal
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path

import pytest
from rosbags.highlevel import AnyReader

from madrob_console.archive.evidence import repair_evidence, settled_account
from madrob_console.common.clock import NS
from madrob_console.engine.runtime.evidence_client import EvidencePlace
from madrob_console.engine.runtime.evidence_order import EvidenceOrder
from madrob_console.engine.runtime.evidence_process import COMMAND, EvidenceProcess
from madrob_console.engine.runtime.supervisor import Supervisor
from madrob_console.referee.evidence_account import (
    EvidenceAccount,
    EvidenceLoss,
)
from madrob_console.referee.evidence_state import EvidenceState, EvidenceTopic
from madrob_console.testbeds.evidence_choice import EvidenceChoice, TopicLimit
from recorder.bag import Durability, RawMessage, evidence_file_name
from recorder.reader import Bag
from recorder.writer import BagWriter
from tests.madrob_console.ros_peer import (
    BOOL,
    KEPT,
    Kind,
    Misbehaviour,
    Peer,
    Stream,
    cameras,
    truth,
)
from tests.watching import until

pytestmark = pytest.mark.machine

CAMERAS = Stream(Kind.JPEG, count=2, rate=20, size=50_000, reliable=True)
LEFT = CAMERAS.topics[0]
PLENTY = 10**12
START = 1_700_000_000.0
"""Of a recording, s since the epoch."""


class Hall:
    """A bag that is recorded into a folder, and evidence beside it."""

    def __init__(self, folder: Path, evidence: EvidenceProcess) -> None:
        self.folder = folder
        self.evidence = evidence
        self.steady_ns = 0

    @property
    def state(self) -> EvidenceState:
        return self.evidence.state

    def until(self, look: Callable[[EvidenceState], object]) -> EvidenceState:
        until(lambda: look(self.state))
        return self.state

    @property
    def account(self) -> EvidenceAccount:
        """Of a run that starts with its recording."""
        return self.state.account_since(START)

    def topic(self, name: str = LEFT) -> EvidenceTopic:
        found = (one for one in self.state.recorded if one.topic == name)
        return next(found, EvidenceTopic(name, ""))

    def comes(self, *names: str, rate: float = 1.0) -> None:
        """Until something comes on these topics."""
        self.until(
            lambda status: all(
                any(t.topic == name and t.rate >= rate for t in status.topics) for name in names
            )
        )

    @contextmanager
    def recording(
        self, most_bytes: int = PLENTY, ended: Callable[[], object] = bool
    ) -> Iterator[None]:
        """As an engine records a run: the bag is there first, and closed last."""
        with BagWriter(self.folder, [], {}):
            self.steady_ns, monotonic = round(START * NS), time.monotonic_ns()
            place = EvidencePlace(str(self.folder), self.steady_ns, monotonic, most_bytes, 0)
            self.evidence.begin_recording(place)
            yield
            self.evidence.end_recording()
            ended()
        self.until(lambda status: not status.recording and not status.finishing)

    def recorded(self) -> list[RawMessage]:
        return list(Bag(self.folder, evidence=True).messages())


@contextmanager
def hall(
    tmp_path: Path, domain: int, *topics: str, command: Sequence[str] = COMMAND, **more: object
) -> Iterator[Hall]:
    choice = EvidenceChoice(topics or ("/camera/**",), **more)  # type: ignore[arg-type]
    evidence = EvidenceProcess(EvidenceOrder(domain, choice, ("/madrob/own",), ()), command)
    supervisor = Supervisor(evidence)
    evidence.warm()
    try:
        yield Hall(tmp_path / "run", evidence)
    finally:
        evidence.close()
        supervisor.close()


def test_cameras_are_recorded_as_they_came_and_others_open_the_whole_bag(
    ros_domain: int, tmp_path: Path
) -> None:
    with cameras(CAMERAS), hall(tmp_path, ros_domain) as here:
        here.comes(*CAMERAS.topics)
        with here.recording():
            here.until(lambda _: here.topic().messages >= 40)
        messages = here.recorded()
        account = here.account
    assert account.problems == ()
    assert account.remarks() == []
    counts = Counter(message.topic for message in messages)
    assert counts == {one.topic: one.messages for one in account.topics}
    assert set(counts) == set(CAMERAS.topics)
    assert {message.type for message in messages} == {CAMERAS.kind.type}
    assert all(b"\xff\xd8\xff" in message.data for message in messages)
    times = [message.receive_ns for message in messages if message.topic == LEFT]
    span = (times[-1] - times[0]) / NS
    assert times[0] >= here.steady_ns  # the engine's time, not this machine's
    assert (len(times) - 1) / span == pytest.approx(CAMERAS.rate, rel=0.2)
    with AnyReader([here.folder]) as reader:
        seen = Counter(connection.topic for connection, _, _ in reader.messages())
        connection = next(c for c in reader.connections if c.topic == LEFT)
        _, _, raw = next(reader.messages([connection]))
        picture = reader.deserialize(raw, connection.msgtype)
    assert seen == counts
    assert "jpeg" in str(picture)[:1000]


def test_what_was_said_for_late_comers_before_the_start_is_in_every_recording(
    ros_domain: int, tmp_path: Path, peer: Peer
) -> None:
    map_topic = "/hall/map_is_known"
    latched = peer.publisher(map_topic, BOOL, KEPT)
    latched.publish(truth(True))
    peer.publisher("/madrob/own", BOOL).publish(truth(True))
    with hall(tmp_path, ros_domain, "/hall/**", "/madrob/**") as here:
        here.comes(map_topic, rate=0.1)
        for number in range(2):
            here.folder = tmp_path / f"run_{number}"
            with here.recording():
                here.until(lambda _: here.topic(map_topic).messages)
            (message,) = here.recorded()
            assert message.data.startswith(truth(True))
            assert message.receive_ns >= here.steady_ns
            topics = Bag(here.folder, evidence=True).topics()
            (topic,) = (one for one in topics if one.name == map_topic)
            assert topic.qos.durability is Durability.TRANSIENT_LOCAL


AILING = (
    sys.executable,
    "-P",
    "-c",
    """
import signal
from madrob_console.engine.runtime.evidence_worker import main

def turn_in_circles(*_):
    while True:
        pass

signal.signal(signal.SIGUSR1, turn_in_circles)
main()
""",
)
"""The process that records evidence, which hangs when a signal says so."""


def settled(folder: Path, told: EvidenceAccount) -> EvidenceAccount:
    """What is in the files, once they are whole."""
    repair_evidence(folder)
    account = until(lambda: settled_account(folder, told))
    assert account is not None
    return account


WHY = {
    signal.SIGKILL: "ended by SIGKILL",
    signal.SIGSTOP: "it was stopped for 2 s",
    signal.SIGUSR1: "it gave no answer for",
}


@pytest.mark.parametrize(
    ("phase", "how", "limit"),
    [
        *(pytest.param("records", how, math.inf, id=how.name) for how in WHY),
        *(
            pytest.param(phase, how, 3.0, marks=pytest.mark.slow)
            for phase in ("listens", "begins", "records", "has ended")
            for how in (signal.SIGKILL, signal.SIGSTOP)
        ),
    ],
)
def test_in_every_phase_a_spoilt_process_is_told_in_time_and_another_one_goes_on(
    ros_domain: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    phase: str,
    how: signal.Signals,
    limit: float,
) -> None:
    monkeypatch.setattr(EvidenceProcess, "longest", 5.0)

    def spoil(now: str) -> None:
        if now == phase:
            spoilt, began = here.evidence.pid, time.monotonic()
            assert spoilt is not None
            os.kill(spoilt, how)
            here.until(lambda status: status.trouble(START) is not None)
            assert time.monotonic() - began < limit
            until(lambda: here.evidence.pid not in (None, spoilt))

    with cameras(CAMERAS), hall(tmp_path, ros_domain, command=AILING) as here:
        here.comes(LEFT)
        spoil("listens")
        with here.recording(ended=lambda: spoil("has ended")):
            spoil("begins")
            here.until(lambda _: here.topic().messages >= 10)
            until(here.recorded)  # some of it is on disk
            spoil("records")
            before = here.topic().messages
            here.until(lambda _: here.topic().messages >= before + 10)
            here.until(lambda status: status.trouble(START) is None)
        told = here.account
    account = settled(here.folder, told)
    assert Counter(m.topic for m in here.recorded()) == {
        one.topic: one.messages for one in account.topics
    }
    assert account.gaps or phase in ("listens", "has ended")
    if phase == "records":
        (problem,), (gap,) = told.problems, account.gaps
        assert WHY[how] in problem
        times = sorted(message.receive_ns / NS - START for message in here.recorded())
        pause = max(itertools.pairwise(times), key=lambda two: two[1] - two[0])
        assert gap.begin <= pause[0] + 0.005  # it is told in hundredths
        assert gap.end is not None
        assert gap.end >= pause[1] - 0.2  # until all cameras are back
        assert (here.folder / evidence_file_name("run", 1)).is_file()


def test_the_end_of_an_engine_waits_for_no_process_that_was_stopped(
    ros_domain: int, tmp_path: Path
) -> None:
    with hall(tmp_path, ros_domain) as here:
        here.until(lambda status: status.ready)
        begin = time.monotonic()
        assert here.evidence.pid is not None
        os.kill(here.evidence.pid, signal.SIGSTOP)
        here.evidence.close()
        assert time.monotonic() - begin < 6


WITHOUT_POSES = (
    sys.executable,
    "-P",
    "-c",
    """
import sys
sys.modules["geometry_msgs"] = None  # as if it were not installed
from madrob_console.engine.runtime.evidence_worker import main
main()
""",
)


def test_of_publishers_that_go_wrong_each_is_named_and_no_other_topic_pays(
    ros_domain: int, tmp_path: Path
) -> None:
    def stream(name: str, wrong: Misbehaviour = Misbehaviour.NONE) -> Stream:
        return Stream(Kind.JPEG, f"/camera/{name}", 1, 10, 20_000, True, wrong, 8.0)

    small = (
        stream("changed", Misbehaviour.OTHER_TYPE),
        stream("flood", Misbehaviour.FLOOD),
        stream("gone", Misbehaviour.VANISHES),
    )
    pose = Stream(Kind.POSE, "/camera/pose", reliable=True)
    huge = Stream(Kind.JPEG, "/camera/huge", 1, 10, 400_000, reliable=True)
    good = stream("good")
    limit = TopicLimit("/camera/flood", most_rate=20.0)
    with (
        cameras(*small, pose, huge, good),
        hall(tmp_path, ros_domain, command=WITHOUT_POSES, limits=(limit,), largest=200_000) as here,
    ):
        here.comes(*(stream.topic for stream in (*small, good)))
        with here.recording():
            here.until(lambda _: "left alone" in here.topic("/camera/huge").problem)
            here.until(lambda _: "std_msgs/msg/Header" in here.topic("/camera/changed").problem)
            here.until(lambda _: here.topic("/camera/flood").left_out > 300)
            here.until(lambda _: "is not installed here" in here.topic(pose.topic).problem)
            before = here.topic("/camera/good").messages
            here.until(lambda _: here.topic("/camera/good").messages >= before + 20)
        topics = {one.topic.removeprefix("/camera/"): one for one in here.account.topics}
        counts = Counter(message.topic for message in here.recorded())
    assert topics["huge"].lost[EvidenceLoss.TOO_LARGE] >= 3
    assert "messages of 0.4 MB are not recorded, the limit is 0.2 MB" in topics["huge"].problem
    assert (
        "geometry_msgs/msg/PoseStamped is not installed here: source the " in topics["pose"].problem
    )
    assert topics["good"].lost == {}
    assert topics["good"].problem == ""
    assert topics["flood"].left_out > 2 * topics["flood"].messages
    assert counts == {f"/camera/{name}": n for name, one in topics.items() if (n := one.messages)}


def test_without_ros_it_is_said_and_nothing_is_started_again_and_again(
    ros_domain: int, tmp_path: Path
) -> None:
    misread = EvidenceOrder(ros_domain, EvidenceChoice(("/**",)), (), ("-r", "nonsense"))
    evidence = EvidenceProcess(misread)
    with hall(tmp_path, ros_domain) as other, closing(Supervisor(evidence)), closing(evidence):
        evidence.warm()
        assert "ROS does not understand" in until(lambda: evidence.state.problem or "")
        pid = evidence.pid
        other.until(lambda status: status.ready)
        assert evidence.pid == pid
