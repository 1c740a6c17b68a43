"""Programs are killed, and no run is lost."""

from __future__ import annotations

import time

from mcap.reader import SeekingReader

from recorder import Bag
from tests.stories.hands import Hall

LOST = 0.5  # s of a recording that the end of an engine costs at most
LATE = 0.3  # s that a busy machine may take for the kill


# Seen red: the engine ends with the console that started it.
def test_run_goes_on_without_its_console(hall: Hall) -> None:
    console = hall.console(speed=2.0)
    console.open_run()
    console.wait_for_run()
    console.kill()
    other = hall.console(speed=2.0)
    other.wait_for_run()
    other.wait_for_stop("COMPLETED")
    assert hall.run().level() == 6
    assert hall.check().code == 0


# Seen red: the recorder writes its data every five seconds.
def test_killed_engine_leaves_an_interrupted_run(hall: Hall) -> None:
    console = hall.console(speed=1.0)
    console.open_run()
    hall.run().wait_for_event()
    hall.kill_engine()
    killed = time.time()
    times = [message.receive_ns for message in Bag(hall.run().folder).messages()]
    assert killed - max(times, default=0) / 1e9 < LOST + LATE
    console.wait_for("the engine has ended")
    console.start_engine_again()
    console.score_as_interrupted()
    assert hall.run().outcome() == "interrupted"


# Seen red: `madrob recover` leaves a torn file as it is.
def test_recover_repairs_a_torn_recording(hall: Hall) -> None:
    console = hall.console(speed=1.0)
    console.open_run()
    hall.run().wait_for_event()
    hall.kill_engine()
    kept = [message.data for message in Bag(hall.run().folder).messages()]
    assert hall.recover().code == 0
    with hall.run().bag.open("rb") as file:  # a torn file has no summary to read by
        whole = [message.data for _, _, message in SeekingReader(file).iter_messages()]
    assert sorted(whole) == sorted(kept)


# Seen red: a scoring process that has ended is not started again.
def test_result_comes_though_its_scoring_is_killed(hall: Hall) -> None:
    console = hall.console()
    console.make_ready()
    hall.stop_scorers()
    console.start()
    console.wait_for_stop("COMPLETED")
    hall.kill_scorers()
    assert hall.run().level() == 6
