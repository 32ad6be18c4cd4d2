"""The wheel, away from the checkout: what it can do without ROS and without its extras, and what it says is missing."""

import os
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
CELL = ROOT / 'cells' / 'demo.yaml'
SITE = Path(sysconfig.get_paths()['purelib'])
#: What the wheel declares to need, and what these bring.
NEEDED = ('numpy', 'numpy.libs', 'scipy', 'scipy.libs', 'yaml', '_yaml', 'mcap', 'zstandard', 'lz4')


@pytest.fixture(scope='module')
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the installed wheel and nothing else but what it needs."""
    folder = tmp_path_factory.mktemp('wheel')
    copy = folder / 'source'
    subprocess.run([sys.executable, str(ROOT / 'tools' / 'ros_workspace.py'), '--copy', str(folder / 'ws')], check=True,
                   capture_output=True)
    (folder / 'ws' / 'src' / 'stepdiag_ros').rename(copy)
    for command in (['wheel', '--no-deps', '--no-build-isolation', '--no-index', '-w', str(folder), str(copy)],
                    ['install', '--no-deps', '--no-index', '--target', str(folder / 'site'), '--find-links',
                     str(folder), 'stepdiag_ros']):
        made = subprocess.run([sys.executable, '-m', 'pip', '--disable-pip-version-check', *command], cwd=folder,
                              capture_output=True, text=True)
        assert made.returncode == 0, made.stderr
    for name in NEEDED:
        if (SITE / name).exists():
            (folder / 'site' / name).symlink_to(SITE / name)
    return folder / 'site'


def run(place: Path, module: str, function: str, *argv: str) -> subprocess.CompletedProcess[str]:
    """Call an entry point of the wheel with an interpreter that sees nothing but ``place``."""
    code = f'import sys; sys.path.insert(0, {str(place)!r}); from {module} import {function}; sys.exit({function}())'
    clean = {k: v for k, v in os.environ.items() if not k.startswith(('PYTHON', 'AMENT', 'LD_', '_ROS'))}
    return subprocess.run([sys._base_executable, '-S', '-c', code, *argv], cwd=place.parent, env=clean,
                          capture_output=True, text=True, timeout=300)


@pytest.fixture(scope='module')
def bag(place: Path) -> Path:
    cells = list(place.rglob('demo.yaml'))
    assert cells, 'the wheel carries no cell files'
    made = run(place, 'stepdiag_ros.cli.main', 'main', 'simulate', str(cells[0]), '--out', str(place.parent / 'demo'),
               '--setups', 'ppp', 'lin_x')
    assert made.returncode == 0, made.stderr
    return place.parent / 'demo'


@pytest.mark.parametrize('argv', [['--help'], ['--version'], ['info', 'BAG'], ['evaluate', 'BAG', '--json']])
def test_what_needs_neither_ros_nor_extras_works(place: Path, bag: Path, argv: list[str]) -> None:
    done = run(place, 'stepdiag_ros.cli.main', 'main', *(str(bag) if word == 'BAG' else word for word in argv))
    assert done.returncode == 0, done.stderr
    assert done.stdout


@pytest.mark.parametrize(('argv', 'said'), [
    (['report', 'BAG', '--out', 'page'], 'report needs the package matplotlib, which is not installed: '
                                         'pip install "stepdiag_ros[pictures]"'),
    (['web'], 'web needs the package uvicorn, which is not installed: pip install "stepdiag_ros[web]"'),
    (['up', 'CELL'], ' needs ROS 2 Jazzy (rclpy is not installed)'),
    (['calibrate'], 'calibrate needs ROS 2 Jazzy')])
def test_what_is_missing_is_one_line(place: Path, bag: Path, argv: list[str], said: str) -> None:
    given = {'BAG': str(bag), 'CELL': str(next(place.rglob('demo.yaml')))}
    done = run(place, 'stepdiag_ros.cli.main', 'main', *(given.get(word, word) for word in argv))
    assert done.returncode == 2 and said in done.stderr and len(done.stderr.splitlines()) == 1, done.stderr


@pytest.mark.parametrize('node', ['recorder', 'step_sequencer', 'interferometer_driver', 'psd_driver', 'gap_monitor',
                                  'evaluation_solver', 'bringup'])
def test_a_node_without_ros_says_so(place: Path, node: str) -> None:
    done = run(place, 'stepdiag_ros.start', node)
    assert done.returncode == 2 and done.stderr.startswith(f'stepdiag: {node} needs ')
    assert 'Traceback' not in done.stderr


@pytest.mark.parametrize('node', ['recorder', 'psd_driver', 'bringup'])
def test_a_node_without_the_messages_names_the_command_that_lays_the_workspace(node: str) -> None:
    """As after `colcon build` in a workspace that holds the outer package alone."""
    code = f"import sys; sys.modules['stepdiag_msgs'] = None; from stepdiag_ros.start import {node}; sys.exit({node}())"
    done = subprocess.run([sys.executable, '-c', code, *([str(CELL)] if node == 'bringup' else [])],
                          capture_output=True, text=True, timeout=120)
    assert done.returncode == 2 and 'make ros-workspace WS=' in done.stderr, done.stderr
    assert 'Traceback' not in done.stderr


def test_the_package_is_typed(place: Path) -> None:
    assert (place / 'stepdiag_ros' / 'py.typed').is_file()
