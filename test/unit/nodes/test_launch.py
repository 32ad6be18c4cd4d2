"""The launch file starts every node, by a stand-in for `launch`, which is not on PyPI."""

import ast
import runpy
import sys
from pathlib import Path
from types import ModuleType

import pytest

from stepdiag_ros.nodes.graph import NODES

ROOT = Path(__file__).resolve().parents[3]


class Recorded:
    """Stands for any class of launch: remembers how it was made."""

    def __init__(self, *args, **kwargs):
        self.args, self.kwargs = args, kwargs


@pytest.fixture
def launched(monkeypatch) -> list[Recorded]:
    names = {'launch': ['LaunchContext', 'LaunchDescription'],
             'launch.actions': ['DeclareLaunchArgument', 'OpaqueFunction'],
             'launch.substitutions': ['LaunchConfiguration'], 'launch_ros': [],
             'launch_ros.actions': ['Node']}
    for module_name, classes in names.items():
        module = ModuleType(module_name)
        for name in classes:
            setattr(module, name, type(name, (Recorded,), {}))
        monkeypatch.setitem(sys.modules, module_name, module)
    description = runpy.run_path(str(ROOT / 'launch' / 'cell.launch.py'))['generate_launch_description']()
    return description.args[0]


def test_every_node_is_launched_and_starts_by_itself(launched):
    nodes = [entry for entry in launched if type(entry).__name__ == 'Node']
    assert {node.kwargs['executable'] for node in nodes} == set(NODES)
    for node in nodes:
        assert node.kwargs['package'] == 'stepdiag_ros'
        assert {'autostart': True} in node.kwargs['parameters'] and node.kwargs['respawn']


def test_what_is_launched_is_installed():
    tree = ast.parse((ROOT / 'setup.py').read_text(encoding='utf-8'))
    installed = next(ast.literal_eval(node.value) for node in ast.walk(tree)
                     if isinstance(node, ast.Assign) and getattr(node.targets[0], 'id', '') == 'NODES')
    # The multiplexer is a hall's, not one machine's.
    assert set(NODES) | {'bringup', 'multiplexer'} == set(installed)
