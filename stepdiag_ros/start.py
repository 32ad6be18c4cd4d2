"""The executables of the nodes: what is missing is one line, not a traceback.

``ros2 run stepdiag_ros recorder`` comes in here.  A node's module imports the messages at its head, so what is not
installed shows before its ``main`` could say anything.
"""

import importlib
import sys

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


def interferometer_driver() -> int:
    """The exit status of the node `interferometer_driver`."""
    return run('interferometer_driver')


def psd_driver() -> int:
    """The exit status of the node `psd_driver`."""
    return run('psd_driver')


def step_sequencer() -> int:
    """The exit status of the node `step_sequencer`."""
    return run('step_sequencer')


def evaluation_solver() -> int:
    """The exit status of the node `evaluation_solver`."""
    return run('evaluation_solver')


def recorder() -> int:
    """The exit status of the node `recorder`."""
    return run('recorder')


def gap_monitor() -> int:
    """The exit status of the node `gap_monitor`."""
    return run('gap_monitor')


def multiplexer() -> int:
    """The exit status of the node `multiplexer`."""
    return run('multiplexer')


def bringup() -> int:
    """The exit status of the node `bringup`."""
    return run('bringup')
