"""The number of a ROS domain: one testbed's network among others."""

from __future__ import annotations

import re
from collections.abc import Mapping

from madrob_console.common.errors import MadrobError

LARGEST_DOMAIN = 232
"""Fast DDS ends the process on a larger one."""

VARIABLE = "ROS_DOMAIN_ID"

_NUMBER = re.compile(r"0|[1-9][0-9]{0,2}")


def domain_number(text: str) -> int:
    """Reads a domain; an empty text is 0, as for ROS.

    ROS would read `010` as 8 and the beginning of `5abc`: both are refused.
    """
    plain = text.strip() or "0"
    if not _NUMBER.fullmatch(plain) or int(plain) > LARGEST_DOMAIN:
        raise MadrobError(f"there is no ROS domain {text!r}: use 0 to {LARGEST_DOMAIN}")
    return int(plain)


def domain_id(given: int | None, environment: Mapping[str, str]) -> int:
    """The given domain, else `ROS_DOMAIN_ID`, else 0; MadrobError unless it is from 0 to 232."""
    if given is None:
        named, text = VARIABLE, environment.get(VARIABLE, "")
    else:
        named, text = "--domain", str(given)
    try:
        return domain_number(text)
    except MadrobError as error:
        raise MadrobError(f"{named}: {error}") from None
