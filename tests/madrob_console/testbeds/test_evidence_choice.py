from __future__ import annotations

import json
import re
from collections.abc import Sequence
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from madrob_console.cli.main import main
from madrob_console.common.clock import NS
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import Scenario, terminal_safe
from madrob_console.testbeds.announcement import info_text, simulated_in
from madrob_console.testbeds.evidence_choice import NO_LIMIT, EvidenceChoice, TopicLimit, matches
from madrob_console.testbeds.message_rates import FlowMeter, RateLimit, SilenceWatch
from madrob_console.testbeds.ros_domain import domain_id
from recorder.bag import RawMessage


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


def test_the_settings_say_which_topics_at_which_rate_and_what_is_missing() -> None:
    left, cameras = TopicLimit("/camera/left", 10.0), TopicLimit("/camera/*", 1.0)
    choice = EvidenceChoice(("/camera/**", "/tf"), ("/camera/spare/**",), (left, cameras))
    topics = ("/camera/left", "/camera/spare/raw", "/tf", "/rosout")
    assert [choice.wants(name) for name in topics] == [True, False, True, False]
    assert not EvidenceChoice().wants("/tf")
    limits = [choice.limit(name) for name in ("/camera/left", "/camera/right", "/tf")]
    assert limits == [left, cameras, NO_LIMIT]
    assert choice.unmatched({"/camera/left", "/tf_static"}) == ("/tf",)


@pytest.mark.parametrize(("sent", "most"), [(30.0, 10.0), (30.0, 20.0), (1000.0, 15.0), (16, 15)])
def test_a_faster_topic_is_thinned_to_the_rate_of_the_settings(sent: float, most: float) -> None:
    rate_limit = RateLimit(most)
    passed = [rate_limit.passes(round(number / sent * NS)) for number in range(round(sent * 60))]
    assert sum(passed) / 60 == pytest.approx(most, rel=0.04)
    later = passed[round(sent * 30) :]
    assert sum(later) / 30 == pytest.approx(most, rel=0.025)


def test_a_camera_of_15_hz_with_jitter_loses_nothing_by_a_limit_of_15() -> None:
    random = Random(7)
    rate_limit = RateLimit(15.0)
    came = sorted(number / 15.01 + random.gauss(0, 0.01) for number in range(15 * 3600))
    assert all(rate_limit.passes(round((1 + at) * NS)) for at in came)


def test_without_a_rate_everything_passes_and_a_clock_that_goes_back_stops_nothing() -> None:
    assert all(RateLimit(None).passes(at) for at in (5, 5, 4, 9))
    rate_limit = RateLimit(1.0)
    for begin in (100, 7):
        instants = [at * NS for at in range(begin, begin + 10) for _ in range(3)]
        assert sum(map(rate_limit.passes, instants)) == 11


def test_rates_are_those_of_the_last_seconds() -> None:
    meter = FlowMeter(0.0)
    for number in range(300):
        meter.count([RawMessage("/a", "a/msg/B", bytes(1000), 0, 0)], number / 30)
    rate, byte_rate = meter.rates(10.0)
    assert rate == pytest.approx(30, rel=0.05)
    assert byte_rate == pytest.approx(30_000, rel=0.05)
    assert meter.rates(12.5)[0] == pytest.approx(15, rel=0.05)
    assert meter.rates(20.0) == (0.0, 0.0)


STEADY = [number / 10 for number in range(50)]  # until 4.9 s


@pytest.mark.parametrize(
    ("came", "now", "since"),
    [
        (STEADY, 6.8, None),
        (STEADY, 7.0, 4.9),
        ([*STEADY, *(9 + at for at in STEADY)], 14.0, None),
        ([*STEADY, 9.0], 12.0, 9.0),
        ([], 1000.0, None),
        ([0.0], 1000.0, None),
        ([0.1 * n for n in range(15)], 1000.0, None),
        ([0.0, 30.0, 60.0, 90.0], 1000.0, None),
    ],
)
def test_a_camera_that_stops_is_silent_and_what_comes_now_and_then_is_not(
    came: Sequence[float], now: float, since: float | None
) -> None:
    watch = SilenceWatch()
    for at in came:
        watch.came(round(at * NS))
    assert watch.silent_since(round(now * NS)) == since


def test_what_the_settings_name_may_not_be_silent_from_the_first() -> None:
    for named, problem in ((True, "nothing has come"), (False, "")):
        watch = SilenceWatch(named=named)
        assert watch.problem(9 * NS) == ""  # nobody listens yet
        for at in range(4, 9):
            watch.listen(at * NS)
        assert watch.problem(6 * NS) == ""
        assert watch.problem(7 * NS) == problem
        watch.came(7 * NS)
        assert watch.problem(100 * NS) == ""


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
    assert re.fullmatch(
        ".*--domain: there is no ROS domain .*0 to 232.*\n", capsys.readouterr().err
    )
