"""All 21 errors on LinuxCNC: the solution file of our kinematics module ``stepdiagkins``.

The module computes the deviation of the whole chain for its tool and takes it off
(:mod:`stepdiag_ros.linuxcnc.volume`).  It does not know from where an axis comes: what a reversal needs goes into screw
tables beside it, which LinuxCNC applies to the joints behind the kinematics.
"""

from collections.abc import Mapping

import numpy as np

from stepdiag_ros.compensate import linuxcnc, linuxcnc_matrix
from stepdiag_ros.compensate.control import OWN, Control, Place
from stepdiag_ros.compensate.taken import Taken, Trim, added, errors_of
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.linuxcnc.volume import VOLUME_HAL, read_volume, volume_file
from stepdiag_ros.model.machine import AXES, CURVES, SQUARENESS_SHIFT

FILE, HAL_FILE = 'volume.txt', 'volume.hal'
LEAST_REVERSAL_M = 1e-9
KINEMATICS = ('# Lines for the INI file of the machine, in place of those that are there.\n[KINS]\n'
              f'KINEMATICS = stepdiagkins file={FILE}\n[HAL]\n# after the other HALFILE lines\nHALFILE = {HAL_FILE}\n')


def write(taken: Taken, place: Place) -> dict[str, str]:
    """The solution file, its HAL lines, the lines of the INI file, and screw tables of what reverses."""
    machine = place.machine
    files = {FILE: volume_file(errors_of(taken), machine.name, machine.tool, machine.volume, tuple(place.origin),
                               machine.chain), HAL_FILE: VOLUME_HAL}
    tables = linuxcnc.write(reversals(taken), place)
    ini = tables.pop(linuxcnc.INI, '')
    return files | tables | {linuxcnc.INI: KINEMATICS + ini}


def reversals(taken: Taken) -> dict[str, Trim]:
    """What the directions of approach differ by, half of it on either side, of the axes where they do."""
    halves = {name: Trim(trim.position, trim.forward - trim.mean, trim.reverse - trim.mean)
              for name, trim in taken.items() if name in OWN}
    return {name: trim for name, trim in halves.items() if np.max(np.abs(trim.forward)) > LEAST_REVERSAL_M}


def read(files: Mapping[str, str], place: Place) -> dict[str, Trim]:
    """What the solution file, a matrix and screw tables take off together."""
    taken = linuxcnc_matrix.read({name: text for name, text in files.items() if name.split('/')[-1] != FILE}, place)
    file = next((name for name in files if name.split('/')[-1] == FILE), None)
    return taken if file is None else added(taken, model(files[file], file, place))


def model(text: str, file: str, place: Place) -> dict[str, Trim]:
    """What a solution file takes off, squareness as the slopes of straightness; ``file`` names it."""
    volume, machine = read_volume(text, file), place.machine
    for what, made, now in (('origin', volume.origin, place.origin), ('tool', volume.tool, machine.tool),
                            ('volume', volume.travel, machine.volume)):
        if not np.allclose(made, now, rtol=0.0, atol=1e-8):
            raise StepdiagError(f'{file}: was made for the {what} {_mm(made)} mm, not for {_mm(now)} mm; take it out, '
                                'measure without it, and begin anew')
    if volume.chain != machine.chain:
        raise StepdiagError(f'{file}: was made for the chain {volume.chain}, not for {machine.chain}')
    taken = {}
    for name in CURVES:
        curve = volume.errors.curves[name]
        value = np.array(curve.value)
        for square, (axis, per_metre) in SQUARENESS_SHIFT.items():
            if AXES[axis] == name[2] and name[1] in AXES:
                value = value + volume.errors.square[square] * per_metre[AXES.index(name[1])] * curve.position
        taken[name] = Trim(np.asarray(curve.position), value, value)
    return taken


def _mm(place: tuple[float, ...] | np.ndarray) -> str:
    return '(' + ', '.join(f'{1e3 * v:g}' for v in place) + ')'


CONTROL = Control(
    'linuxcnc-volume', 'LinuxCNC volumetric compensation (stepdiagkins)', CURVES, write, read,
    'stepdiagkins: axes are where the tool point is; held against the rigid-body chain by tests in a running LinuxCNC',
    '',
    f'sudo stepdiag linuxcnc install; copy {FILE}, {HAL_FILE} and tables beside the INI file, put the lines of '
    f'{linuxcnc.INI} into its sections in place of those that are there, take COMP_FILE lines out that it does not '
    'name, restart LinuxCNC, home. The machine needs LINEAR_UNITS = mm, trivkins and joints 0, 1, 2 for X, Y, Z. '
    '`stepdiag improve` does all this.',
    'Put the INI file back as it was (KINEMATICS, HALFILE, COMP_FILE), restart LinuxCNC, home.',
    most_rows=linuxcnc.MOST_ROWS, joined=CURVES)
