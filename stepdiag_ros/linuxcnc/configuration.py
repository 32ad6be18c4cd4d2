"""LinuxCNC's configuration folder: a simulated machine's, and what stepdiag adds to anybody's.

What is added lies in the subfolder ``stepdiag`` and in a few lines of the INI file: the compensation
(:func:`compensated`) and the watchdog of the remote client (:func:`watched`).  Paths in the INI file are
relative to its folder, in which LinuxCNC runs.
"""

import re
import shutil
import stat
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.linuxcnc.ini import get, put
from stepdiag_ros.linuxcnc.volume import VOLUME_HAL as HAL_LINES
from stepdiag_ros.model.machine import AXES

FOLDER = 'stepdiag'
VOLUME = f'{FOLDER}/volume.txt'
VOLUME_HAL, WATCH_HAL, FOLLOW_HAL = (f'{FOLDER}/{name}.hal' for name in ('volume', 'watch', 'follow'))
MATRIX_HAL = f'{FOLDER}/matrix.hal'
COMPONENT = 'stepdiagkins'
SILENCE_S = 0.25
"""Silence of its remote client after which a moving machine is stopped."""
BEYOND_MM = 1.0
"""The simulated machine's axes go this far beyond the volume."""

INI = """\
[EMC]
VERSION = 1.1
MACHINE = {name}
[DISPLAY]
DISPLAY = ./display.sh
[TASK]
TASK = milltask
CYCLE_TIME = 0.005
[RS274NGC]
PARAMETER_FILE = parameters
[EMCMOT]
EMCMOT = motmod
COMM_TIMEOUT = 1.0
SERVO_PERIOD = 1000000
[EMCIO]
EMCIO = io
CYCLE_TIME = 0.1
TOOL_TABLE = tools
[HAL]
HALUI = halui
HALFILE = machine.hal
[TRAJ]
COORDINATES = X Y Z
LINEAR_UNITS = mm
ANGULAR_UNITS = degree
DEFAULT_LINEAR_VELOCITY = 100
MAX_LINEAR_VELOCITY = {velocity:.6g}
DEFAULT_LINEAR_ACCELERATION = {acceleration:.6g}
MAX_LINEAR_ACCELERATION = {acceleration:.6g}
[KINS]
KINEMATICS = trivkins coordinates=XYZ
JOINTS = 3
"""
AXIS = """\
[AXIS_{letter}]
MIN_LIMIT = {low:.6f}
MAX_LIMIT = {high:.6f}
MAX_VELOCITY = {velocity:.6g}
MAX_ACCELERATION = {acceleration:.6g}
[JOINT_{number}]
TYPE = LINEAR
HOME = {home:.6f}
HOME_OFFSET = {home:.6f}
HOME_SEARCH_VEL = 0
HOME_LATCH_VEL = 0
HOME_SEQUENCE = 0
MIN_LIMIT = {low:.6f}
MAX_LIMIT = {high:.6f}
MAX_VELOCITY = {velocity:.6g}
MAX_ACCELERATION = {acceleration:.6g}
FERROR = 10
MIN_FERROR = 10
"""
HAL = """\
# A simulated machine: the commanded positions of the drives are the actual ones.
loadrt [KINS]KINEMATICS
loadrt [EMCMOT]EMCMOT servo_period_nsec=[EMCMOT]SERVO_PERIOD num_joints=[KINS]JOINTS
addf motion-command-handler servo-thread
addf motion-controller servo-thread
net joint0 joint.0.motor-pos-cmd => joint.0.motor-pos-fb
net joint1 joint.1.motor-pos-cmd => joint.1.motor-pos-fb
net joint2 joint.2.motor-pos-cmd => joint.2.motor-pos-fb
net estop iocontrol.0.user-enable-out => iocontrol.0.emc-enable-in
net prepare iocontrol.0.tool-prepare => iocontrol.0.tool-prepared
net change iocontrol.0.tool-change => iocontrol.0.tool-changed
"""
FOLLOW = """\
# The virtual sensors look at the simulated machine's drives; M68 E0 Qn mounts setup number n.
loadusr -Wn stepdiagfollow /usr/bin/python3 [STEPDIAG]FOLDER/follow.py --out [STEPDIAG]TRACK
net joint0 => stepdiagfollow.x
net joint1 => stepdiagfollow.y
net joint2 => stepdiagfollow.z
net stepdiag-setup motion.analog-out-00 => stepdiagfollow.setup
"""


def simulated(name: str, travel: Sequence[float], origin: Sequence[float], speed: float, acceleration: float
              ) -> dict[str, str]:
    """Files of a simulated machine: volume [m] and its lower corner [m], m/s, m/s²."""
    limits = {'velocity': 1e3 * speed, 'acceleration': 1e3 * acceleration}
    text = INI.format(name=name, **limits)
    for number, letter in enumerate(AXES):
        low = 1e3 * origin[number]
        text += AXIS.format(letter=letter, number=number, home=low, low=low - BEYOND_MM,
                            high=low + 1e3 * travel[number] + BEYOND_MM, **limits)
    return {'machine.ini': text, 'machine.hal': HAL, 'tools': '',
            'display.sh': '#!/bin/sh\necho $$ > pid\nexec linuxcncrsh --port "${STEPDIAG_PORT:-5007}" -- "$@"\n'}


def source(name: str) -> str:
    """The text of one of this package's own files for LinuxCNC."""
    return resources.files('stepdiag_ros.linuxcnc').joinpath(name).read_text(encoding='utf-8')


def with_halfile(ini: str, file: str, wanted: bool = True) -> str:
    """The INI file's text with a HAL file at the end of its list, or without it."""
    files = [f for f in get(ini, 'HAL', 'HALFILE') if f != file]
    return put(ini, 'HAL', 'HALFILE', files + [file] * wanted)


def watched(ini: str, port: int, host: str = '127.0.0.1', silence_s: float = SILENCE_S) -> dict[str, str]:
    """Files that add the watchdog to a configuration; ``machine.ini`` stands for its INI file."""
    ini = put(ini, 'HAL', 'HALUI', ['halui'])
    for key, value in (('FOLDER', FOLDER), ('HEART_HOST', host), ('HEART_PORT', str(port)),
                       ('SILENCE', f'{silence_s:g}')):
        ini = put(ini, 'STEPDIAG', key, [value])
    return {'machine.ini': with_halfile(ini, WATCH_HAL), WATCH_HAL: source('watch.hal'),
            f'{FOLDER}/heart.py': source('heart.py')}


def unwatched(ini: str) -> dict[str, str | None]:
    """Files that take the watchdog out of a configuration again; HALUI stays, others may use it."""
    for key in ('HEART_HOST', 'HEART_PORT', 'SILENCE'):
        ini = put(ini, 'STEPDIAG', key, [])
    return {'machine.ini': with_halfile(ini, WATCH_HAL, False), WATCH_HAL: None, f'{FOLDER}/heart.py': None}


def followed(ini: str, track: str) -> dict[str, str]:
    """Files that have the virtual sensors follow a simulated machine; ``track`` is the file they read."""
    ini = put(put(ini, 'STEPDIAG', 'FOLDER', [FOLDER]), 'STEPDIAG', 'TRACK', [track])
    return {'machine.ini': with_halfile(ini, FOLLOW_HAL), FOLLOW_HAL: FOLLOW,
            f'{FOLDER}/follow.py': source('follow.py')}


def compensated(ini: str, *, tables: Mapping[str, str] | None = None, matrix_hal: str | None = None,
                volume: str | None = None) -> dict[str, str | None]:
    """Files that compensate a machine, and ``machine.ini``; None for a file that has to go.

    ``tables``: axis letter to the text of its screw table; ``matrix_hal``: lines for ``matrixkins``; ``volume``:
    the solution file of the volumetric component, instead of ``matrix_hal``.  What is not given is taken out.
    """
    if volume is not None and matrix_hal is not None:
        raise ValueError('there is one kinematics module: the volumetric component or matrixkins')
    files: dict[str, str | None] = {}
    for number, letter in enumerate(AXES):
        name, text = f'{FOLDER}/{letter.lower()}.comp', (tables or {}).get(letter)
        files[name] = text
        ini = put(ini, f'JOINT_{number}', 'COMP_FILE', [] if text is None else [name])
        ini = put(ini, f'JOINT_{number}', 'COMP_FILE_TYPE', [] if text is None else ['1'])
    kinematics = get(ini, 'KINS', 'KINEMATICS')
    if not kinematics:
        raise StepdiagError("the INI file names no [KINS]KINEMATICS; is it LinuxCNC's?")
    ours = kinematics[0].split()[0] in (COMPONENT, 'matrixkins')
    plain = get(ini, 'STEPDIAG', 'KINEMATICS')[:1] or (['trivkins coordinates=XYZ'] if ours else kinematics[:1])
    if volume is not None or matrix_hal is not None:
        if plain[0].split()[0] != 'trivkins':
            raise StepdiagError(f'the control runs {plain[0].split()[0]}; matrix and volumetric component replace '
                                'trivkins only')
        ini = put(ini, 'STEPDIAG', 'KINEMATICS', plain)
    wanted = f'{COMPONENT} file={VOLUME}' if volume is not None else \
        'matrixkins' if matrix_hal is not None else plain[0]
    ini = put(ini, 'KINS', 'KINEMATICS', [wanted])
    lines = HAL_LINES
    if WATCH_HAL in get(ini, 'HAL', 'HALFILE'):
        lines += '# No move begins while the compensation is on its way in or out.\n' \
                 'net stepdiag-ramping stepdiagkins.ramping => stepdiagwatch.hold\n'
    files |= {VOLUME: volume, VOLUME_HAL: None if volume is None else lines, MATRIX_HAL: matrix_hal}
    ini = with_halfile(ini, MATRIX_HAL, matrix_hal is not None)
    return files | {'machine.ini': with_halfile(ini, VOLUME_HAL, volume is not None)}


def must_be_supported(ini: str, name: str) -> None:
    """:class:`StepdiagError` unless positions are in mm and joints 0, 1, 2 are X, Y, Z, and all of it is in this file.

    Tables in mm on a machine in inches would be 25 times as large; on a gantry the second motor of an axis would not
    follow the first.
    """
    if re.search(r'(?m)^\s*#INCLUDE\b', ini):
        raise StepdiagError(f'{name}: includes other files (#INCLUDE), which stepdiag does not read; put their lines '
                            'into it')
    units = get(ini, 'TRAJ', 'LINEAR_UNITS')
    if [u.lower() for u in units] not in (['mm'], ['metric'], ['millimeter']):
        raise StepdiagError(f'{name}: [TRAJ]LINEAR_UNITS is {" ".join(units) or "missing"}; stepdiag writes mm')
    kinematics = get(ini, 'KINS', 'KINEMATICS')
    if len(kinematics) != 1 or not kinematics[0]:
        raise StepdiagError(f'{name}: names {len(kinematics) or "no"} [KINS]KINEMATICS; is it LinuxCNC\'s?')
    coordinates = re.search(r'\bcoordinates=(\S+)', kinematics[0])
    joints, axes = get(ini, 'KINS', 'JOINTS'), ''.join(get(ini, 'TRAJ', 'COORDINATES')).replace(' ', '').upper()
    if kinematics[0].split()[0] not in ('trivkins', 'matrixkins', COMPONENT) or joints != ['3'] or axes != 'XYZ' \
            or coordinates and coordinates[1].upper() != 'XYZ':
        raise StepdiagError(f'{name}: [KINS]KINEMATICS is {kinematics[0]}, JOINTS {" ".join(joints) or "missing"}, '
                            f'[TRAJ]COORDINATES {axes or "missing"}; stepdiag compensates machines whose joints '
                            '0, 1, 2 are X, Y, Z, by trivkins, and no more')


def read_ini(folder: Path) -> tuple[Path, str]:
    """The INI file of a configuration folder and its text; bytes that are no UTF-8 are kept as they are."""
    path = ini_file(folder)
    try:
        return path, path.read_text(encoding='utf-8', errors='surrogateescape')
    except OSError as error:
        raise StepdiagError(f'{path}: cannot be read: {error.strerror}') from None


def ini_file(folder: Path) -> Path:
    """The INI file of a configuration folder; there has to be one alone."""
    found = sorted(folder.glob('*.ini'))
    if len(found) != 1:
        raise StepdiagError(f'{folder}: holds {len(found)} INI files; name the folder of a LinuxCNC configuration '
                            'with one alone')
    return found[0]


def renamed(files: Mapping[str, str | None], ini: str) -> dict[str, str | None]:
    """The files with the INI file's own name."""
    return {ini if name == 'machine.ini' else name: text for name, text in files.items()}


def write(folder: Path, files: Mapping[str, str | None]) -> None:
    """Write files into a folder, each whole or not at all; None takes one away."""
    for name, text in files.items():
        path = folder / name
        try:
            if text is None:
                path.unlink(missing_ok=True)
                continue
            path.parent.mkdir(parents=True, exist_ok=True)
            part = path.with_name(f'{path.name}.new')
            part.write_text(text, encoding='utf-8', errors='surrogateescape')
            if path.exists():
                shutil.copymode(path, part)
            if text.startswith('#!'):
                part.chmod(part.stat().st_mode | stat.S_IXUSR | stat.S_IXGRP | stat.S_IXOTH)
            part.replace(path)
        except OSError as error:
            raise StepdiagError(f'{path}: cannot be written: {error.strerror or error}') from None
