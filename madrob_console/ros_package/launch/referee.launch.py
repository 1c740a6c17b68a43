"""Starts the engine of a live testbed; `madrob console --testbed ros` attaches to it.

`ros2 launch madrob_console referee.launch.py namespace:=/hall2`
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def generate_launch_description() -> LaunchDescription:
    """The engine as one node; the settings of its user say the rest."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("namespace", default_value="/"),
            Node(
                executable="madrob",
                arguments=["engine", "serve", "--testbed", "ros"],
                namespace=LaunchConfiguration("namespace"),
                output="screen",
            ),
        ]
    )
