"""A recording process of its own, for tests that kill it or take its disk away."""

from __future__ import annotations

import json
import os
import resource
import sys
import time
from itertools import count
from pathlib import Path

from recorder.bag import RawMessage, Topic
from recorder.errors import RecorderError
from recorder.writer import BagWriter, RecorderState

TOPIC = Topic("/blob", "test_msgs/msg/Blob", "uint8[] data\n")
RECORDS = {"madrob_run": {"setup": "{}"}}


def blob(number: int, size: int) -> RawMessage:
    """A message with its number in front, of bytes that cannot be compressed."""
    now = time.time_ns()
    return RawMessage(TOPIC.name, TOPIC.type, number.to_bytes(4) + os.urandom(size), now, now)


def record_until_killed(folder: Path) -> None:
    """Record at 1 kHz; one line once it runs."""
    writer = BagWriter(folder, [TOPIC], RECORDS)
    writer.open()
    tell("recording")
    for number in count():
        writer.put_message(blob(number, 60))
        time.sleep(0.001)


def record_on_a_small_disk(folder: Path, limit: int) -> None:
    """Record until the file may not grow any more."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
    writer = BagWriter(folder, [TOPIC], RECORDS)
    writer.open()
    numbers = count()
    while writer.stats().state is RecorderState.RECORDING:
        writer.put_message(blob(next(numbers), 10_000))
        time.sleep(0.002)
    accepted_after = [writer.put_message(blob(next(numbers), 10)) for _ in range(3)]
    summary = writer.close()
    stats = writer.stats()
    tell(
        {
            "handed_in": next(numbers),
            "accepted_after": accepted_after,
            "saved": summary.counts[TOPIC.name],
            "dropped": summary.dropped[TOPIC.name],
            "error": summary.error,
            "state": stats.state,
            "queued": stats.queued_bytes,
        }
    )


def record_without_rights(folder: Path) -> None:
    """Record as somebody who may not write there, even where the tests run as root."""
    if os.geteuid() == 0:
        os.seteuid(65534)
    BagWriter(folder, [TOPIC], RECORDS).open()


def tell(report: object) -> None:
    sys.stdout.write(json.dumps(report) + "\n")
    sys.stdout.flush()


def main(how: str, folder: Path, limit: int) -> None:
    try:
        match how:
            case "until-killed":
                record_until_killed(folder)
            case "on-a-small-disk":
                record_on_a_small_disk(folder, limit)
            case "without-rights":
                record_without_rights(folder)
    except RecorderError as error:
        tell({"refused": str(error)})


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]), int(sys.argv[3]))
