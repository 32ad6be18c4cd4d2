"""Launch the nodes of one machine where ROS 2 is installed.

  ros2 launch stepdiag_ros cell.launch.py params:=/path/parameters.yaml namespace:=demo

`params` is a ROS parameter file, and without one nothing is started; `stepdiag up CELL.yaml --runtime DIR`
writes one as DIR/parameters.yaml, which can be edited for real instruments.  Every node configures and
activates itself (parameter `autostart`) and tries again once a second until its instrument
answers.  A node that dies is started again.  Watching over a virtual cell as well is what
`ros2 run stepdiag_ros bringup CELL.yaml` does.
"""

from pathlib import Path

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

NODES = ('recorder', 'evaluation_solver', 'gap_monitor', 'interferometer_driver', 'psd_driver',
         'step_sequencer')


def check(context: LaunchContext) -> list:
    """Nothing; ``RuntimeError`` where the parameter file is missing: the nodes would start with defaults."""
    file = Path(LaunchConfiguration('params').perform(context))
    if not file.is_file():
        raise RuntimeError(f'{file}: there is no such parameter file; `stepdiag up CELL.yaml --runtime DIR` writes one')
    if not any(f'/**/{name}:' in file.read_text(encoding='utf-8') for name in NODES):
        raise RuntimeError(f'{file}: names none of the nodes; its keys are /**/{NODES[-1]} and so on')
    return []


def generate_launch_description() -> LaunchDescription:
    arguments = [
        DeclareLaunchArgument('params', description='ROS parameter file of the machine'),
        DeclareLaunchArgument('namespace', default_value='cell1', description="the machine's namespace"),
    ]
    nodes = [
        Node(package='stepdiag_ros', executable=name, namespace=LaunchConfiguration('namespace'),
             parameters=[LaunchConfiguration('params'), {'autostart': True}],
             respawn=True, respawn_delay=1.0, output='screen')
        for name in NODES
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=check), *nodes])
