"""Doubts on a result and what the referee says of them: on disk, and for whoever reads it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import jsonschema
import pytest

from madrob_console.archive.result_document import result_schema
from madrob_console.referee.acts import AcceptDoubts, Correct
from madrob_console.referee.flags import undecided
from scoring.evaluate import Assessment
from scoring.indicator_table import IndicatorName
from scoring.procedure import Ruling
from scoring.result import Ending, Result, Uncertainty
from scoring.rows import Rows
from tests.madrob_console.engine.test_amended_runs import CW, Desk
from tests.madrob_console.recorded_runs import completed

TOUCH = "the touch rests on 1 sample"
JITTER = "the stamps jitter by 2.1 ms"
TIME = IndicatorName.TIME_TO_HANDLE
ACCEPTED = AcceptDoubts({TIME: (TOUCH,)}, "seen on video: right")
WAITS = ["doubted: time to handle (1 doubt UNDECIDED)"]


@pytest.fixture
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Desk]:
    """A run whose touch is doubted; where it does not come to its end, for another reason, too."""
    completed()  # others use it, too, as it was made
    plain = Assessment.result

    def doubted(
        self: Assessment,
        ending: Ending,
        rulings: Sequence[Ruling] = (),
        remarks: Iterable[str] = (),
    ) -> tuple[Result, Rows]:
        result, rows = plain(self, ending, rulings, remarks)
        found = {
            name: replace(one, uncertainty=None, doubts=())
            for name, one in result.indicators.items()
        }
        whole = found[IndicatorName.CAPABILITY_LEVEL].value == 6
        doubts = (TOUCH,) if whole else (TOUCH, JITTER)
        found[TIME] = replace(found[TIME], uncertainty=Uncertainty(0.01, 0.02), doubts=doubts)
        return replace(result, indicators=found), rows

    monkeypatch.setattr(Assessment, "result", doubted)
    desk = Desk(tmp_path)
    yield desk
    desk.engine.close()


def waiting(desk: Desk) -> list[str]:
    """What the screens say that is undecided, and the same of the history."""
    found = [flag.words for flag in undecided(desk.engine.snapshot().flags)]
    assert [flag.words for flag in undecided(desk.listed.flags)] == found
    return found


def test_an_accepted_doubt_stands_in_the_result_beside_the_doubt(desk: Desk) -> None:
    desk.act(ACCEPTED)
    document = desk.document
    jsonschema.validate(document, result_schema())
    (answer,) = document["accepted_doubts"]
    assert answer["doubts"] == {"time_to_handle": [TOUCH]}
    assert (answer["reason"], answer["referee"]) == ("seen on video: right", "R. Eferee")
    assert document["indicators"]["time_to_handle"]["doubts"] == [TOUCH]
    assert document["indicators"]["time_to_handle"]["uncertainty"] == {"u": 0.01, "expanded": 0.02}
    assert (desk.listed.doubts, desk.listed.uncertainties) == (
        *({TIME: 1}, {TIME: Uncertainty(0.01, 0.02)}),
    )
    assert (desk.listed.sign(TIME), desk.listed.sign(IndicatorName.PASSAGE_TIME)) == ("?", "")
    assert waiting(desk) == []
    assert desk.agrees()


def test_taken_back_the_doubt_waits_again(desk: Desk) -> None:
    desk.act(ACCEPTED)
    desk.take_back()
    assert waiting(desk) == WAITS
    assert desk.document["accepted_doubts"] == []
    (back,) = desk.document["taken_back"]
    assert back["words"] == "doubt accepted: time to handle (seen on video: right)"
    assert desk.agrees()


def test_what_a_correction_makes_doubtful_waits_though_the_rest_was_accepted(desk: Desk) -> None:
    desk.act(ACCEPTED, Correct(3, CW, "typed wrongly"))
    assert desk.document["indicators"]["time_to_handle"]["doubts"] == [TOUCH, JITTER]
    assert waiting(desk) == WAITS
    desk.act(AcceptDoubts({TIME: (JITTER,)}, "no effect on the ranking"))
    assert waiting(desk) == []
    assert desk.agrees()


def test_what_is_not_doubted_any_more_cannot_be_accepted(desk: Desk) -> None:
    other = AcceptDoubts({TIME: (JITTER,)}, "seen")
    words = "what is doubted is something else by now: look again"
    assert desk.engine.perform(other) == words
