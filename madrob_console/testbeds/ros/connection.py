"""Our part in a ROS domain: a context, its nodes and an executor."""

from __future__ import annotations

import time

from madrob_console.errors import MadrobError
from madrob_console.testbeds.ros.loading import RosObject, load_module, load_rclpy

_NAMESPACE = "/madrob"


class Connection:
    """A ROS context of its own, with nodes in the namespace `/madrob`.

    It installs no signal handlers, writes no log file and reads no command line: all three
    belong to the program. The thread that spins must be gone before `close`.

    Args:
        domain: ROS domain.

    Raises:
        MadrobError: ROS is not installed or does not start.
    """

    def __init__(self, domain: int) -> None:
        rclpy = load_rclpy()
        self._domain = domain
        self._context = rclpy.Context()
        self._nodes: list[RosObject] = []
        try:
            self._context.init(args=[], initialize_logging=False, domain_id=domain)
            executors = load_module("rclpy.executors")
            self._executor = executors.SingleThreadedExecutor(context=self._context)
        except RuntimeError as error:
            raise self._refusal(error) from None

    def node(self, name: str, *, spun: bool = True, parameter_services: bool = False) -> RosObject:
        """A new node `/madrob/<name>`.

        Args:
            name: the node's name.
            spun: whether `spin` runs its callbacks.
            parameter_services: whether others can see and set its parameters.

        Raises:
            MadrobError: ROS does not let it join the domain.
        """
        parameter = load_module("rclpy.parameter").Parameter
        try:
            node = load_module("rclpy.node").Node(
                name,
                namespace=_NAMESPACE,
                context=self._context,
                use_global_arguments=False,
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
        return MadrobError(
            f"ROS does not start in domain {self._domain} ({first}): look at `madrob doctor`"
        )
