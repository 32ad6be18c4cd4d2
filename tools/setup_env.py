"""Makes the environment: `python3.11 tools/setup_env.py [--venv DIR] [--tests] [--floor]`.

Five stages, each with a stamp that holds a hash of all that the stage depends on,
so that a second run does nothing and a change redoes only what it touches:

1. `venv`: the virtual environment itself (its Python and its place),
2. `pip`: the pinned packages, ROS 2's wheels among them,
3. `msgs`: `stepdiag_msgs`, built from msg_defs/ and installed into the environment's prefix, and before it
   `tf2_msgs` from requirements/tf2_msgs/, of which there is no wheel,
4. `package`: stepdiag_ros itself, editable,
5. `bytecode`: its modules compiled, as an installer does: where Python may write none (PYTHONDONTWRITEBYTECODE, as in
   many containers) each process would compile them anew, a second for each of the ten of a cell.

With `--floor` the oldest libraries that work (requirements/floor.txt) then replace the pinned ones.

Needs nothing but the standard library.  Runs of it exclude each other by a lock.
"""

import argparse
import fcntl
import hashlib
import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
REQUIREMENTS = ROOT / 'requirements'
TOOLS = ('g++',)
# Message packages that are built here, in this order.
MESSAGES = {'tf2_msgs': REQUIREMENTS / 'tf2_msgs', 'stepdiag_msgs': ROOT / 'msg_defs'}

# Where the wheels' exported targets say that Python's and NumPy's headers are: the
# machine that built the wheels had them there.
FOREIGN_PYTHON = re.compile(r'/opt/python/cp\d+-cp\d+/include/python3\.\d+')
FOREIGN_NUMPY = re.compile(r'/opt/python/cp\d+-cp\d+/lib/python3\.\d+/site-packages/numpy/_core/include')

# Paths of a sourced ROS installation, or of another environment whose Python started
# this one, would be searched before the wheels.  The last is the mark by which the
# wheels know that LD_LIBRARY_PATH is already theirs.
FOREIGN_PATHS = (
    'PYTHONPATH',
    'PYTHONHOME',
    'CMAKE_PREFIX_PATH',
    'COLCON_PREFIX_PATH',
    'LD_LIBRARY_PATH',
    '_ROS_WHEELS_BOOTSTRAP_COMPLETE',
)

# One line that Python runs at each start: the ament index finds packages of the
# environment without anything being sourced.
AMENT_PREFIX = (
    "import os, sys; name = 'AMENT_PREFIX_PATH'; paths = os.environ.get(name, '').split(os.pathsep); "
    'sys.prefix in paths or os.environ.__setitem__(name, os.pathsep.join(filter(None, [sys.prefix, *paths])))\n'
)


def fail(line: str) -> 'None':
    """Ends the program with one line on standard error."""
    raise SystemExit(f'setup: {line}')


def digest(files: Iterable[Path], *words: str) -> str:
    """Hash of the contents of files and of some words."""
    total = hashlib.sha256('\n'.join(words).encode())
    for file in files:
        total.update(str(file.relative_to(ROOT)).encode() + b'\0' + file.read_bytes() + b'\0')
    return total.hexdigest()


def run(command: list[str], what: str, environment: dict[str, str] | None = None) -> None:
    """Runs a command with its output kept in a file, shown only when it fails."""
    with tempfile.NamedTemporaryFile('w+', prefix='stepdiag-setup-', suffix='.log', delete=False) as log:
        result = subprocess.run(command, stdout=log, stderr=subprocess.STDOUT, env=environment, cwd=ROOT)
        if result.returncode:
            log.seek(0)
            sys.stderr.writelines(log.readlines()[-40:])
            fail(f'{what} failed (exit {result.returncode}); the whole output is in {log.name}')
    os.unlink(log.name)


def check_machine() -> None:
    """Refuses a machine that cannot work, naming what is missing."""
    if platform.system() != 'Linux' or platform.machine() != 'x86_64':
        fail(f'the ROS 2 wheels are for Linux on x86-64, this is {platform.system()} on {platform.machine()}')
    for tool in TOOLS:
        if shutil.which(tool) is None:
            fail(f'{tool} is missing; install it (Debian, Ubuntu: apt-get install {tool})')


class Environment:
    """The virtual environment at `place`."""

    def __init__(self, place: Path, hashes: bool = False) -> None:
        self.place = place
        self.hashes = hashes
        self.python = place / 'bin' / 'python'
        self.stamps = place / '.stamps'

    def stage(self, name: str, key: str, what: str, action: Callable[[], None]) -> bool:
        """Does `action` unless the stage's stamp already holds `key`; True when it did."""
        stamp = self.stamps / name
        if stamp.exists() and stamp.read_text() == key:
            return False
        stamp.unlink(missing_ok=True)
        print(f'setup: {what} ...', flush=True)
        action()
        self.stamps.mkdir(exist_ok=True)
        stamp.write_text(key)
        return True

    def create(self) -> None:
        """An empty environment, whatever stood at its place before."""
        if self.place.exists():
            if any(self.place.iterdir()) and not (self.place / 'pyvenv.cfg').exists():
                fail(f'{self.place} exists and is no virtual environment; move it away')
            shutil.rmtree(self.place)
        run([sys.executable, '-m', 'venv', str(self.place)], 'making the virtual environment')

    def install(self, names: Iterable[str]) -> None:
        """The pinned packages of some requirement files; with hashes all of them, and nothing that has another."""
        command = [str(self.python), '-m', 'pip', 'install', '--disable-pip-version-check', '--no-input']
        if self.hashes:
            command += ['--require-hashes', '--no-deps', '-r', str(REQUIREMENTS / 'locked.txt')]
            run(command, 'installing the locked packages')
            return
        command += ['-c', str(REQUIREMENTS / 'constraints.txt')]
        for name in names:
            command += ['-r', str(REQUIREMENTS / f'{name}.txt')]
        run(command, 'installing the pinned packages')

    def install_floor(self) -> None:
        """The oldest versions that work, over the pinned ones."""
        command = [str(self.python), '-m', 'pip', 'install', '--disable-pip-version-check', '--no-input']
        run([*command, '-r', str(REQUIREMENTS / 'floor.txt')], 'installing the oldest versions')

    def build_messages(self) -> None:
        """The message packages, into the environment's own prefix, so that they need no further paths."""
        self.point_targets_home()
        for name, sources in MESSAGES.items():
            self.build_package(name, sources)

    def build_package(self, name: str, sources: Path) -> None:
        """One message package, by CMake."""
        prefix = str(self.place)
        environment = {
            **os.environ,
            'PATH': f'{self.place / "bin"}{os.pathsep}{os.environ["PATH"]}',
            'AMENT_PREFIX_PATH': prefix,
            'VIRTUAL_ENV': prefix,
        }
        cmake = str(self.place / 'bin' / 'cmake')
        with tempfile.TemporaryDirectory(prefix='stepdiag-msgs-') as build:
            configure = [cmake, '-G', 'Ninja', '-S', str(sources), '-B', build]
            configure += [f'-DCMAKE_INSTALL_PREFIX={prefix}', f'-DCMAKE_PREFIX_PATH={prefix}']
            configure += ['-DCMAKE_INSTALL_LIBDIR=lib', '-DBUILD_TESTING=OFF', '-Wno-dev']
            configure += [f'-DPython3_EXECUTABLE={self.python}', '-DPython3_FIND_VIRTUALENV=ONLY']
            run(configure, f'configuring {name}', environment)
            run([cmake, '--build', build], f'compiling {name}', environment)
            run([cmake, '--install', build], f'installing {name}', environment)

    def point_targets_home(self) -> None:
        """Replaces include folders of the wheels' build machine by this environment's own."""
        script = 'import sysconfig, numpy; print(sysconfig.get_paths()["include"]); print(numpy.get_include())'
        answer = subprocess.run([str(self.python), '-c', script], capture_output=True, text=True, check=True)
        python_include, numpy_include = answer.stdout.split('\n')[:2]
        for file in self.place.glob('share/*/cmake/*Export.cmake'):
            text = file.read_text()
            home = FOREIGN_PYTHON.sub(lambda _: python_include, FOREIGN_NUMPY.sub(lambda _: numpy_include, text))
            if home != text:
                file.write_text(home)

    def install_package(self) -> None:
        """stepdiag_ros, editable: code, launch files and cells are those of the working tree."""
        command = [str(self.python), '-m', 'pip', 'install', '--disable-pip-version-check', '--no-input']
        command += ['--no-build-isolation', '--no-deps', '--editable', str(ROOT)]
        run(command, 'installing stepdiag_ros')
        # An editable installation leaves the data files out; links serve them as they are now.
        share = self.place / 'share'
        for target, source in (
            ('ament_index/resource_index/packages/stepdiag_ros', 'resource/stepdiag_ros'),
            ('stepdiag_ros/package.xml', 'package.xml'),
            ('stepdiag_ros/launch', 'launch'),
            ('stepdiag_ros/cells', 'cells'),
            ('stepdiag_ros/layouts', 'layouts'),
        ):
            link = share / target
            link.parent.mkdir(parents=True, exist_ok=True)
            link.unlink(missing_ok=True)
            link.symlink_to(ROOT / source)
        site = next(self.place.glob('lib/python3.*/site-packages'))
        (site / 'stepdiag_ament_prefix.pth').write_text(AMENT_PREFIX)

    def compile_package(self) -> None:
        """Bytecode beside the modules, valid for these contents, whenever they were written; a tree that cannot be
        written works without."""
        command = [str(self.python), '-m', 'compileall', '-q', '-j', '0', '--invalidation-mode', 'checked-hash']
        subprocess.run([*command, str(ROOT / 'stepdiag_ros')], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                       check=False)

    def make(self, tests: bool, floor: bool = False) -> bool:
        """All stages in order; True when anything had to be done."""
        version = f'{sys.implementation.cache_tag} {platform.python_version()}'
        venv_key = digest([], version, str(self.place), sys.base_prefix)
        done = self.stage('venv', venv_key, f'Python {platform.python_version()} in {self.place}', self.create)

        files = {name: REQUIREMENTS / f'{name}.txt' for name in ('build', 'run', 'test', 'constraints')}
        run_key = digest([files['build'], files['run'], files['constraints']], venv_key, str(self.hashes))
        done |= self.stage(
            'pip', run_key, 'installing the pinned packages', lambda: self.install(('build', 'run'))
        )
        if tests:
            done |= self.stage(
                'pip-test',
                digest([files['test']], run_key),
                'installing what the tests need',
                lambda: self.install(('build', 'run', 'test')),
            )

        ros_wheels = [line for line in files['run'].read_text().splitlines() if line.startswith('ros-')]
        sources = sorted(path for place in MESSAGES.values() for path in place.rglob('*') if path.is_file())
        msgs_key = digest([files['build'], *sources], venv_key, *ros_wheels)
        done |= self.stage('msgs', msgs_key, 'building the messages', self.build_messages)

        package = [ROOT / 'package.xml', ROOT / 'setup.py', ROOT / 'setup.cfg', Path(__file__).resolve()]
        package_key = digest(package, msgs_key, str(ROOT))
        done |= self.stage('package', package_key, 'installing stepdiag_ros', self.install_package)
        modules = sorted((ROOT / 'stepdiag_ros').rglob('*.py'))
        done |= self.stage('bytecode', digest(modules, venv_key), 'compiling stepdiag_ros', self.compile_package)
        if floor:
            # After the messages: modules built for the newer NumPy serve the older one, not the other way round.
            floor_key = digest([REQUIREMENTS / 'floor.txt', files['test']], run_key)
            done |= self.stage('floor', floor_key, 'putting the oldest libraries that work in', self.install_floor)
        return done


def main() -> int:
    parser = argparse.ArgumentParser(description='Make the environment of stepdiag_ros.')
    parser.add_argument('--venv', type=Path, default=ROOT / '.venv', help='where (default: .venv)')
    parser.add_argument('--tests', action='store_true', help='with what the tests need')
    parser.add_argument('--hashes', action='store_true', help='only files with the hashes of requirements/locked.txt')
    parser.add_argument('--floor', action='store_true', help='with the oldest versions that work')
    arguments = parser.parse_args()

    check_machine()
    for name in FOREIGN_PATHS:
        os.environ.pop(name, None)
    place = arguments.venv.absolute()
    place.parent.mkdir(parents=True, exist_ok=True)
    with open(place.with_name(place.name + '.lock'), 'w') as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if Environment(place, arguments.hashes).make(arguments.tests, arguments.floor):
            print(f'setup: done; {place / "bin" / "stepdiag"} is ready')
    return 0


if __name__ == '__main__':
    sys.exit(main())
