"""What a run is called among all runs of all testbeds (protocol section 2)."""

from __future__ import annotations

from collections.abc import Callable
from uuid import NAMESPACE_URL, UUID, uuid5

Randomness = Callable[[int], bytes]
"""So many random bytes."""

_MILLISECOND = 1_000_000  # ns


def new_run_id(now_ns: int, random: Randomness) -> str:
    """The identity of a run that is set up: a UUID of version 7 (RFC 9562), sorted by time.

    Args:
        now_ns: when it is set up, ns since the epoch.
        random: tells it from all others of the same millisecond.
    """
    time = (now_ns // _MILLISECOND) % 2**48
    chance = int.from_bytes(random(10), "big") % 2**74
    number = time << 80 | 7 << 76 | (chance >> 62) << 64 | 0b10 << 62 | chance % 2**62
    return str(UUID(int=number))


def derived_run_id(sha256: str) -> str:
    """The identity of a run that was set up before runs had one: a UUID of version 5 (RFC 9562).

    It is the same wherever the recording lies: that of the URL `urn:sha256:` and the digest.

    Args:
        sha256: the digest of its recording, as `sha256sum` prints it.
    """
    return str(uuid5(NAMESPACE_URL, f"urn:sha256:{sha256}"))
