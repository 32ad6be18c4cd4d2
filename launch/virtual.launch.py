"""A virtual machine with its instruments and nodes, watched over by `bringup`, where ROS 2 is installed.

  ros2 launch stepdiag_ros virtual.launch.py
  ros2 run stepdiag_ros stepdiag calibrate        # in another terminal: now it moves

`cell` is a cell file, without one the small machine of `stepdiag demo`; its nodes are in the namespace `namespace`.
"""

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node


def generate_launch_description() -> LaunchDescription:
    cell = PathJoinSubstitution([get_package_share_directory('stepdiag_ros'), 'cells', 'demo.yaml'])
    arguments = [
        DeclareLaunchArgument('cell', default_value=cell, description='cell file of a virtual machine'),
        DeclareLaunchArgument('namespace', default_value='cell1', description="the machine's namespace"),
        DeclareLaunchArgument('bag_folder', default_value='.', description='where the recorder makes bags'),
    ]
    # bringup ends its nodes in order, the recorder last: it is given the time that this takes.
    machine = Node(package='stepdiag_ros', executable='bringup', namespace=LaunchConfiguration('namespace'),
                   arguments=[LaunchConfiguration('cell'), '--namespace', LaunchConfiguration('namespace'),
                              '--bag-folder', LaunchConfiguration('bag_folder')],
                   output='screen', sigterm_timeout='60', sigkill_timeout='30')
    return LaunchDescription([*arguments, machine])
