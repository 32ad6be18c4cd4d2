"""Launch files, without the launch system: it is not among the ROS wheels.

Modules that note what is made of them stand in for `launch` and `launch_ros`.  What a
file would start is compared with what is installed.  It cannot show that ROS's own
launch accepts the arguments; the names and the parameters are checked here.
"""

import ast
import importlib.abc
import importlib.machinery
import importlib.util
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
FILES = sorted((ROOT / 'launch').glob('*.launch.py'))
PROCESSES = {'Node', 'LifecycleNode'}
#: Those that start nodes with a parameter file; the others leave that to `bringup`.
WITH_PARAMETERS = [file for file in FILES if "'params'" in file.read_text(encoding='utf-8')]


@dataclass
class Noted:
    """An object of the launch system: the class's name and what it was made with."""

    kind: str
    positional: tuple[Any, ...]
    named: dict[str, Any]

    def __getattr__(self, name: str) -> Any:
        if name.startswith('__'):
            raise AttributeError(name)
        return lambda *positional, **named: Noted(f'{self.kind}.{name}', positional, named)


class StandIn(ModuleType):
    """A module all of whose names are classes that note how they were called."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith('__'):
            raise AttributeError(name)
        made = self.__dict__['made']

        def make(*positional: Any, **named: Any) -> Noted:
            noted = Noted(name, positional, named)
            made.append(noted)
            return noted

        return make


class Finder(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Finds `launch`, `launch_ros` and all below them."""

    def __init__(self) -> None:
        self.made: list[Noted] = []

    def find_spec(self, name: str, path: Any, target: Any = None) -> importlib.machinery.ModuleSpec | None:
        if name.split('.')[0] not in ('launch', 'launch_ros'):
            return None
        return importlib.machinery.ModuleSpec(name, self, is_package=True)

    def create_module(self, spec: importlib.machinery.ModuleSpec) -> ModuleType:
        module = StandIn(spec.name)
        module.__dict__['made'] = self.made
        return module

    def exec_module(self, module: ModuleType) -> None:
        return None


@pytest.fixture
def launch_system() -> Iterator[Finder]:
    """The stand-in, put before any real launch system and taken away afterwards."""
    finder = Finder()
    before = {name for name in sys.modules if name.split('.')[0] in ('launch', 'launch_ros')}
    assert not before, 'the launch system is imported already'
    sys.meta_path.insert(0, finder)
    yield finder
    sys.meta_path.remove(finder)
    for name in [name for name in sys.modules if name.split('.')[0] in ('launch', 'launch_ros')]:
        del sys.modules[name]


def described(finder: Finder, file: Path) -> list[Noted]:
    """All that the file's description is made of, functions that run at launch not included."""
    spec = importlib.util.spec_from_file_location(re.sub(r'\W', '_', file.name), file)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    finder.module = module
    description = module.generate_launch_description()
    assert description.kind == 'LaunchDescription'
    return finder.made


def test_there_is_a_launch_file() -> None:
    assert FILES and [file.name for file in WITH_PARAMETERS] == ['cell.launch.py']


@pytest.mark.parametrize('file', FILES, ids=lambda file: file.name)
def test_what_it_starts_is_installed(launch_system: Finder, file: Path) -> None:
    executables = {point.name for point in metadata.distribution('stepdiag_ros').entry_points}
    processes = [noted for noted in described(launch_system, file) if noted.kind in PROCESSES]
    assert processes, f'{file.name} starts nothing'
    for process in processes:
        assert process.named['package'] == 'stepdiag_ros'
        assert process.named['executable'] in executables
        assert 'namespace' in process.named, 'a machine has a namespace'
        if process.kind == 'LifecycleNode':
            assert 'name' in process.named, 'LifecycleNode cannot do without'


@dataclass
class Given:
    """A launch context: what `params` was set to."""

    params: str


@pytest.mark.parametrize('file', WITH_PARAMETERS, ids=lambda file: file.name)
def test_a_parameter_file_that_is_missing_is_an_error(launch_system: Finder, file: Path, tmp_path: Path,
                                                      monkeypatch: pytest.MonkeyPatch) -> None:
    """`ros2 launch` itself says nothing and starts nodes with their defaults."""
    checks = [noted.named['function'] for noted in described(launch_system, file) if noted.kind == 'OpaqueFunction']
    assert len(checks) == 1

    class Configuration:
        def __init__(self, name: str):
            assert name == 'params'

        def perform(self, context: Given) -> str:
            return context.params
    monkeypatch.setattr(launch_system.module, 'LaunchConfiguration', Configuration)
    with pytest.raises(RuntimeError, match=r'none\.yaml: there is no such parameter file'):
        checks[0](Given(str(tmp_path / 'none.yaml')))
    other = tmp_path / 'other.yaml'
    other.write_text('/demo/recorder:\n  ros__parameters: {bag: x}\n', encoding='utf-8')
    with pytest.raises(RuntimeError, match='names none of the nodes'):
        checks[0](Given(str(other)))
    from stepdiag_ros.nodes.graph import write_graph
    from stepdiag_ros.virtual.cell import load_cell
    endpoints = {name: {'host': '127.0.0.1', 'port': 1, 'stream_port': 2} for name in ('interferometer', 'psd', 'cnc')}
    graph = write_graph(load_cell(ROOT / 'cells' / 'demo.yaml'), endpoints, tmp_path)
    assert checks[0](Given(str(graph.parameters_file))) == []


@pytest.mark.parametrize('file', FILES, ids=lambda file: file.name)
def test_what_it_imports_is_declared(file: Path) -> None:
    manifest = (ROOT / 'package.xml').read_text()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.ImportFrom | ast.Import):
            names = [node.module] if isinstance(node, ast.ImportFrom) else [alias.name for alias in node.names]
            for name in names:
                top = name.split('.')[0]
                assert top in sys.stdlib_module_names or f'>{top}<' in manifest or top == 'stepdiag_ros', top
