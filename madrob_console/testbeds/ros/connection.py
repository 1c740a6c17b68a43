"""Our part in a ROS domain: a context, its nodes and an executor."""

from __future__ import annotations

import shlex
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from madrob_console.errors import MadrobError
from madrob_console.testbeds.ros.loading import RosObject, load_module, load_rclpy

_NAMESPACE = "/madrob"
_MISREAD = ("parse", "['")
"""In what ROS says of arguments that it does not understand."""


class Connection:
    """A ROS context of its own, with nodes in the namespace `/madrob`.

    It installs no signal handlers, writes no log file and reads no command line: all three
    belong to the program. The thread that spins must be gone before `close`.

    Args:
        domain: ROS domain.
        ros_args: what a launch file says of names and namespaces, as behind `--ros-args`.

    Raises:
        MadrobError: ROS is not installed or does not start.
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
        """A new node `/madrob/<name>`; the arguments of ROS may call it otherwise.

        Args:
            name: the node's name.
            spun: whether `spin` runs its callbacks.
            parameter_services: whether others can see and set its parameters.
            beside: the node that it helps: its name begins with that one's, whatever that is.

        Raises:
            MadrobError: ROS does not let it join the domain.
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
        """Run callbacks for `duration` s."""
        ends = time.monotonic() + duration
        while (left := ends - time.monotonic()) > 0:
            self._executor.spin_once(timeout_sec=left)

    def close(self) -> None:
        """Leave the domain."""
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
        return MadrobError(
            f"ROS does not start in domain {self._domain} ({first}): look at `madrob doctor`"
        )


@contextmanager
def _one_line() -> Iterator[None]:
    """What ROS does not understand is said by us, not by ROS as well."""
    logging = load_module("rclpy.logging")
    before = logging.get_logger_level("rcl")
    logging.set_logger_level("rcl", logging.LoggingSeverity.FATAL)
    try:
        yield
    finally:
        logging.set_logger_level("rcl", before)


def in_namespace(name: str) -> str:
    """The name of a topic or service as a node gives it to ROS.

    What lies in `/madrob` lies in the namespace of the node: where a launch file moves that, it
    moves along. Other names stay.
    """
    return name.removeprefix(f"{_NAMESPACE}/")
