"""The number of a ROS domain: one testbed's network among others.

What people and scripts write for the same number is the same domain, read as ROS reads it: what the
console takes for domain 8 is where the testbed's own nodes are.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

from madrob_console.common.errors import MadrobError

LARGEST_DOMAIN = 232
"""Fast DDS ends the process on a larger one."""

VARIABLE = "ROS_DOMAIN_ID"

_NUMBER = re.compile(r"\+?(?:(0x[0-9a-f]{1,9})|(0[0-7]{0,9})|([1-9][0-9]{0,9}))", re.IGNORECASE)


def domain_number(text: str) -> int:
    """Reads a domain as ROS does: `010` is octal, `0x10` hexadecimal, an empty text is 0.

    `5abc` is refused, although ROS would read its beginning.
    """
    plain = text.strip(" \t\n\r\f\v") or "0"
    number = LARGEST_DOMAIN + 1
    if match := _NUMBER.fullmatch(plain):
        hexadecimal, octal, decimal = match.groups()
        number = int(hexadecimal or octal or decimal, 16 if hexadecimal else 8 if octal else 10)
    if number > LARGEST_DOMAIN:
        raise MadrobError(f"there is no ROS domain {text!r}: use 0 to {LARGEST_DOMAIN}")
    return number


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
