"""What is not installed, and how to get it."""

from importlib.util import find_spec

#: Modules that come with ROS 2.
ROS = ('rclpy', 'rcl_interfaces', 'diagnostic_msgs', 'lifecycle_msgs', 'action_msgs', 'std_msgs', 'std_srvs',
       'sensor_msgs', 'geometry_msgs', 'rosgraph_msgs', 'builtin_interfaces', 'ament_index_python',
       'tf2_msgs', 'visualization_msgs')
#: Module -> the extra of the wheel that brings it (setup.py).
EXTRAS = {'matplotlib': 'pictures', 'zstandard': 'compression', 'lz4': 'compression', 'pymodbus': 'instruments',
          'starlette': 'web', 'uvicorn': 'web', 'wsproto': 'web'}


def missing(module: str) -> str:
    """What brings a module that is not there, as the rest of a sentence that begins with "needs"."""
    top = module.split('.')[0]
    if top == 'stepdiag_msgs' and find_spec('rclpy') is None:
        top = 'rclpy'   # without ROS 2 the messages are the second thing to be missing
    if top == 'stepdiag_msgs':
        return ('the messages package stepdiag_msgs, which is not installed: in a ROS workspace lay both packages '
                'side by side with `make ros-workspace WS=/path/to/ws` and build them with colcon')
    if top in ROS:
        return (f'ROS 2 Jazzy ({top} is not installed): source its setup file, or in a checkout run `make setup`, '
                'which installs it from wheels')
    if top in EXTRAS:
        return f'the package {top}, which is not installed: pip install "stepdiag_ros[{EXTRAS[top]}]"'
    return f'the package {top}, which is not installed: pip install {top}'
