from __future__ import annotations

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from madrob_console.errors import MadrobError
from madrob_console.kinds import Scenario
from madrob_console.names import terminal_safe
from madrob_console.testbeds.announcement import info_text, simulated_in


@pytest.mark.parametrize("scenario", Scenario)
def test_a_simulated_testbed_says_what_it_plays(scenario: Scenario) -> None:
    assert json.loads(info_text(scenario)) == {"kind": "simulated", "scenario": scenario}
    assert simulated_in(info_text(scenario)) == scenario


@pytest.mark.parametrize(
    ("text", "simulated"),
    [
        ('{"kind": "simulated"}', "it does not say what"),
        ('{"kind": "simulated", "scenario": " \\u001b[2J "}', "it does not say what"),
        ('{"kind": "simulated", "scenario": "x\\u001b[31my", "since": 3}', "xy"),
        ('{"kind": "real", "scenario": "hall"}', None),
    ],
)
def test_what_a_testbed_says_is_made_safe(text: str, simulated: str | None) -> None:
    assert simulated_in(text) == simulated


@pytest.mark.parametrize(
    "text", ["", "MADROB rev 3", "[]", '{"kind": 7}', "[" * 3000, '{"kind": "simulated"', "\ud800"]
)
def test_what_is_no_announcement_is_one_line_of_words(text: str) -> None:
    with pytest.raises(MadrobError, match="not understood: ") as told:
        simulated_in(text)
    assert str(told.value).isprintable()
    assert len(str(told.value)) < 200


@given(scenario=st.text(max_size=500))
def test_a_scenario_is_short_and_safe_for_a_terminal_whatever_it_is(scenario: str) -> None:
    told = simulated_in(json.dumps({"kind": "simulated", "scenario": scenario}))
    assert told is not None
    assert terminal_safe(told) == told
    assert 0 < len(told) <= 40
