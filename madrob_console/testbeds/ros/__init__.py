"""The live testbed over ROS 2.

rclpy is loaded when a source is opened, never on import: the console runs without ROS.
"""

from madrob_console.testbeds.ros.ros_source import RosSource

__all__ = ["RosSource"]
