"""Finding ROS 2 at run time: rclpy, message packages.

Everything from rclpy is a `RosObject`: its type information is partial and changes.
"""

from __future__ import annotations

import importlib
import os
import shutil
import sys
import warnings
from pathlib import Path
from typing import Any

from madrob_console.errors import MadrobError

RosObject = Any
"""Something of rclpy or of a message package."""

REMEDY = (
    "install madrob-console[ros], or source /opt/ros/jazzy/setup.bash in an environment that "
    "sees the system's packages, or use --testbed simulated"
)
"""What to do when ROS 2 is not found."""

SHARED_MEMORY = Path("/dev/shm")
"""Where programs on one machine hand messages to each other."""

_LEAST_SHARED_MEMORY = 128_000
"""Bytes. With less the system may end a program that loads ROS (SIGBUS); with more ROS does
without shared memory where it has to."""

_NEEDED = ("rclpy", "rclpy.executors", "rcl_interfaces.srv", "rosidl_generator_py")


def load_rclpy() -> RosObject:
    """The module `rclpy`.

    Raises:
        MadrobError: it is not installed, or cannot be loaded.
    """
    _refuse_full(SHARED_MEMORY)
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


def _refuse_full(folder: Path) -> None:
    try:
        free = shutil.disk_usage(folder).free
    except OSError:
        return
    if free < _LEAST_SHARED_MEMORY:
        raise MadrobError(
            f"{folder} is full, and the system ends programs that load ROS then: make room there "
            f"({folder}/fastrtps_* may go while no ROS program runs), or use --testbed simulated"
        )


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
