from __future__ import annotations

import json
from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from madrob_console.cli.main import main
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import Scenario, terminal_safe
from madrob_console.testbeds.evidence_choice import NO_LIMIT, EvidenceChoice, TopicLimit, matches
from madrob_console.testbeds.ros_domain import LARGEST_DOMAIN, domain_id, domain_number
from madrob_console.testbeds.source import info_text, simulated_in


@pytest.mark.parametrize(
    ("pattern", "topic", "found"),
    [
        ("/tf", "/tf", True),
        ("/tf", "/tf_static", False),
        ("/tf*", "/tf_static", True),
        ("/camera/*/image", "/camera/left/image", True),
        ("/camera/*/image", "/camera/left/raw/image", False),
        ("/camera/*/image", "/camera//image", False),
        ("/camera/l*t/image", "/camera/lt/image", True),
        ("/robot/**", "/robot/arm/state", True),
        ("/robot/**", "/robot", False),
        ("/robot/**", "/robots/arm", False),
        ("/**", "/a", True),
        ("/**/image", "/image", True),
        ("/**/image", "/a/b/image", True),
        ("/**/**/image", "/a/b/c/image", True),
        ("/**/image", "/a/b/images", False),
        ("/robot/**", "/robot/_action/status", False),
        ("/robot/_action/**", "/robot/_action/status", True),
        ("/*", "/_hidden", False),
        ("/a.b", "/axb", False),
    ],
)
def test_a_pattern_matches_as_ros_users_read_it(pattern: str, topic: str, found: bool) -> None:
    assert matches(pattern, topic) is found


def test_many_wildcards_take_no_time() -> None:
    assert not matches("/**" * 60 + "/x", "/a" * 120)


def test_a_topic_is_wanted_if_it_matches_and_is_not_excluded() -> None:
    choice = EvidenceChoice(("/camera/**", "/tf"), ("/camera/spare/**",))
    assert [
        choice.wants(name) for name in ("/camera/left", "/camera/spare/raw", "/tf", "/rosout")
    ] == [True, False, True, False]
    assert not EvidenceChoice().wants("/tf")


def test_the_first_limit_that_matches_a_topic_holds_for_it() -> None:
    left, all_cameras = TopicLimit("/camera/left", 10.0), TopicLimit("/camera/*", 1.0)
    choice = EvidenceChoice(("/**",), limits=(left, all_cameras))
    assert choice.limit("/camera/left") == left
    assert choice.limit("/camera/right") == all_cameras
    assert choice.limit("/tf") == NO_LIMIT


def test_patterns_that_no_topic_matches_are_told() -> None:
    choice = EvidenceChoice(("/camera/**", "/tf", "/robot/status"))
    assert choice.unmatched({"/camera/left", "/tf_static"}) == ("/tf", "/robot/status")


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


@pytest.mark.parametrize("text", ["", "0", " 0 ", "\t"])
def test_all_words_for_domain_0_are_domain_0(text: str) -> None:
    assert domain_id(None, {"ROS_DOMAIN_ID": text}) == 0
    assert domain_id(None, {}) == domain_id(0, {"ROS_DOMAIN_ID": "7"}) == 0


@pytest.mark.parametrize(
    "text",
    ["a/b", "../0", "233", "999999999999", "-1", "5abc", "1_0", "010", "0x10", "1 0", "1.0", "٣"],
)
def test_what_is_no_domain_is_refused_with_its_name_and_the_remedy(
    text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(MadrobError, match=r"ROS_DOMAIN_ID: there is no ROS domain .*0 to 232"):
        domain_id(None, {"ROS_DOMAIN_ID": text})
    with pytest.raises(SystemExit, match="2"):
        main(["doctor", f"--domain={text}"])
    said = capsys.readouterr().err
    assert "--domain: there is no ROS domain" in said
    assert "0 to 232" in said
    assert said.count("\n") == 1


@given(text=st.text(max_size=12))
def test_no_text_is_anything_but_a_domain_or_refused(text: str) -> None:
    with suppress(MadrobError):
        assert 0 <= domain_number(text) <= LARGEST_DOMAIN


@given(number=st.integers(0, LARGEST_DOMAIN))
def test_every_domain_is_read(number: int) -> None:
    assert domain_number(str(number)) == number
