"""The safety net of the tests themselves: it must catch what it is there for."""

import os
import re
import subprocess
import sys
from pathlib import Path

from turns import GIVES_WAY, is_live

ROOT = Path(__file__).resolve().parents[2]


def run_tests(folder: Path, source: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Runs a test module, or what ``arguments`` say, with the repository's conftest and options in a process of its
    own."""
    for file in (ROOT / 'test').glob('*.py'):
        (folder / file.name).write_text(file.read_text().replace('LEFT_S = 10.0', 'LEFT_S = 2.0'))
    (folder / 'test_it.py').write_text(source)
    (folder / 'pyproject.toml').write_text((ROOT / 'pyproject.toml').read_text())
    return subprocess.run(
        [sys.executable, '-m', 'pytest', '-q', '-p', 'no:cacheprovider',
         *(arguments or [str(folder / 'test_it.py')])],
        cwd=folder,
        capture_output=True,
        text=True,
        env={**os.environ, 'STEPDIAG_SHARED': str(folder / 'nowhere')},
    )


def test_a_process_left_behind_fails_and_is_ended(tmp_path: Path) -> None:
    seconds = str(10_000_000 + os.getpid())  # nobody else sleeps so long
    result = run_tests(
        tmp_path,
        'import subprocess\n'
        'def test_leaves_a_grandchild():\n'
        f'    subprocess.run(["sh", "-c", "sleep {seconds} >/dev/null 2>&1 &"], check=True)\n',
    )
    assert result.returncode == 1
    assert 'processes left behind' in result.stdout and f'sleep {seconds}' in result.stdout
    for entry in Path('/proc').glob('[0-9]*/cmdline'):
        try:
            assert entry.read_bytes() != f'sleep\0{seconds}\0'.encode()
        except OSError:
            continue


def test_a_participant_left_behind_fails(tmp_path: Path) -> None:
    result = run_tests(
        tmp_path,
        'import rclpy\n'
        'kept = []\n'
        'def test_leaves_a_node(ros_domain):\n'
        '    rclpy.init()\n'
        '    kept.append(rclpy.create_node("left"))\n',
    )
    assert result.returncode == 1 and '1 participants of DDS are left' in result.stdout


def test_a_warning_fails(tmp_path: Path) -> None:
    result = run_tests(tmp_path, 'import warnings\ndef test_warns():\n    warnings.warn("old")\n')
    assert result.returncode == 1 and 'UserWarning: old' in result.stdout


def test_missing_shared_data_skips_with_a_reason(tmp_path: Path) -> None:
    result = run_tests(tmp_path, 'def test_needs_data(shared):\n    raise AssertionError\n')
    assert result.returncode == 0
    assert f'shared data missing: no folder {tmp_path / "nowhere"}' in result.stdout


def test_ros_domains_are_not_shared(tmp_path: Path) -> None:
    """A domain in use here is not handed out to a test elsewhere."""
    script = (
        'import os, subprocess, sys\n'
        'def test_outer(ros_domain):\n'
        '    assert os.environ["ROS_DOMAIN_ID"] == str(ros_domain)\n'
        '    if "STEPDIAG_OUTER" in os.environ:\n'
        '        assert os.environ["STEPDIAG_OUTER"] != str(ros_domain)\n'
        '        return\n'
        '    os.environ["STEPDIAG_OUTER"] = str(ros_domain)\n'
        '    subprocess.run([sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", __file__], check=True)\n'
    )
    result = run_tests(tmp_path, script)
    assert result.returncode == 0, result.stdout


STOOD_STILL = """
import os, pathlib, subprocess, sys, time
import pytest

@pytest.fixture(scope='module')
def made():
    return []

def stand_still():
    subprocess.Popen(['sh', '-c', f'sleep 3; kill -CONT {os.getpid()}'])
    os.kill(os.getpid(), 19)
    time.sleep(0.01)

def test_that_stood_still(made):
    made.append(1)
    mark = pathlib.Path('stood')
    if not mark.exists():
        mark.touch()
        stand_still()
        assert False
    assert made == [1]       # the module's fixtures were made anew

def test_that_is_busy():
    until_s = time.process_time() + 2.0
    while time.process_time() < until_s:
        pass
    with open('busy', 'a') as file:
        file.write('.')
    assert False

def test_that_is_wrong():
    with open('wrong', 'a') as file:
        file.write('.')
    assert False
"""


def test_only_a_standstill_is_a_reason_to_run_a_test_again(tmp_path: Path) -> None:
    result = run_tests(tmp_path, STOOD_STILL)
    assert result.returncode == 1 and '2 failed, 1 passed' in result.stdout, result.stdout + result.stderr
    assert 'RUN AGAIN test_it.py::test_that_stood_still: the computer stood still for' in result.stdout
    assert result.stdout.count('RUN AGAIN') == 1 and (tmp_path / 'wrong').read_text() == '.'
    assert (tmp_path / 'busy').read_text() == '.'


NOTES = """
import os, pathlib, time

def test_notes():
    worker, niceness = os.environ['PYTEST_XDIST_WORKER'], os.nice(0)
    pathlib.Path(f'{pathlib.Path(__file__).stem}.noted').write_text(f'{worker} {niceness}')
    time.sleep(0.5)
"""


def test_what_runs_live_takes_turns_and_what_computes_gives_way(tmp_path: Path) -> None:
    for name in ('node/test_first', 'fault/test_second', 'node/test_third', 'unit/test_fourth', 'unit/test_fifth'):
        file = tmp_path / 'test' / f'{name}.py'
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(NOTES)
    result = run_tests(tmp_path, '', 'test', '-n', '2')
    assert '5 passed' in result.stdout, result.stdout + result.stderr
    noted = {path.stem: path.read_text().split() for path in tmp_path.glob('*.noted')}
    live = [noted[f'test_{name}'] for name in ('first', 'second', 'third')]
    computing = [noted[f'test_{name}'] for name in ('fourth', 'fifth')]
    assert len({worker for worker, _ in live}) == 1
    assert {int(niceness) for _, niceness in live} == {os.nice(0)}
    assert {int(niceness) for _, niceness in computing} == {max(GIVES_WAY, os.nice(0))}


def test_whoever_has_a_ros_domain_is_among_those_that_run_live() -> None:
    """They all are, but for what tries the fixture itself."""
    with_domain = {file.relative_to(ROOT).as_posix() for file in (ROOT / 'test').rglob('test_*.py')
                   if {'ros_domain', 'module_domain'} & set(re.findall(r'\w+', file.read_text(encoding='utf-8')))}
    with_domain.remove(Path(__file__).relative_to(ROOT).as_posix())
    assert with_domain
    assert [name for name in sorted(with_domain) if not is_live(name)] == []
