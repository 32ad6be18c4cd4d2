"""The executables of the nodes: what is missing is one line, not a traceback.

``ros2 run stepdiag_ros recorder`` comes in here.  A node's module imports the messages at its head, so what is not
installed shows before its ``main`` could say anything.
"""

import importlib
import sys
from functools import partial

from stepdiag_ros.guard.missing import missing


def run(node: str) -> int:
    """The exit status of a node; 2 and one line where a package that it needs is not installed."""
    try:
        return int(importlib.import_module(f'stepdiag_ros.nodes.{node}').main() or 0)
    except ModuleNotFoundError as error:
        if not error.name or error.name.split('.')[0] == 'stepdiag_ros':
            raise
        print(f'stepdiag: {node} needs {missing(error.name)}', file=sys.stderr)
        return 2


interferometer_driver = partial(run, 'interferometer_driver')
psd_driver = partial(run, 'psd_driver')
step_sequencer = partial(run, 'step_sequencer')
evaluation_solver = partial(run, 'evaluation_solver')
recorder = partial(run, 'recorder')
gap_monitor = partial(run, 'gap_monitor')
bringup = partial(run, 'bringup')
