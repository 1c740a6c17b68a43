"""The console's part in a ROS domain: finding rclpy, a context, nodes, an executor.

Everything from rclpy is a `RosObject`: its type information is partial and changes.
"""

from __future__ import annotations

import importlib
import os
import shlex
import shutil
import sys
import time
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from madrob_console.common.errors import MadrobError

RosObject = Any

REMEDY = (
    "install madrob-console[ros], or source /opt/ros/jazzy/setup.bash in an environment that "
    "sees the system's packages, or use --testbed simulated"
)

SEE_DOCTOR = ": look at `madrob doctor`"

SHARED_MEMORY = Path("/dev/shm")

_LEAST_SHARED_MEMORY = 128_000
"""Bytes; with less, loading ROS may kill the program (SIGBUS)."""

_MIDDLEWARES = "share/ament_index/resource_index/rmw_typesupport"
"""Folder below a prefix with a file for each middleware that is installed there."""

_NEEDED = ("rclpy", "rclpy.executors", "rcl_interfaces.srv", "rosidl_generator_py")


def load_rclpy() -> RosObject:
    _refuse_full(SHARED_MEMORY)
    # The wheels leave it unset; rclpy looks for its plugins there.
    os.environ.setdefault("AMENT_PREFIX_PATH", sys.prefix)
    _refuse_missing_middleware()
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


def _refuse_missing_middleware() -> None:
    """Raise MadrobError where ROS would end the program: its middleware is not installed."""
    wanted = os.environ.get("RMW_IMPLEMENTATION")
    found: set[str] = set()
    for prefix in (*os.environ["AMENT_PREFIX_PATH"].split(os.pathsep), sys.prefix):
        found |= {path.name for path in Path(prefix, _MIDDLEWARES).glob("rmw_*_cpp")}
    if wanted and found and wanted not in found:
        raise MadrobError(
            f"RMW_IMPLEMENTATION={wanted}, but only {', '.join(sorted(found))} is installed: "
            "unset it, or source a ROS that has it"
        )


def load_module(name: str) -> RosObject:
    return importlib.import_module(name)


def load_message_class(type_name: str) -> RosObject:
    """The class of the type `pkg/msg/Type`; MadrobError where it is not installed."""
    package, _, rest = type_name.partition("/")
    kind, _, name = rest.rpartition("/")
    try:
        return getattr(importlib.import_module(f"{package}.{kind}"), name)
    except (ImportError, AttributeError, ValueError):
        raise MadrobError(
            f"{type_name} is not installed here: source the workspace that has {package or 'it'}"
        ) from None


_NAMESPACE = "/madrob"
_MISREAD = ("parse", "['")


class Connection:
    """A ROS context of its own, with nodes in the namespace `/madrob`.

    It installs no signal handlers, writes no log file and reads no command line: these belong to
    the program. The thread that spins must have ended before `close`. Where ROS is not installed or
    does not start, it raises MadrobError.
    """

    def __init__(self, domain: int, ros_args: Sequence[str] = ()) -> None:
        rclpy = load_rclpy()
        self._domain = domain
        self._ros_args = ["--ros-args", *ros_args] if ros_args else []
        self._context = rclpy.Context()
        self._nodes: list[RosObject] = []
        try:
            with _one_line():
                self._context.init(args=self._ros_args, initialize_logging=False, domain_id=domain)
            executors = load_module("rclpy.executors")
            self._executor = executors.SingleThreadedExecutor(context=self._context)
        except RuntimeError as error:
            raise self._refusal(error) from None

    def node(
        self,
        name: str,
        *,
        spun: bool = True,
        parameter_services: bool = False,
        beside: RosObject = None,
    ) -> RosObject:
        """A new node `/madrob/<name>`, unless the ROS arguments rename it.

        A node `beside` another takes that one's name as its prefix. `spin` runs callbacks only of a
        node that is `spun`. Where ROS does not let it join the domain, it raises MadrobError.
        """
        parameter = load_module("rclpy.parameter").Parameter
        if beside is not None:
            name = f"{beside.get_name()}_{name}"
        try:
            node = load_module("rclpy.node").Node(
                name,
                namespace=_NAMESPACE,
                context=self._context,
                # its own arguments come first: two nodes must not get the same name
                cli_args=beside and ["--ros-args", "-r", f"__node:={name}"],
                enable_rosout=False,
                start_parameter_services=parameter_services,
                parameter_overrides=[parameter("start_type_description_service", value=False)],
            )
        except RuntimeError as error:
            self.close()
            raise self._refusal(error) from None
        self._nodes.append(node)
        if spun:
            self._executor.add_node(node)
        return node

    def spin(self, duration: float) -> None:
        ends = time.monotonic() + duration
        while (left := ends - time.monotonic()) > 0:
            self._executor.spin_once(timeout_sec=left)

    def close(self) -> None:
        self._executor.shutdown()
        for node in self._nodes:
            node.destroy_node()
        self._nodes.clear()
        self._context.try_shutdown()

    def _refusal(self, error: RuntimeError) -> MadrobError:
        first = next(iter(str(error).splitlines()), "no reason given")
        if self._ros_args and any(word in first for word in _MISREAD):
            why = first.removeprefix("failed to initialize rcl: ").partition(", at /")[0]
            given = shlex.join(self._ros_args)
            return MadrobError(f"`{given}`: ROS does not understand that ({why}), correct it")
        remedy = SEE_DOCTOR
        if os.environ.get("ROS_SECURITY_ENABLE") == "true":
            remedy = ": ROS_SECURITY_ENABLE=true needs ROS_SECURITY_KEYSTORE, correct or unset it"
        return MadrobError(f"ROS does not start in domain {self._domain} ({first}){remedy}")


@contextmanager
def _one_line() -> Iterator[None]:
    """Keeps ROS from printing argument errors that the console reports itself."""
    logging = load_module("rclpy.logging")
    before = logging.get_logger_level("rcl")
    logging.set_logger_level("rcl", logging.LoggingSeverity.FATAL)
    try:
        yield
    finally:
        logging.set_logger_level("rcl", before)


def in_namespace(name: str) -> str:
    """Makes a name in `/madrob` relative, so that it follows a launch file's namespace."""
    return name.removeprefix(f"{_NAMESPACE}/")
