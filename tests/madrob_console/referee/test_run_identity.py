"""The identity of a run (protocol section 2)."""

from __future__ import annotations

from random import Random
from uuid import NAMESPACE_URL, RFC_4122, UUID, uuid5

from hypothesis import given
from hypothesis import strategies as st

from madrob_console.referee.run_identity import derived_run_id, new_run_id

DIGEST = "488b9290a49c12afaffc94fef48b19fbdcbd1ed80ef910c4e48a25f192b08ac9"


@given(milliseconds=st.integers(0, 2**48 - 1), seed=st.integers())
def test_a_new_identity_is_a_uuid_of_version_7_with_the_time_of_the_set_up(
    milliseconds: int, seed: int
) -> None:
    found = UUID(new_run_id(milliseconds * 1_000_000, Random(seed).randbytes))
    assert (found.version, found.variant) == (7, RFC_4122)
    assert found.int >> 80 == milliseconds


def test_the_example_of_rfc_9562_comes_of_its_time_and_its_chance() -> None:
    chance = 0xCC3 << 62 | 0x18C4DC0C0C07398F
    made = new_run_id(0x017F22E279B0 * 1_000_000, lambda count: chance.to_bytes(count, "big"))
    assert made == "017f22e2-79b0-7cc3-98c4-dc0c0c07398f"


def test_clock_and_chance_are_given_so_that_the_identity_is_known_beforehand() -> None:
    assert new_run_id(5, Random(1).randbytes) == new_run_id(5, Random(1).randbytes)
    assert new_run_id(5, Random(1).randbytes) != new_run_id(5, Random(2).randbytes)


def test_the_identity_of_an_older_run_hangs_on_its_recording_alone() -> None:
    assert derived_run_id(DIGEST) == str(uuid5(NAMESPACE_URL, f"urn:sha256:{DIGEST}"))
    assert UUID(derived_run_id(DIGEST)).version == 5
