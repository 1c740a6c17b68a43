"""Finding ROS 2 at run time: rclpy, message packages, the domain.

Everything from rclpy is a `RosObject`: its type information is partial and changes.
"""

from __future__ import annotations

import importlib
import os
import sys
import warnings
from collections.abc import Mapping
from typing import Any

from madrob_console.errors import MadrobError

RosObject = Any
"""Something of rclpy or of a message package."""

REMEDY = (
    "install madrob-console[ros], or source /opt/ros/jazzy/setup.bash in an environment that "
    "sees the system's packages, or use --testbed simulated"
)
"""What to do when ROS 2 is not found."""

_NEEDED = ("rclpy", "rclpy.executors", "rcl_interfaces.srv", "rosidl_generator_py")

LARGEST_DOMAIN = 232
"""Fast DDS ends the process on a larger one."""


def load_rclpy() -> RosObject:
    """The module `rclpy`.

    Raises:
        MadrobError: it is not installed, or cannot be loaded.
    """
    # The wheels leave it unset; rclpy looks for its plugins there.
    os.environ.setdefault("AMENT_PREFIX_PATH", sys.prefix)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of its dependencies
            for name in _NEEDED:
                importlib.import_module(name)
        return importlib.import_module("rclpy")
    except ModuleNotFoundError as error:
        raise MadrobError(f"ROS 2 is not here ({error.name} is missing): {REMEDY}") from None
    except (ImportError, OSError) as error:
        first = next(iter(str(error).splitlines()), type(error).__name__)
        raise MadrobError(f"ROS 2 cannot be loaded ({first}): {REMEDY}") from None


def load_module(name: str) -> RosObject:
    """A module of rclpy or of a message package, after `load_rclpy`."""
    return importlib.import_module(name)


def load_message_class(type_name: str) -> RosObject:
    """The class of a message type, `pkg/msg/Type`.

    Raises:
        MadrobError: it is not installed.
    """
    package, _, rest = type_name.partition("/")
    kind, _, name = rest.rpartition("/")
    try:
        return getattr(importlib.import_module(f"{package}.{kind}"), name)
    except (ImportError, AttributeError, ValueError):
        raise MadrobError(
            f"{type_name} is not installed here: source the workspace that has {package or 'it'}"
        ) from None


def domain_id(given: int | None, environment: Mapping[str, str]) -> int:
    """The ROS domain to use: the given one, else `ROS_DOMAIN_ID`, else 0.

    Raises:
        MadrobError: it is no number from 0 to 232.
    """
    text = environment.get("ROS_DOMAIN_ID", "") if given is None else str(given)
    try:
        domain = int(text or "0")
    except ValueError:
        domain = -1
    if not 0 <= domain <= LARGEST_DOMAIN:
        raise MadrobError(f"ROS domain {text!r} does not exist: use 0 to {LARGEST_DOMAIN}")
    return domain
