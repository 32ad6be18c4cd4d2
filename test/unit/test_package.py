"""The package's own papers agree with each other and with the code."""

import ast
import os
from importlib import metadata
from pathlib import Path
from xml.etree import ElementTree

import pytest

ROOT = Path(__file__).resolve().parents[2]
MANIFESTS = {'stepdiag_ros': ROOT / 'package.xml', 'stepdiag_msgs': ROOT / 'msg_defs' / 'package.xml'}
NODES = {
    'interferometer_driver',
    'psd_driver',
    'step_sequencer',
    'evaluation_solver',
    'multiplexer',
    'recorder',
    'gap_monitor',
    'bringup',
}


def scripts() -> dict[str, str]:
    """The installed console scripts: name -> `module:function`."""
    entry_points = metadata.distribution('stepdiag_ros').entry_points
    return {point.name: point.value for point in entry_points if point.group == 'console_scripts'}


@pytest.mark.parametrize('name', MANIFESTS)
def test_manifest_is_complete(name: str) -> None:
    root = ElementTree.parse(MANIFESTS[name]).getroot()
    assert root.tag == 'package' and root.get('format') == '3'
    assert root.findtext('name') == name
    assert root.findtext('license') == 'Apache-2.0'
    assert root.findtext('description')
    assert root.find('maintainer').get('email')
    kind = {'stepdiag_ros': 'ament_python', 'stepdiag_msgs': 'ament_cmake'}[name]
    assert root.findtext('export/build_type') == kind


def test_versions_agree() -> None:
    versions = {name: ElementTree.parse(path).getroot().findtext('version') for name, path in MANIFESTS.items()}
    versions['installed'] = metadata.version('stepdiag_ros')
    assert len(set(versions.values())) == 1, versions
    assert 'version=manifest.findtext' in (ROOT / 'setup.py').read_text(), 'setup.py must read package.xml'


def test_messages_are_those_of_the_manifest() -> None:
    cmake = (ROOT / 'msg_defs' / 'CMakeLists.txt').read_text()
    for file in (ROOT / 'msg_defs').glob('*/*.*'):
        assert f'"{file.parent.name}/{file.name}"' in cmake, f'{file.name} is not built'


def test_every_node_has_an_executable() -> None:
    assert set(scripts()) == NODES | {'stepdiag'}


@pytest.mark.parametrize('name', sorted(NODES | {'stepdiag'}))
def test_entry_point_names_a_function_that_exists(name: str) -> None:
    module, function = scripts()[name].split(':')
    file = ROOT.joinpath(*module.split('.')).with_suffix('.py')
    assert file.is_file(), f'{name} starts {module}, which does not exist'
    # Read, not imported: the check must not depend on what importing a node does.
    tree = ast.parse(file.read_text())
    functions = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
    assert function in functions


def test_every_import_of_ros_is_declared() -> None:
    declared = {node.text for node in ElementTree.parse(MANIFESTS['stepdiag_ros']).getroot() if 'depend' in node.tag}
    shares = {path.name for prefix in ament_prefixes() for path in (prefix / 'share').iterdir()}
    for file in (ROOT / 'stepdiag_ros').rglob('*.py'):
        for module in imported(file):
            if module in shares and module != 'stepdiag_ros':
                assert module in declared, f'{file.relative_to(ROOT)} imports {module}; package.xml does not name it'


def pinned(file: str) -> dict[str, str]:
    """Name -> version of what a requirements file pins."""
    lines = (line.split('#')[0].strip() for line in (ROOT / 'requirements' / file).read_text().splitlines())
    return dict(line.split('==') for line in lines if line)


def stated() -> dict[str, tuple[str, str]]:
    """Name -> (floor, ceiling) of what setup.py asks for."""
    tree = ast.parse((ROOT / 'setup.py').read_text())
    given = {node.targets[0].id: ast.literal_eval(node.value) for node in tree.body
             if isinstance(node, ast.Assign) and node.targets[0].id in ('REQUIRES', 'EXTRAS')}
    lines = [*given['REQUIRES'], *(line for extra in given['EXTRAS'].values() for line in extra)]
    parts = (line.replace('>=', ' ').replace(',<', ' ').split() for line in lines)
    return {name: (floor, ceiling) for name, floor, ceiling in parts}


def numbers(version: str) -> list[int]:
    return [int(part) for part in version.split('.')]


def test_floors_and_ceilings_are_those_that_are_tested() -> None:
    oldest, newest = pinned('floor.txt'), pinned('run.txt')
    for name, (floor, ceiling) in stated().items():
        assert oldest[name] == floor, f'{name}: `make test-floor` tests {oldest[name]}, setup.py says {floor}'
        assert numbers(floor) <= numbers(newest[name]) < numbers(ceiling), name
    for depend in ElementTree.parse(MANIFESTS['stepdiag_ros']).getroot().iter('exec_depend'):
        if depend.text.startswith('python3-'):
            name = {'yaml': 'PyYAML'}.get(depend.text[8:], depend.text[8:])
            assert (depend.get('version_gte'), depend.get('version_lt')) == stated()[name], depend.text


def ament_prefixes() -> list[Path]:
    """Where ROS packages are installed: prefixes whose share/ has the ament index."""
    return [Path(prefix) for prefix in os.environ['AMENT_PREFIX_PATH'].split(os.pathsep) if prefix]


def imported(file: Path) -> set[str]:
    """Top-level names of the modules that a source file imports."""
    names = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name.split('.')[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names.add(node.module.split('.')[0])
    return names


def test_messages_have_the_fields_of_the_contract() -> None:
    """Field names, types and order as the wire contract fixes them."""
    from stepdiag_msgs.msg import Displacement, SpotPosition, Step

    assert list(Displacement.get_fields_and_field_types().items()) == [
        ('header', 'std_msgs/Header'),
        ('sample_period', 'double'),
        ('beams', 'uint8'),
        ('displacement', 'sequence<double>'),
        ('refractive_index', 'double'),
        ('quality', 'sequence<uint8>'),
    ]
    assert list(SpotPosition.get_fields_and_field_types().items()) == [
        ('header', 'std_msgs/Header'),
        ('sample_period', 'double'),
        ('x', 'sequence<double>'),
        ('y', 'sequence<double>'),
        ('intensity', 'sequence<double>'),
    ]
    assert list(Step.get_fields_and_field_types().items()) == [
        ('header', 'std_msgs/Header'),
        ('run_id', 'string'),
        ('setup', 'string'),
        ('repeat', 'uint16'),
        ('direction', 'int8'),
        ('index', 'uint16'),
        ('axis', 'uint8'),
        ('commanded', 'geometry_msgs/Point'),
        ('phase', 'uint8'),
    ]
    assert (Step.MOVE, Step.DWELL, Step.DONE, Step.NONE) == (0, 1, 2, 255)
