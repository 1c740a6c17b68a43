from __future__ import annotations

import pytest

from madrob_console.testbeds.evidence_choice import (
    NO_LIMIT,
    EvidenceChoice,
    TopicLimit,
    matches,
)


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
    left, all_cameras = TopicLimit("/camera/left", 10.0, 5), TopicLimit("/camera/*", 1.0)
    choice = EvidenceChoice(("/**",), limits=(left, all_cameras))
    assert choice.limit("/camera/left") == left
    assert choice.limit("/camera/right") == all_cameras
    assert choice.limit("/tf") == NO_LIMIT


def test_patterns_that_no_topic_matches_are_told() -> None:
    choice = EvidenceChoice(("/camera/**", "/tf", "/robot/status"))
    assert choice.unmatched({"/camera/left", "/tf_static"}) == ("/tf", "/robot/status")
