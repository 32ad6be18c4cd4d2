"""LinuxCNC's screw compensation: ``COMP_FILE`` and ``COMP_FILE_TYPE`` of ``[JOINT_n]``.

A row is *nominal forward reverse*, in the machine's units (mm here).  With type 1 the last two are trims, with
type 0 the positions actually reached, trim = nominal − reached.  The trim of the direction of travel, straight
between rows and constant outside, is added to the joint's position on its way to the motor; while a joint stands,
the last one holds.  With a table the joint's ``BACKLASH`` no longer acts.  Rows must rise; reading stops without a
word at a line that is no row, so there are no comments; 256 rows at most.

Source: LinuxCNC, ``usrmotLoadComp`` (usrmotintf), ``EMCMOT_SET_JOINT_COMP`` (motion/command.c),
``compute_screw_comp`` and ``output_to_hal`` (motion/control.c), and the INI manual's ``COMP_FILE``.
"""

import re
from collections.abc import Mapping

import numpy as np

from stepdiag_ros.compensate.control import MILLI, OWN, Control, Place, number, thinned, trim_of
from stepdiag_ros.compensate.taken import Taken, Trim
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.model.machine import AXES

MOST_ROWS = 256
INI = 'joints.ini'


def write(taken: Taken, place: Place) -> dict[str, str]:
    """A ``.comp`` for each axis, and the lines of the INI file that name them."""
    files, lines = {}, ['# Lines for the INI file of the machine; positions and trims in mm.']
    for joint, name in enumerate(OWN):
        if name not in taken:
            continue
        trim = thinned(taken[name], MOST_ROWS)
        rows = [' '.join(map(number, row)) for row in
                zip((trim.position + place.origin[joint]) * MILLI, -trim.forward * MILLI, -trim.reverse * MILLI,
                    strict=True)]
        file = f'{AXES[joint].lower()}.comp'
        files[file] = '\n'.join(rows) + '\n'
        lines += [f'[JOINT_{joint}]', f'COMP_FILE = {file}', 'COMP_FILE_TYPE = 1']
    if files:
        files[INI] = '\n'.join(lines) + '\n'
    return files


def read(files: Mapping[str, str], place: Place) -> dict[str, Trim]:
    """What the tables take off; the INI file tells type, joint and ``BACKLASH``, without it names and values do."""
    joints = _ini(files)
    taken = {}
    for joint in range(3):
        name, told = OWN[joint], joints.get(joint, {})
        file = told.get('COMP_FILE') or f'{AXES[joint].lower()}.comp'
        file = next((f for f in files if f.split('/')[-1].lower() == file.split('/')[-1].lower()), None)
        if file is None:
            if told.get('COMP_FILE'):
                raise StepdiagError(f'{told["COMP_FILE"]}: is named by the INI file and was not given; '
                                    'give it with --present too')
            lost = _value(told, 'BACKLASH', joint)
            if lost:    # compute_screw_comp without a table: half of it on either side
                half = np.array([0.5 * lost / MILLI])
                taken[name] = Trim(np.zeros(1), -half, half)
            continue
        rows = _rows(files[file])
        trim = trim_of(rows[:, 0], rows[:, 1], rows[:, 2], file)
        if (int(_value(told, 'COMP_FILE_TYPE', joint)) if told else _guessed(rows, file)) == 0:
            forward, reverse = trim.position - trim.forward, trim.position - trim.reverse
        else:
            forward, reverse = trim.forward, trim.reverse
        taken[name] = Trim(trim.position / MILLI - place.origin[joint], -forward / MILLI, -reverse / MILLI)
    return taken


def _rows(text: str) -> np.ndarray:
    """The rows that LinuxCNC takes in (n, 3): up to the first line that is none, 256 at most."""
    rows: list[list[float]] = []
    for line in text.splitlines():
        match = re.match(r'\s*(\S+)\s+(\S+)\s+(\S+)', line)
        try:
            row = [float(part) for part in match.groups()] if match else []
        except ValueError:
            row = []
        if not row or len(rows) == MOST_ROWS:
            break
        rows.append(row)
    return np.array(rows).reshape(-1, 3)


def _guessed(rows: np.ndarray, file: str) -> int:
    """Type of a table that no INI file tells: reached positions follow the nominal ones, trims do not."""
    span = np.ptp(rows[:, 0])
    follows = np.abs(rows[:, 1] - rows[:, 0]).max()
    small = np.abs(rows[:, 1]).max()
    if follows < 0.1 * span <= 0.5 * small or (small > 0.0 and follows < 0.01 * small):
        return 0
    if small < 0.1 * max(span, 1e-9) or len(rows) == 1:
        return 1
    raise StepdiagError(f'{file}: cannot tell whether it holds trims or positions (COMP_FILE_TYPE); '
                        'give the machine\'s INI file with --present too')


def _ini(files: Mapping[str, str]) -> dict[int, dict[str, str]]:
    joints: dict[int, dict[str, str]] = {}
    for file, text in files.items():
        if not file.lower().endswith('.ini'):
            continue
        section = None
        for line in text.splitlines():
            head = re.match(r'\s*\[(\w+)\]', line)
            if head:
                match = re.fullmatch(r'JOINT_([012])', head[1])
                section = int(match[1]) if match else None
            entry = re.match(r'\s*(COMP_FILE_TYPE|COMP_FILE|BACKLASH)\s*=\s*(.*?)\s*$', line)
            if entry and section is not None:
                joints.setdefault(section, {})[entry[1]] = entry[2]
    return joints


def _value(told: Mapping[str, str], key: str, joint: int) -> float:
    try:
        return float(told.get(key, '0'))
    except ValueError:
        raise StepdiagError(f'[JOINT_{joint}] {key} is {told[key]!r}; give a number') from None


CONTROL = Control(
    'linuxcnc', 'LinuxCNC screw compensation', OWN, write, read,
    'LinuxCNC source: trim = nominal - actual, added to the motor position (motion/control.c), units of the INI file',
    '',
    f'Copy the .comp files beside the INI file, put the lines of {INI} into its sections, restart LinuxCNC, home. '
    'The INI file must have LINEAR_UNITS = mm; joints 0, 1, 2 are taken to be X, Y, Z. A BACKLASH of these joints no '
    'longer acts.',
    'Put the files of before/ back (or remove the COMP_FILE lines where there was none), restart LinuxCNC, home.',
    most_rows=MOST_ROWS)
