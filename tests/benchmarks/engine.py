"""What an engine takes of the processor, and how soon an abort is in effect."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Iterator

from madrob_console.engine.requests import GiveCurves, Perform
from madrob_console.messages.codec import REFEREE_RUNNING_TOPIC
from madrob_console.referee.acts import Abort
from madrob_console.referee.run import Phase
from tests.benchmarks import bare_recorder
from tests.benchmarks.processes import cores_used, hall, python
from tests.benchmarks.report import Figure
from tests.madrob_console.engine.drive import make_setup
from tests.madrob_console.ros_peer import BOOL, KEPT, Peer

RATES = (300, 3_000)
"""Messages/s on all topics together: those of the testbed, and ten times as many."""
GOALS = {"that idles": {300: 1.3, 3_000: 0.8}, "in a run": {300: 1.3, 3_000: 0.8}}
SAMPLE = 3.0  # s
TIMEOUT = 600.0  # s
REQUESTS = 20
MOST = 3
"""Repeats of what takes seconds."""


def engine_cpu(repeats: int) -> Iterator[Figure]:
    """An engine with its children, beside a recorder of the same messages; both at once."""
    for rate in RATES:
        yield from _at_rate(rate, min(repeats, MOST))


def _at_rate(rate: int, repeats: int) -> list[Figure]:
    shares = defaultdict[str, list[float]](list)
    with (
        hall(rate) as (engine, domain),
        python("-m", bare_recorder.__name__, domain=domain) as recorder,
    ):
        assert recorder.stdout is not None
        assert recorder.stdout.readline().strip() == bare_recorder.THERE
        pids = {"": engine.process.pid, "recorder": recorder.pid}
        for state in GOALS:
            if state == "in a run":
                engine.start(make_setup(timeout=TIMEOUT))
            for _ in range(repeats):
                for name, share in cores_used(pids, SAMPLE).items():
                    shares[state + name].append(share)
    return [
        Figure(
            f"engine {state}, {rate:,} messages/s",
            "% core",
            shares[state],
            "rclpy and mcap.Writer",
            shares[f"{state}recorder"],
            goals[rate],
        )
        for state, goals in GOALS.items()
    ]


def abort(repeats: int) -> list[Figure]:
    """From the request until screen and robot have it, beside a request that does nothing."""
    requests, on_screen, at_robot = [], [], []
    with hall(RATES[0]) as (engine, domain), Peer(domain) as peer:
        said = peer.listen(REFEREE_RUNNING_TOPIC, BOOL, KEPT)
        for number in range(1 + min(repeats, MOST)):
            engine.start(make_setup(run_number=1 + number, timeout=TIMEOUT))
            peer.until(lambda: said and said[-1].data)
            began = time.perf_counter()
            for _ in range(REQUESTS):
                engine.client.send_request(GiveCurves())
            requests.append((time.perf_counter() - began) / REQUESTS)
            shown_at = heard_at = 0.0
            began = time.perf_counter()
            engine.client.begin_request(Perform.of(Abort("enough")))
            while not (shown_at and heard_at):
                peer.spin(0.0005)
                now = time.perf_counter() - began
                if not shown_at and engine.snapshot().run.phase is not Phase.RUNNING:
                    shown_at = now
                if not heard_at and not said[-1].data:
                    heard_at = now
            on_screen.append(shown_at)
            at_robot.append(heard_at)
            engine.result()
    others = [1000 * each for each in requests[1:]]
    return [
        Figure(name, "ms", [1000 * each for each in values[1:]], "a request", others, goal)
        for name, values, goal in (
            ("an abort until a screen has it", on_screen, 100.0),
            ("an abort until a robot has it", at_robot, 60.0),
        )
    ]
