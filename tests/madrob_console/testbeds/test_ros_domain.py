"""One number, however it is written: two engines never take one ROS domain for two."""

from __future__ import annotations

from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from madrob_console.cli.main import main
from madrob_console.errors import MadrobError
from madrob_console.testbeds.ros_domain import LARGEST_DOMAIN, domain_id, domain_number


@pytest.mark.parametrize("text", ["", "0", "00", "+0", " 0 ", "\t", "0x0"])
def test_all_words_for_domain_0_are_domain_0(text: str) -> None:
    assert domain_id(None, {"ROS_DOMAIN_ID": text}) == 0
    assert domain_id(None, {}) == domain_id(0, {"ROS_DOMAIN_ID": "7"}) == 0


@pytest.mark.parametrize(
    ("text", "number"), [("7", 7), ("+7", 7), ("007", 7), ("010", 8), ("0x10", 16), ("232", 232)]
)
def test_a_number_is_read_as_ros_reads_it(text: str, number: int) -> None:
    assert domain_number(text) == number


@pytest.mark.parametrize(
    "text",
    ["a/b", "../0", "233", "999999999999", "-1", "5abc", "1_0", "0_0", "09", "1 0", "1.0", "٣"],
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
