"""Where ROS 2 is installed people build with colcon; the same sources must build so here.

The ROS wheels of the environment stand in for the installation, and the install tree is
used as a user would: its setup file sourced, its executables started.
"""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from xml.etree import ElementTree

import pytest
import rclpy

from stepdiag_ros.nodes.patience import Patience
from test.some import some

ROOT = Path(__file__).resolve().parents[2]
BIN = Path(sys.executable).parent
EXECUTABLES = {
    'stepdiag',
    'interferometer_driver',
    'psd_driver',
    'step_sequencer',
    'evaluation_solver',
    'recorder',
    'multiplexer',
    'gap_monitor',
    'bringup',
}


def clean_environment() -> dict[str, str]:
    """This process's environment with the wheels as the only ROS installation."""
    environment = dict(os.environ)
    for name in ('LD_LIBRARY_PATH', '_ROS_WHEELS_BOOTSTRAP_COMPLETE', 'PYTHONPATH', 'CMAKE_PREFIX_PATH'):
        environment.pop(name, None)
    environment['PATH'] = f'{BIN}{os.pathsep}{environment["PATH"]}'
    environment['AMENT_PREFIX_PATH'] = sys.prefix
    return environment


def laid_out(workspace: Path, *options: str) -> Path:
    """The folder `src` of a workspace that `make ros-workspace` has laid both packages into."""
    made = subprocess.run([sys.executable, str(ROOT / 'tools' / 'ros_workspace.py'), *options, str(workspace)],
                          capture_output=True, text=True)
    assert made.returncode == 0, made.stderr
    return workspace / 'src'


@pytest.fixture(scope='module', params=some('a workspace', later=['two base paths']))
def install(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The install tree of `colcon build --base-paths . msg_defs`, and that of `colcon build` in a workspace."""
    place = tmp_path_factory.mktemp('colcon')
    paths = ['.', 'msg_defs'] if request.param == 'two base paths' else [str(laid_out(place / 'ws'))]
    command = [str(BIN / 'colcon'), '--log-base', str(place / 'log'), 'build', '--base-paths', *paths]
    command += ['--build-base', str(place / 'build'), '--install-base', str(place / 'install')]
    command += ['--cmake-args', '-GNinja', '-DBUILD_TESTING=OFF', f'-DPython3_EXECUTABLE={sys.executable}']
    result = subprocess.run(
        command, cwd=ROOT, env=clean_environment(), capture_output=True, text=True, stdin=subprocess.DEVNULL
    )
    assert result.returncode == 0, result.stdout[-4000:] + result.stderr[-4000:]
    return place / 'install'


def sourced(install: Path, command: str) -> subprocess.CompletedProcess[str]:
    """Runs a shell command with the install tree's setup file sourced."""
    return subprocess.run(
        ['sh', '-c', f'. "{install}/setup.sh" && {command}'],
        cwd=install,
        env=clean_environment(),
        capture_output=True,
        text=True,
        stdin=subprocess.DEVNULL,
        timeout=120,
    )


@pytest.mark.parametrize('options', [(), ('--copy',)], ids=['links', 'copies'])
def test_ros_s_crawlers_find_both_packages_in_a_workspace(tmp_path: Path, options: tuple[str, ...]) -> None:
    """catkin_pkg's is that of rosdep and bloom; it does not look below a package.xml, and nor does colcon's."""
    from catkin_pkg.packages import find_packages
    assert {package.name for package in find_packages(str(ROOT)).values()} == {'stepdiag_ros'}
    source = laid_out(tmp_path / 'ws', *options)
    assert {package.name for package in find_packages(str(source)).values()} == {'stepdiag_ros', 'stepdiag_msgs'}
    if not options:
        assert laid_out(tmp_path / 'ws') == source   # again does no harm


def test_a_checkout_that_stands_in_the_workspace_is_not_laid_there_twice(tmp_path: Path) -> None:
    from catkin_pkg.packages import find_packages
    source = laid_out(tmp_path / 'ws', '--copy')
    (source / 'stepdiag_msgs').rename(source / 'stepdiag_ros' / 'msg_defs')
    tool = source / 'stepdiag_ros' / 'tools' / 'ros_workspace.py'
    subprocess.run([sys.executable, str(tool), str(tmp_path / 'ws')], check=True, capture_output=True)
    assert (source / 'stepdiag_msgs').is_symlink() and not (source / 'stepdiag_ros').is_symlink()
    assert {package.name for package in find_packages(str(source)).values()} == {'stepdiag_ros', 'stepdiag_msgs'}


def test_what_stands_in_the_way_is_said(tmp_path: Path) -> None:
    (tmp_path / 'src' / 'stepdiag_msgs').mkdir(parents=True)
    made = subprocess.run([sys.executable, str(ROOT / 'tools' / 'ros_workspace.py'), str(tmp_path)],
                          capture_output=True, text=True)
    assert made.returncode != 0 and 'stepdiag_msgs is there already' in made.stderr and 'Traceback' not in made.stderr


@pytest.mark.timeout(900)
def test_both_packages_are_built(install: Path) -> None:
    built = {path.name for path in install.iterdir() if path.is_dir()}
    assert built == {'stepdiag_ros', 'stepdiag_msgs'}


@pytest.mark.timeout(900)
def test_executables_are_where_ros2_run_looks(install: Path) -> None:
    folder = install / 'stepdiag_ros' / 'lib' / 'stepdiag_ros'
    assert {path.name for path in folder.iterdir()} == EXECUTABLES
    assert all(os.access(path, os.X_OK) for path in folder.iterdir())


@pytest.mark.timeout(900)
def test_launch_files_and_cells_are_shared(install: Path) -> None:
    share = install / 'stepdiag_ros' / 'share' / 'stepdiag_ros'
    for folder, pattern in (('launch', '*.launch.py'), ('cells', '*.yaml')):
        ours = {path.name for path in (ROOT / folder).glob(pattern)}
        assert ours, f'{folder}/ has no {pattern}'
        assert {path.name for path in (share / folder).iterdir()} == ours
    assert ElementTree.parse(share / 'package.xml').getroot().findtext('name') == 'stepdiag_ros'
    index = install / 'stepdiag_ros' / 'share' / 'ament_index' / 'resource_index' / 'packages'
    assert (index / 'stepdiag_ros').is_file()


@pytest.mark.timeout(900)
def test_every_data_file_of_the_package_is_installed(install: Path) -> None:
    """Sources that are not Python (pages, tables) must travel with the package."""
    (installed,) = install.glob('stepdiag_ros/lib/python3.*/site-packages/stepdiag_ros')
    for file in (ROOT / 'stepdiag_ros').rglob('*'):
        if file.is_file() and '__pycache__' not in file.parts:
            assert (installed / file.relative_to(ROOT / 'stepdiag_ros')).is_file(), f'{file} is not installed'


@pytest.mark.timeout(900)
def test_the_built_messages_work(install: Path) -> None:
    script = (
        'import stepdiag_msgs, stepdiag_ros, rclpy.serialization as s\n'
        'from stepdiag_msgs.msg import Step\n'
        'from stepdiag_msgs.action import RunStepDiagonal\n'
        'from stepdiag_msgs.srv import SelectSetup\n'
        'message = Step(run_id="ppp/0/+", index=7)\n'
        'assert s.deserialize_message(s.serialize_message(message), Step) == message\n'
        'print(stepdiag_msgs.__file__)\n'
        'print(stepdiag_ros.__file__)\n'
    )
    result = sourced(install, f"'{sys.executable}' -c '{script}'")
    assert result.returncode == 0, result.stderr
    for module in result.stdout.splitlines():
        assert Path(module).is_relative_to(install), 'the editable package was found instead of the built one'


@pytest.mark.timeout(900)
def test_the_built_command_answers(install: Path) -> None:
    result = sourced(install, 'stepdiag_ros/lib/stepdiag_ros/stepdiag --help')
    assert result.returncode == 0, result.stderr
    assert 'evaluate' in result.stdout


@pytest.mark.timeout(900)
@pytest.mark.parametrize('name', sorted(EXECUTABLES - {'stepdiag', 'bringup'}))
def test_every_node_starts_and_stops(install: Path, ros_domain: int, name: str) -> None:
    """Started as `ros2 run stepdiag_ros NAME` does, it is seen in the graph; SIGINT ends it well."""
    executable = install / 'stepdiag_ros' / 'lib' / 'stepdiag_ros' / name
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=ros_domain)
    observer = rclpy.create_node('observer', context=context)
    command = f'. "{install}/setup.sh" && exec "{executable}" --ros-args -r __ns:=/cell7'
    process = subprocess.Popen(
        ['sh', '-c', command],
        cwd=install,
        env=clean_environment() | {'ROS_DOMAIN_ID': str(ros_domain)},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        patience = Patience(60)
        while (name, '/cell7') not in observer.get_node_names_and_namespaces():
            assert process.poll() is None, f'{name} ended by itself:\n{process.stdout.read()}'
            assert not patience.over(), f'{name} is not seen in the graph'
            time.sleep(0.1)
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate(timeout=60)
        assert process.returncode in (0, 130, -signal.SIGINT), output
        assert 'Traceback' not in output, output
    finally:
        process.kill()
        process.communicate()
        observer.destroy_node()
        rclpy.shutdown(context=context)
