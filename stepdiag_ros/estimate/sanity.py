"""Mistakes of commissioning that a log shows before anything is estimated from it.

A setup's distances change by its *gradient* ``g`` with the commanded position, ``ΔL = g·Δp``.  The steps of a
diagonal move one axis at a time, so that ``g`` (3,) follows from a regression; of a linear setup its component along
the axis.  For the mirror's normal ``m`` and the beam ``b`` it is ``g = m/(b·m)``, the setup's direction ``d`` but for
the mirror's tilt (10 mrad at most where a spot shall stay on a detector) and errors of the machine (0.1 mm a metre at
most).  So the component along d is 1 within :data:`SCALE`, the rest 0 within :data:`ACROSS`: some thirty and five
times what a healthy log shows.  A gradient that is off by more is held against what mistakes would make of it:
another sign, factor or unit, another diagonal, axes exchanged, another order of the axes, no change at all.

Every mistake is one :class:`~stepdiag_ros.estimate.finding.Finding`: what was found, with numbers, and what to change.
What only shows as a bad fit (a detector mounted mirrored, a wrong tool) is looked for in
:mod:`stepdiag_ros.estimate.sanity_fit`.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import permutations

import numpy as np

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.finding import Finding
from stepdiag_ros.estimate.reduce import StopTable
from stepdiag_ros.model.description import DIAGONALS, Description, path_of
from stepdiag_ros.model.machine import AXES
from stepdiag_ros.model.path import setup_direction, stops
from stepdiag_ros.model.sensor import nominal_sight

SCALE = 3e-3
"""Deviation of the gradient's component along the setup from 1 above which a scale is wrong."""
ACROSS = 0.05
"""Size of the gradient's other components above which the beam does not lie along the setup."""
ELSEWHERE = 0.3
"""Share of the distances to a station by which they may differ from those to where it is said to stand."""
STILL = 0.01
"""Size of the gradient below which the readings do not follow the machine."""
MOVING, MOVING_SHARE = 3e-4, 0.5
"""Contrast between a dwell's samples, in shares of all that a setup's readings change by, above which no axis stood;
share of such dwells above which the stamps are at fault."""
LARGEST_SPOT_M = 0.1
"""No detector is as large."""
LONGEST_TOOL_M, WIDEST_OFFSET_M, FARTHEST_M = 5.0, 1.0, 100.0
"""No tool with a mirror is as long, no base unit as wide, no laser interferometer of machine tools measures as far."""
PLACE_M = 1e-4
"""A stop is the plan's if it is commanded to it within this."""
FACTORS = ((0.5, 'half', 'the instrument counts the wrong fraction of a wavelength'),
           (2.0, 'twice', 'the instrument counts the wrong fraction of a wavelength'),
           (1e3, '1000 times', 'the readings are in mm'), (1e6, 'a million times', 'the readings are in µm'),
           (1e9, '1e9 times', 'the readings are in nm'),
           (1e-3, 'a thousandth of', 'positions and volume are in mm, or the readings in km'),
           (1e-6, 'a millionth of', 'positions and volume are in µm'))


def check_readings(description: Description, table: StopTable) -> list[Finding]:
    """Mistakes that stops and readings alone show; empty for a sane log.  Needs no fit."""
    found: list[Finding] = []
    for number, setup in enumerate(table.setup_names):
        rows = np.flatnonzero(table.setup == number)
        if not len(rows):
            continue
        places = list(_places(description, table, setup, rows))
        found += places
        if not places:
            found += (_to_station if description.setups[setup].follows else _distances)(description, table, setup, rows)
    if found:
        # Of a log whose stamps are at fault no distance says anything; axes that run backwards do so in every setup.
        found = [finding for finding in found if finding.name == 'clock'] or _backwards(description, table) or found
    return _merged([*_described(description), *found, *_spots(table)], len(np.unique(table.setup)))


# ---- lengths of the cell ----------------------------------------------------------------------

def _described(description: Description) -> Iterator[Finding]:
    """Lengths of the description that nothing on a machine tool has: they were given in mm."""
    given = [('machine.tool', description.machine.tool, LONGEST_TOOL_M)]
    for name, setup in description.setups.items():
        given += [(f'setups.{name}.standoff', (setup.standoff,), FARTHEST_M),
                  (f'setups.{name}.psd_offset', setup.psd_offset, WIDEST_OFFSET_M),
                  (f'setups.{name}.tool', setup.tool or (), LONGEST_TOOL_M)]
        given += [(f'setups.{name}.beams', beam, WIDEST_OFFSET_M) for beam in setup.beams]
    wrong = {where: value for where, value, most in given if len(value) and np.linalg.norm(value) > most}
    if wrong:
        where, value = next(iter(wrong.items()))
        more = f', and {len(wrong) - 1} more such' if len(wrong) > 1 else ''
        yield Finding('unit of the cell', f'{where} is {_metres(value)} m{more}; nothing at a machine tool is as long',
                      f'lengths of a cell are in metres: if these are millimetres, {where} is '
                      f'{_metres(np.array(value) / 1e3)}')


def _metres(value: Sequence[float]) -> str:
    numbers = ', '.join(f'{v:.6g}' for v in value)
    return numbers if len(value) == 1 else f'[{numbers}]'


# ---- commanded places -------------------------------------------------------------------------

def _places(description: Description, table: StopTable, setup: str, rows: np.ndarray) -> Iterator[Finding]:
    """What the commanded positions say about the name of a diagonal, its order, its steps and the volume."""
    if path_of(setup) not in DIAGONALS:
        return
    index, commanded = table.index[rows].astype(int), table.commanded[rows]
    volume = np.array(description.machine.volume)

    def shift_to(other: Description, name: str) -> np.ndarray:
        """What is constant (3,) [m] between the path of a setup and where it was commanded to; NaN: not all is."""
        try:
            path = stops(other, name).positions
        except StepdiagError:
            return np.full(3, np.nan)
        apart = commanded - path[index] if index.max() < len(path) else np.full((1, 3), np.nan)
        shift = np.median(apart, axis=0)
        return shift if np.all(np.abs(apart - shift) < PLACE_M) else np.full(3, np.nan)

    def fits(other: Description, name: str) -> bool:
        return bool(np.all(np.abs(shift_to(other, name)) < PLACE_M))

    if fits(description, setup) or len(rows) < 4:
        return
    for name in DIAGONALS:
        if name != path_of(setup) and fits(_with_setup(description, setup, name), name):
            yield Finding('setup name', f'setup {setup}: the machine was commanded along the diagonal {name}',
                          f'record this setup under the name {name}, or exchange the names in `setups`')
            return
    for order in map(''.join, permutations('XYZ')):
        if order != description.plan.order and fits(
                replace(description, plan=replace(description.plan, order=order)), setup):
            yield Finding('order', f'setup {setup}: the axes moved in the order {order}, plan.order says '
                          f'{description.plan.order}', f'set plan.order: {order}')
            return
    taken = int(index.max()) // 3
    if taken != description.plan.steps and index.max() == 3 * taken and fits(
            replace(description, plan=replace(description.plan, steps=taken)), setup):
        yield Finding('steps', f'setup {setup}: the stops are those of {taken} steps an axis, plan.steps says '
                      f'{description.plan.steps}', f'set plan.steps: {taken}')
        return
    shift = shift_to(description, setup)
    if np.all(np.isfinite(shift)):
        yield Finding('origin', f'setup {setup}: the commanded positions are the plan\'s and {_vector(1e3 * shift)} mm',
                      'give positions from the lower corner of machine.volume: take off a work offset, or '
                      'machine.origin, before they are published')
        return
    span = np.ptp(commanded, axis=0)
    if index.max() == 3 * description.plan.steps and np.all(span > 0.0):
        measured = replace(description, machine=replace(description.machine, volume=tuple(span)))
        if fits(measured, setup):
            said = ' × '.join(f'{v:.6g}' for v in volume)
            yield Finding('volume', f'setup {setup}: the stops span {" × ".join(f"{v:.6g}" for v in span)} m, '
                          f'machine.volume says {said} m',
                          f'set machine.volume: [{", ".join(f"{v:.6g}" for v in span)}]')


def _with_setup(description: Description, old: str, new: str) -> Description:
    return replace(description, setups={**description.setups, new: replace(description.setups[old], name=new)})


# ---- distances --------------------------------------------------------------------------------

def gradient(table: StopTable, rows: np.ndarray) -> np.ndarray | None:
    """Change (3,) of beam 0 [m] per metre of X, Y, Z over the stops ``rows``; NaN for an axis that stood,
    None where too few readings are there.  Each run has its own zero."""
    rows = rows[np.isfinite(table.displacement[rows, 0])]
    place, length = table.commanded[rows].copy(), table.displacement[rows, 0].copy()
    for run in np.unique(table.run[rows]):
        own = table.run[rows] == run
        place[own] -= place[own].mean(axis=0)
        length[own] -= length[own].mean()
    moved = np.ptp(place, axis=0) > PLACE_M if len(rows) else np.zeros(3, bool)
    if len(rows) < 2 + moved.sum() - (moved.sum() == 1) or not moved.any():
        return None
    slope, _, rank, _ = np.linalg.lstsq(place[:, moved], length, rcond=1e-6)
    # Where all stops lie on one line the least slope is the one along it.
    if rank < moved.sum() and rank != 1:
        return None
    result = np.full(3, np.nan)
    result[moved] = slope
    return result


def _distances(description: Description, table: StopTable, setup: str, rows: np.ndarray) -> list[Finding]:
    """What a setup's gradient says about the instrument's sign, unit and place."""
    found = _of_gradient(description, table, setup, rows)
    if not found or found[0].name == 'still':
        return found
    # By another clock's stamps a dwell holds the way to it, or of the distance before the reset: what is left of the
    # setup says what it says without.
    moving = _moving(table, rows)
    if moving.mean() > MOVING_SHARE:
        return [Finding('clock', f'setup {setup}: in {moving.sum()} of {len(moving)} dwells the readings still move',
                        'set the clocks of interferometer and sequencer, whose stamps are apart by more than a part of '
                        'a dwell; or let the control say in position when the axes stand')]
    rows = rows[~moving]
    by_run = {run: _of_gradient(description, table, setup, rows[table.run[rows] == run])
              for run in np.unique(table.run[rows])}
    if all(by_run.values()):
        return _of_gradient(description, table, setup, rows)
    return [replace(finding, found=finding.found.replace(f'setup {setup}:', f'run {table.run_ids[run]}:'))
            for run, of_run in by_run.items() for finding in of_run]


def _moving(table: StopTable, rows: np.ndarray) -> np.ndarray:
    """In which of some stops the readings go on moving as those of no axis at rest do (k,)."""
    if table.displacement_parts is None:
        return np.zeros(len(rows), bool)
    way = np.ptp(table.displacement[rows, 0][np.isfinite(table.displacement[rows, 0])])
    return np.nan_to_num(np.abs(table.displacement_parts[rows, 0])).max(axis=1) > MOVING * way


def _of_gradient(description: Description, table: StopTable, setup: str, rows: np.ndarray) -> list[Finding]:
    seen = gradient(table, rows)
    if seen is None:
        return []
    moved, nominal = np.isfinite(seen), setup_direction(description.machine, description.setups[setup])
    if np.linalg.norm(nominal[moved]) < 0.5:
        return [Finding('axis', f'setup {setup}: it measures along {_letters(np.abs(nominal) > 0.5)}, the commanded '
                        f'positions move {_letters(moved)}', 'exchange the names of the linear setups')]
    seen, expected = seen[moved], nominal[moved]
    scale = float(seen @ expected / (expected @ expected))
    if abs(scale - 1.0) < SCALE and np.linalg.norm(seen - scale * expected) < ACROSS:
        return []
    straight = np.linalg.norm(seen / scale - expected) < ACROSS
    if straight and any(abs(abs(scale) / factor - 1.0) < ACROSS for factor, *_ in FACTORS):
        return [_of_scale(setup, scale)]
    if np.linalg.norm(seen) < STILL:
        reach = np.nanmax(np.abs(table.displacement[rows, 0]))
        return [Finding('still', f'setup {setup}: the reading changes by {1e6 * reach:.3g} µm at most while the '
                        f'machine moves {_reach(table, rows):.3g} m',
                        'check that the beam follows (shutter, alignment, the right beam and topic) and record this '
                        'setup again')]
    if straight:
        return [_of_scale(setup, scale)]
    nearest = min(_mistakes(description, setup, moved), key=lambda m: np.linalg.norm(seen - m[1]), default=None)
    if nearest is not None and np.linalg.norm(seen - nearest[1]) < ACROSS:
        name, _, (sentence, change) = nearest
        return [Finding(name, f'setup {setup}: the reading changes by {_vector(seen)} m per metre of '
                        f'{_letters(moved)}, expected is {_vector(expected)}; {sentence}', change)]
    return [Finding('direction', f'setup {setup}: the reading changes by {_vector(seen)} m per metre of '
                    f'{_letters(moved)}, expected is {_vector(expected)}', 'no single mistake explains this; check '
                    'machine.volume, the setup\'s name and where the base unit stands')]


def _backwards(description: Description, table: StopTable) -> list[Finding]:
    """Axes whose commanded positions run against the machine: the same in all diagonals, of which one may bear
    another's name and two may be exchanged for each other."""
    turned, diagonals = set(), 0
    for number, name in enumerate(table.setup_names):
        seen = gradient(table, np.flatnonzero(table.setup == number)) if path_of(name) in DIAGONALS else None
        if seen is None or not np.all(np.isfinite(seen)):
            continue
        nominal = setup_direction(description.machine, name)
        if np.linalg.norm(np.abs(seen) - np.abs(nominal)) > ACROSS:
            return []
        diagonals += 1
        turned.add(''.join(letter for letter, against in zip(AXES, seen * nominal < 0.0, strict=True) if against))
    axes = turned.pop() if len(turned) == 1 else ''
    if not 1 <= len(axes) <= 2 or diagonals < 1 + len(axes):
        return []
    named = ' and '.join(axes)
    return [Finding('axis backwards', f'in all {diagonals} diagonals the readings change as if {named} moved the other '
                    'way', f'turn the sign of the commanded {named}: positions count from the lower corner of '
                    'machine.volume, in the directions in which the diagonals are named')]


def _to_station(description: Description, table: StopTable, setup: str, rows: np.ndarray) -> list[Finding]:
    """What the readings of a setup with a station say against its nominal distances: sign, unit, and no change."""
    rows = rows[np.isfinite(table.displacement[rows, 0])]
    nominal, _ = nominal_sight(description.machine, description.setups[setup], table.commanded[rows])
    length = table.displacement[rows, 0].copy()
    for run in np.unique(table.run[rows]):
        own = table.run[rows] == run
        nominal[own] -= nominal[own].mean()
        length[own] -= length[own].mean()
    if not len(rows) or float(nominal @ nominal) < PLACE_M**2:
        return []
    scale = float(length @ nominal / (nominal @ nominal))
    # A station that stands elsewhere than stated bends this, and is found by the estimate.
    if np.linalg.norm(length - nominal) < ELSEWHERE * np.linalg.norm(nominal):
        return []
    if abs(scale) < STILL and np.linalg.norm(length) < STILL * np.linalg.norm(nominal):
        return [Finding('still', f'setup {setup}: the reading hardly changes while the machine moves '
                        f'{_reach(table, rows):.3g} m',
                        'check that the beam follows the retroreflector and record this setup again')]
    if np.linalg.norm(length - scale * nominal) < ELSEWHERE * np.linalg.norm(length) \
            and any(abs(abs(scale) / factor - 1.0) < ELSEWHERE for factor in (1.0, *(f for f, *_ in FACTORS))):
        near = min((1.0, *(f for f, *_ in FACTORS)), key=lambda factor: abs(np.log(abs(scale) / factor)))
        return [_of_scale(setup, float(np.copysign(near, scale)))]
    return [Finding('direction', f'setup {setup}: the readings are not the distances from the station at '
                    f'{_vector(np.array(description.setups[setup].station))} m',
                    f'check setups.{setup}.station, its tool and the order of the stations')]


def _of_scale(setup: str, scale: float) -> Finding:
    """The finding for readings that follow the machine, but by another factor."""
    what = f'setup {setup}: the reading changes by {scale:.6g} m per metre of travel'
    size, back = abs(scale), 'backwards, ' if scale < 0.0 else ''
    named = next(((words, why) for factor, words, why in FACTORS if abs(size / factor - 1.0) < ACROSS), None)
    if named is None and abs(size - 1.0) >= SCALE:
        return Finding('scale', f'{what}, expected is 1', 'check the instrument\'s wavelength and unit, and '
                       'machine.volume against the real travel')
    if named is None:
        return Finding('sign', f'{what}, expected is 1', 'turn the sign of the displacement: away from the base unit '
                       'is positive')
    return Finding('unit', f'{what}: {back}{named[0]} what the machine moved', f'{named[1]}; give metres'
                   + (', positive away from the base unit' if back else ''))


def _mistakes(description: Description, setup: str,
              moved: np.ndarray) -> Iterator[tuple[str, np.ndarray, tuple[str, str]]]:
    """Gradients that mistakes would make, each with its name and two clauses."""
    machine, own = description.machine, path_of(setup)
    if own not in DIAGONALS or moved.sum() < 3:
        return
    nominal, volume = setup_direction(machine, setup), np.array(machine.volume)
    for other in DIAGONALS:
        if other != own:
            yield ('setup name', setup_direction(machine, other),
                   (f'that is the diagonal {other}', f'the base unit stood for {other}: exchange the names of the '
                    'setups, or measure it again'))
    signs = np.sign(nominal)
    for order in permutations(range(3)):
        if order == (0, 1, 2):
            continue
        word = ''.join(AXES[k] for k in order)
        yield ('axes', signs * np.abs(nominal)[list(order)],
               (f'that is the diagonal with its axes as {word}', f'exchange the axes: positions or machine.volume name '
                f'X, Y, Z what the machine moves as {", ".join(word)}'))
        travel = np.abs(nominal) * volume
        yield ('order', signs * travel[list(order)] / volume,
               (f'each step moves {"".join(AXES[k] for k in order)} where the log says XYZ',
                f'set plan.order to the order in which the machine really moves and record commanded positions so '
                f'(XYZ reads as {word})'))


# ---- spots ------------------------------------------------------------------------------------

def _spots(table: StopTable) -> list[Finding]:
    """What the spots' size and rest say."""
    good = np.isfinite(table.spot).all(axis=1)
    if good.sum() < 4:
        return []
    largest = float(np.abs(table.spot[good]).max())
    if largest > LARGEST_SPOT_M:
        unit = 'mm' if largest < 1e3 * LARGEST_SPOT_M else 'µm'
        return [Finding('spot unit', f'psd/spot: spots stand up to {largest:.4g} m from the detector\'s centre, no '
                        f'detector is that large', f'the spots are in {unit}; give metres')]
    found = []
    for axis, letter in enumerate('xy'):
        if np.ptp(table.spot[good, axis]) == 0.0:
            found.append(Finding('spot still', f'psd/spot: {letter} is {table.spot[good][0, axis]:.4g} m at every one '
                                 f'of {good.sum()} stops', f'check the detector\'s channel {letter} and its wiring'))
    return found


# ---- words ------------------------------------------------------------------------------------

def _merged(found: list[Finding], setups: int) -> list[Finding]:
    """One finding where the same mistake shows in several setups."""
    groups: dict[tuple[str, str], list[Finding]] = {}
    for finding in found:
        groups.setdefault((finding.name, finding.change), []).append(finding)
    result = []
    for own in groups.values():
        more = [f.found.split(':')[0].removeprefix('setup ') for f in own[1:]]
        said = own[0].found + (f' (the same in {", ".join(more)}: {len(own)} of {setups} setups)' if more else '')
        result.append(replace(own[0], found=said))
    return result


def _letters(moved: np.ndarray) -> str:
    return ', '.join(letter for letter, on in zip(AXES, moved, strict=True) if on)


def _vector(values: np.ndarray) -> str:
    return '(' + ', '.join(f'{v:.3f}' for v in values) + ')'


def _reach(table: StopTable, rows: np.ndarray) -> float:
    return float(np.linalg.norm(np.ptp(table.commanded[rows], axis=0)))


