"""What a referee decides after the stop."""

from __future__ import annotations

from tests.stories.hands import CORRECTED, RULED, TAKEN_BACK, Hall


# Seen red: a correction leaves the subject as it was set up.
def test_corrected_team_gets_the_run(hall: Hall) -> None:
    console = hall.console(rehearsal=True)
    console.complete_run()
    assert "Alpha" in hall.standings()
    console.correct_team(2)
    assert hall.run().result(after=CORRECTED)["subject"] == 2
    assert "Beta 6" in hall.standings()
    assert "Alpha" not in hall.standings()


# Seen red: a ruling that was taken back still counts.
def test_denied_step_lowers_level_until_taken_back(hall: Hall) -> None:
    console = hall.console()
    console.complete_run()
    console.deny_step(4)
    assert hall.run().level(after=RULED) == 3
    console.take_back()
    assert hall.run().level(after=TAKEN_BACK) == 6


# Seen red: an open protest does not keep a result from its signature.
def test_upheld_protest_is_mended_and_signed(hall: Hall) -> None:
    console = hall.console(rehearsal=True)
    console.complete_run()
    console.deny_step(4)
    console.protest(4, "we did cross")
    console.try_to_sign("a protest is open")
    console.uphold_protest("the video shows it")
    console.confirm_step(4)
    assert hall.run().level(after=RULED) == 6
    console.sign()
    assert hall.run().is_signed()
