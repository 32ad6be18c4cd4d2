"""Setting up: what is redone and what is not, and the one-line errors."""

import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy
import pytest

ROOT = Path(__file__).resolve().parents[2]
FIND_PYTHON = ROOT / 'tools' / 'find_python.sh'
STAGES = ['create', 'install build run', 'install build run test', 'build_messages', 'install_package',
          'compile_package']
BUILT = ['build_messages', 'install_package']


@pytest.fixture
def setup_env(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """tools/setup_env.py on a copy of the files that it reads, its actions only noted in `module.done`."""
    copy = tmp_path / 'repository'
    for name in ('requirements', 'msg_defs', 'tools'):
        shutil.copytree(ROOT / name, copy / name, ignore=shutil.ignore_patterns('__pycache__'))
    for name in ('package.xml', 'setup.py', 'setup.cfg'):
        shutil.copy(ROOT / name, copy / name)
    spec = importlib.util.spec_from_file_location('setup_env', copy / 'tools' / 'setup_env.py')
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    module.done = []

    def create(environment) -> None:
        environment.place.mkdir(parents=True, exist_ok=True)
        module.done.append('create')

    monkeypatch.setattr(module.Environment, 'create', create)
    monkeypatch.setattr(
        module.Environment, 'install', lambda _, names: module.done.append(f'install {" ".join(names)}')
    )
    for name in ('build_messages', 'install_package', 'compile_package', 'install_floor'):
        monkeypatch.setattr(module.Environment, name, lambda _, name=name: module.done.append(name))
    return module


def redone(module: ModuleType, tests: bool = True) -> list[str]:
    """The stages that another run does."""
    module.done.clear()
    module.Environment(module.ROOT / '.venv').make(tests)
    return list(module.done)


def test_first_run_does_all_and_second_nothing(setup_env: ModuleType) -> None:
    assert redone(setup_env) == STAGES
    assert redone(setup_env) == []


def test_tests_are_added_to_an_environment_without(setup_env: ModuleType) -> None:
    assert redone(setup_env, tests=False) == [stage for stage in STAGES if 'test' not in stage]
    assert redone(setup_env) == ['install build run test']


def test_the_oldest_libraries_come_last_and_after_each_change(setup_env: ModuleType) -> None:
    def redone_with_floor() -> list[str]:
        setup_env.done.clear()
        setup_env.Environment(setup_env.ROOT / 'build' / 'floor').make(True, floor=True)
        return list(setup_env.done)

    assert redone_with_floor() == [*STAGES, 'install_floor']
    assert redone_with_floor() == []
    for file, first in (('test', 'install build run test'), ('run', 'install build run')):
        with open(setup_env.REQUIREMENTS / f'{file}.txt', 'a') as changed:
            changed.write('# changed\n')
        done = redone_with_floor()
        assert done[0] == first and done[-1] == 'install_floor'


@pytest.mark.parametrize(
    ('file', 'expected'),
    [
        ('requirements/test.txt', ['install build run test']),
        ('requirements/run.txt', ['install build run', 'install build run test']),
        ('msg_defs/msg/Step.msg', BUILT),
        ('requirements/tf2_msgs/msg/TFMessage.msg', BUILT),
        ('setup.py', ['install_package']),
    ],
)
def test_a_change_redoes_only_what_it_touches(setup_env: ModuleType, file: str, expected: list[str]) -> None:
    redone(setup_env)
    with open(setup_env.ROOT / file, 'a') as changed:
        changed.write('# changed\n')
    assert redone(setup_env) == expected
    assert redone(setup_env) == []


def test_a_module_that_changed_is_compiled_alone(setup_env: ModuleType) -> None:
    redone(setup_env)
    module = setup_env.ROOT / 'stepdiag_ros' / 'new.py'
    module.parent.mkdir(exist_ok=True)
    module.write_text('x = 1\n')
    assert redone(setup_env) == ['compile_package'] and redone(setup_env) == []


def test_another_version_of_ros_rebuilds_the_messages(setup_env: ModuleType) -> None:
    redone(setup_env)
    file = setup_env.REQUIREMENTS / 'run.txt'
    file.write_text(file.read_text().replace('ros-jazzy-rclpy==', 'ros-jazzy-rclpy==99.'))
    assert 'build_messages' in redone(setup_env)


def test_another_python_redoes_everything(setup_env: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    redone(setup_env)
    monkeypatch.setattr(setup_env.platform, 'python_version', lambda: '3.99.0')
    assert redone(setup_env) == STAGES


def test_a_failed_stage_is_repeated(setup_env: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as broken:

        def build_messages(environment) -> None:
            setup_env.fail('no space left')

        broken.setattr(setup_env.Environment, 'build_messages', build_messages)
        with pytest.raises(SystemExit, match='setup: no space left'):
            redone(setup_env)
    assert redone(setup_env) == ['build_messages', 'install_package', 'compile_package']


def test_a_folder_that_is_no_environment_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / 'thesis.tex').write_text('years of work')
    result = subprocess.run(
        [sys.executable, str(ROOT / 'tools' / 'setup_env.py'), '--venv', str(tmp_path)], capture_output=True, text=True
    )
    assert result.returncode != 0
    assert result.stderr.splitlines() == [f'setup: {tmp_path} exists and is no virtual environment; move it away']
    assert (tmp_path / 'thesis.tex').read_text() == 'years of work'


def test_foreign_include_folders_are_replaced(tmp_path: Path) -> None:
    spec = importlib.util.spec_from_file_location('setup_env', ROOT / 'tools' / 'setup_env.py')
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)


    file = tmp_path / 'share' / 'std_msgs' / 'cmake' / 'export_std_msgs__rosidl_generator_pyExport.cmake'
    file.parent.mkdir(parents=True)
    foreign = '/opt/python/cp312-cp312'
    file.write_text(
        f'"{foreign}/include/python3.12;{foreign}/lib/python3.12/site-packages/numpy/_core/include;${{_PREFIX}}/x"'
    )
    environment = module.Environment(tmp_path)
    environment.python = Path(sys.executable)
    environment.point_targets_home()
    python_include, numpy_include, own = file.read_text().strip('"').split(';')
    assert (Path(python_include) / 'Python.h').is_file()
    assert numpy_include == numpy.get_include()
    assert own == '${_PREFIX}/x'


def find_python(path: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """Runs the search with nothing but `path` on PATH."""
    return subprocess.run(
        ['/bin/sh', str(FIND_PYTHON)],
        env={'PATH': str(path), 'HOME': str(path), **environment},
        capture_output=True,
        text=True,
    )


def fake_python(path: Path, name: str, says: str, status: int = 0) -> Path:
    """A program that answers the check like a Python would."""
    file = path / name
    file.write_text(f'#!/bin/sh\necho "{says}"\nexit {status}\n')
    file.chmod(0o755)
    return file


def test_no_python_is_one_line(tmp_path: Path) -> None:
    result = find_python(tmp_path)
    assert result.returncode == 1 and result.stdout == ''
    assert result.stderr.startswith('setup: no usable Python 3.11, 3.12 or 3.13 found')
    assert len(result.stderr.splitlines()) == 1


def test_the_newest_that_works_is_taken(tmp_path: Path) -> None:
    fake_python(tmp_path, 'python3.13', 'a shim of a version that is not there', status=127)
    fake_python(tmp_path, 'python3.12', 'lacks its headers; install them')
    expected = fake_python(tmp_path, 'python3.11', 'ok')
    fake_python(tmp_path, 'python3', 'ok')
    assert find_python(tmp_path).stdout.strip() == str(expected)


def test_what_is_missing_is_said(tmp_path: Path) -> None:
    python = fake_python(tmp_path, 'python3.12', 'lacks its headers; install them')
    result = find_python(tmp_path)
    assert result.returncode == 1
    assert result.stderr.strip().endswith(f'; {python} lacks its headers; install them')


def test_a_named_python_is_used_or_refused(tmp_path: Path) -> None:
    base = os.path.realpath(sys.executable)
    assert find_python(tmp_path, PYTHON=base).stdout.strip() == base
    old = fake_python(tmp_path, 'python2', 'is Python 2.7, not 3.11, 3.12 or 3.13')
    result = find_python(tmp_path, PYTHON=str(old))
    assert result.returncode == 1
    assert result.stderr.strip() == f'setup: {old} is Python 2.7, not 3.11, 3.12 or 3.13'
    result = find_python(tmp_path, PYTHON='nonsense')
    assert result.stderr.strip() == 'setup: PYTHON=nonsense is not a program'


def test_a_missing_compiler_is_one_line(tmp_path: Path) -> None:
    result = subprocess.run(
        [os.path.realpath(sys.executable), str(ROOT / 'tools' / 'setup_env.py'), '--venv', str(tmp_path / 'venv')],
        env={'PATH': str(tmp_path)},
        capture_output=True,
        text=True,
    )
    assert result.returncode == 1
    assert result.stderr.splitlines() == [
        'setup: g++ is missing; install it (Debian, Ubuntu: apt-get install g++)'
    ]
