"""The disk with the results fills up or hangs, and no run is lost."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.stories.disks import Disk, mounted, needs_root
from tests.stories.hands import Hall

pytestmark = [pytest.mark.machine, pytest.mark.needs("mkfs.ext4"), needs_root]


@pytest.fixture
def disk(hall: Hall) -> Iterator[Disk]:
    """The disk with the results of the hall."""
    with mounted(hall.home / "disk") as disk:
        hall.put_results(disk.folder / "madrob_runs")
        yield disk
        hall.end_programs()


# Seen red: a result that a full disk refuses is not written again.
def test_full_disk_loses_no_act_and_no_result(hall: Hall, disk: Disk) -> None:
    console = hall.console(speed=2.0)
    console.open_run()
    hall.run().wait_for_event()
    disk.fill()
    console.wait_for_full_disk()
    console.wait_for_stop("COMPLETED")
    console.wait_for_unwritten_result()
    disk.make_room()
    assert hall.run().level() == 6
    assert len(hall.run().events()) == 5


# Seen red: a start that was refused after 2 s is carried out when the disk answers.
def test_start_on_a_hanging_disk_never_happens(hall: Hall, disk: Disk) -> None:
    console = hall.console(speed=1.0)
    console.make_ready()
    with disk.hanging():
        console.start_in_vain()
    console.set_up_again()
    console.start()
    console.wait_for_run()
    assert sum(run.countdowns() for run in hall.runs()) == 1
