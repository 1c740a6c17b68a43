"""A day at the door in a terminal."""

from __future__ import annotations

import zipfile

from tests.stories.hands import Hall


# Seen red: the signature is not written into the result.
def test_run_is_set_up_completed_and_signed(hall: Hall) -> None:
    console = hall.console(rehearsal=True)
    console.set_up()
    console.zero()
    console.confirm_pose()
    console.start()
    console.wait_for_stop("COMPLETED")
    assert hall.run().level() == 6
    console.sign()
    assert hall.run().is_signed()
    console.open_history("Alpha", "1 valid")
    console.open_result()
    console.export_zip()
    (packed,) = hall.zips()
    assert any(name.endswith(hall.run().bag.name) for name in zipfile.ZipFile(packed).namelist())
    console.open_standings("REHEARSAL", "Alpha 6")
    assert console.leave() == 0
    assert "Alpha 6" in hall.standings()
