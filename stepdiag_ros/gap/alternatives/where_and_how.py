"""The table of where something may act and what it may follow: its cells that no effect of the vocabulary has.

Whatever errs acts somewhere (an axis, the tool's angle, the beam, a length, the spot) and follows something (a place,
the direction of motion, what moved before, time, the spot itself).  An effect of the vocabulary is one cell of this
table: a scale that warms shifts an axis by its own place and time, backlash shifts it by the direction from which it
came.  What acts in another cell would be given the name of a neighbour if only names competed.  So every cell competes
in few parameters; it has no name, and which one a log shows is said in its label.

Cells that the 21 errors are (an axis shifted by its own place) or that a name has are left out.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np
from numpy.polynomial import legendre

from stepdiag_ros.effects.base import Form, StopView
from stepdiag_ros.effects.fading import bin_means, by_last_moves, fading_columns, last_arrivals
from stepdiag_ros.effects.made import Product, Split
from stepdiag_ros.effects.patterns import MOST_OWN, anew
from stepdiag_ros.effects.timeforms import TimeProfile, drift_form, exponential, linear, unknown
from stepdiag_ros.effects.tuning import tunable
from stepdiag_ros.gap.alternatives.unmodelled import numbered_form
from stepdiag_ros.model.machine import AXES, CURVES, carried

BENDS = 3
"""Degree of the polynomials by which something follows a place."""
TAUS = (0.06, 0.25)
"""Time constants tried of what changes with time, as shares of the log's length; they are tuned."""
WAVES, FEW_WAVES = 12, 6
"""Half waves of a time profile of any shape, and of that of a shape along an axis that is open too."""
PLACE_WAVES, RUN_WAVES = 8, 4
"""Half waves along an axis of such a shape, and of one that is another in each run; their sizes fall as those of a walk
at random, which a step is too."""
MEMORY_S = (0.5, 4.0, 30.0)
"""Time constants tried [s] with which a detector forgets …"""
CREEP_S = (30.0, 200.0)
"""… with which what stands on something creeps …"""
JOLTED_S = 0.7
"""… and with which fades what a move rocks; they are tuned."""
PERIODS_M = tuple(np.geomspace(1.5e-4, 1e-3, 7))
"""Periods tried [m] of what swings as the spot wanders; they are tuned."""
BEARINGS = 8
"""Directions in the detector's plane in which it may, evenly over half a turn."""
ALIKE = 1e-6
"""Share of their squares by which columns may differ that do the same to the readings."""


@dataclass(frozen=True)
class Where:
    """Where something acts: derivatives ``columns`` (k, n, c) of the readings; a typical size ``scale``, ``units``."""

    label: str
    columns: np.ndarray
    scale: float
    units: str

    def following(self, view: StopView, what: str, courses: np.ndarray, unsettled: np.ndarray | None = None) -> Form:
        """What acts here and follows ``courses`` (m, n) of the stops, each with a size of its own; at ``unsettled``
        (n,) ones, where nothing tells what to follow, it is by any amount in each setup."""
        if unsettled is not None:
            own = unsettled & (view.setup == np.unique(view.setup)[:, None])
            courses = np.concatenate([courses, own[own.any(axis=1)]])
        return numbered_form(f'{self.label} {what}', Product(courses, self.columns), self.scale, self.units)


def table_families(view: StopView) -> dict[str, list[Form]]:
    """The cells by what is followed."""
    machine = _machine(view)
    sides = [*(_carried(view, axis) for axis in range(3)), *machine]
    return {'place': _shown(_by_place(view)), 'distance': _shown(_by_distance(view)),
            'direction': _shown(_by_direction(view)),
            'history': _shown(chain(_by_history(view), _jolts(view, machine), _creeps(view, sides))),
            'time': list(_turned_in_time(view, sides)), 'shape': list(_shapes_in_time(view)),
            'fringes': _shown(_fringes(view))}


def _shown(forms: Iterator[Form]) -> list[Form]:
    """Those that this log can show at all."""
    return [form for form in forms if np.any(form.columns)]


def _axes(view: StopView) -> tuple[Where, ...]:
    return tuple(Where(f'{letter}: shifted', shift[None], 2e-6, 'm')
                 for letter, shift in zip(AXES, view.by_shift, strict=True))


def _tool(view: StopView, axis: int) -> Where:
    """The tool, and what axis ``axis`` carries of it, turned about X, Y and Z."""
    return Where('tool: turned', view.by_motion[6 * axis + 3:6 * axis + 6], 2e-6, 'rad')


def _carried(view: StopView, axis: int) -> Where:
    """What an axis carries of the tool, turned and shifted."""
    return Where(f'what {AXES[axis]} carries: turned and shifted',
                 np.concatenate([_tool(view, axis).columns, view.by_shift]), 2e-6, '1')


def _machine(view: StopView) -> list[Where]:
    """All that carries the tool about the machine's feet, turned and shifted; nothing where the table alone moves."""
    machine = view.description.machine
    outer = machine.chain[-1]
    if outer == 'F':
        return []
    # A turn of the outermost axis, its lever another: all places and the tool are turned.
    axis, whole = AXES.index(outer), []
    for k, about in enumerate(np.eye(3)):
        turns = np.zeros((3, len(view.time), 3))
        turns[axis, :, k] = 1.0
        own = carried(machine.chain, view.commanded, 0.0 * turns, turns, np.array(machine.tool))
        arm = np.cross(about, view.commanded + machine.tool) - own
        whole.append(view.by_motion[6 * axis + 3 + k] + np.einsum('nj,jnc->nc', arm, view.by_shift))
    return [Where('the machine on its feet: turned and shifted', np.concatenate([whole, view.by_shift]), 2e-6, '1')]


def _beam(view: StopView) -> Where:
    return Where('beam: turned', view.by_laser, 2e-6, 'rad')


def _mirror(view: StopView) -> Where:
    return Where('mirror: turned', view.by_mirror, 2e-6, 'rad')


def _length(view: StopView) -> Where:
    column = view.zeros(1)
    column[..., :view.beams] = 1.0
    return Where('displacement: off', column, 1e-6, 'm')


def _stretch(view: StopView) -> Where:
    column = view.zeros(1)
    column[0, :, :view.beams] = view.distance
    return Where('displacement: stretched', column, 1e-6, '1')


def _spot(view: StopView) -> Where:
    columns = view.zeros(2)
    columns[0, :, view.beams] = columns[1, :, view.beams + 1] = 1.0
    return Where('spot: off', columns, 3e-6, 'm')


def _bends(view: StopView, axis: int) -> np.ndarray:
    """Polynomials (1 + BENDS, n) of the place along an axis, of order one."""
    return _polynomials(view.commanded[:, axis] / view.description.machine.volume[axis])


def _polynomials(share: np.ndarray) -> np.ndarray:
    """Polynomials (1 + BENDS, n) of a share (n,) from 0 to 1, of order one."""
    return legendre.legvander(2.0 * share - 1.0, BENDS).T


def _moving(view: StopView) -> Iterator[tuple[int, str]]:
    """The axes that move in this log."""
    return ((axis, letter) for axis, letter in enumerate(AXES) if np.ptp(view.commanded[:, axis]) > 0.0)


def _by_place(view: StopView) -> Iterator[Form]:
    """The beam, lengths or the detector follow where an axis stands; shifts and turns of the tool that do are errors
    of that axis, or of two of them."""
    for axis, letter in _moving(view):
        bends = _bends(view, axis)[1:]
        for where in (_beam(view), _stretch(view), _spot(view)):
            yield where.following(view, f'by the place of {letter}', bends[:1])
            yield where.following(view, f'by the place of {letter}, bent', bends)


def _by_distance(view: StopView) -> Iterator[Form]:
    """The beam's direction or the spot follow the length of the path, alike in all setups or otherwise in each; a spot
    in proportion to it is the mirror's angle, and beside that the detector's zero."""
    far = view.distance[:, 0] / max(float(np.nanmax(np.abs(view.distance[:, 0]))), 1e-9)
    bends = _polynomials(far)
    setups = (view.setup == np.unique(view.setup)[:, None]).astype(float)
    for where, courses in ((_beam(view), bends[1:]), (_spot(view), bends[2:])):
        yield where.following(view, 'by the length of the path', courses[:1])
        yield where.following(view, 'by the length of the path, bent', courses)
        yield where.following(view, 'by the length of the path, otherwise in each setup', setups * courses[0])


def _by_direction(view: StopView) -> Iterator[Form]:
    """Something follows the direction from which an axis came, alike or otherwise at each place of it or of another:
    all but a shift of that axis, which is its backlash, and what does the same as one."""
    shifts, bends = _axes(view), {axis: _bends(view, axis) for axis, _ in _moving(view)}
    for axis, letter in _moving(view):
        sign = view.approach[:, axis].astype(float)
        unsettled = sign == 0.0
        others = [shift for a, shift in enumerate(shifts) if a != axis]
        places = (*others, _tool(view, axis), _beam(view), _length(view), _spot(view))
        for where in (each for each in places if not _same(each.columns, shifts[axis].columns)):
            yield where.following(view, f'by the direction of {letter}', sign[None], unsettled)
            yield where.following(view, f'by the direction of {letter} at each place', sign * bends[axis], unsettled)
            for other, beside in _moving(view):
                if other != axis:
                    yield where.following(view, f'by the direction of {letter} along {beside}',
                                          sign * bends[other][:2], unsettled)


def _same(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether columns (k, n, c) do the same to the readings but for a factor, as a shift of X and an error of length do
    where the laser looks along X alone."""
    if one.shape != other.shape:
        return False
    return bool(abs(np.vdot(one, other)) > (1.0 - ALIKE) * np.linalg.norm(one) * np.linalg.norm(other) > 0.0)


def _by_history(view: StopView) -> Iterator[Form]:
    """Something follows which axis moved last, or in which direction that was; the detector shows in part what it saw
    before.  Where one axis moves alone the last move's direction is that axis's."""
    moved = last_arrivals(view)[0].T.astype(float)
    unsettled = ~moved.any(axis=0)
    alone = len(list(_moving(view))) < 2
    for where in () if alone else (*_axes(view), _beam(view), _mirror(view), _length(view), _spot(view)):
        yield where.following(view, 'by which axis moved last', moved, unsettled)
        yield where.following(view, 'by the last move, each axis in its direction', moved * view.approach.T, unsettled)
    yield from (_remembered(view, tau) for tau in MEMORY_S)


def _behind(view: StopView, values: np.ndarray, tau: float) -> np.ndarray:
    """By what ``values`` (n, k) that follow with a time constant ``tau`` [s] are behind at each stop (n, k)."""
    order = np.argsort(view.time, kind='stable')
    half = np.exp(-0.5 * np.diff(view.time[order]) / tau)
    behind = np.zeros_like(values)
    for last, stop, fading in zip(order[:-1], order[1:], half, strict=True):
        behind[stop] = fading * (values[last] - values[stop] + fading * behind[last])
    return behind


def _creeps(view: StopView, sides: Sequence[Where]) -> Iterator[Form]:
    """A bed stays bent to where an axis stood."""
    for axis, _ in _moving(view):
        for tau in CREEP_S:
            behind = _place_behind(view, axis, tau)
            yield from (_creeping(view, side, axis, tau, behind) for side in sides)


def _place_behind(view: StopView, axis: int, tau: float) -> np.ndarray:
    """By what what follows an axis's place with a time constant ``tau`` [s] is behind it (1, n), as a share of the
    travel."""
    return _behind(view, view.commanded[:, [axis]] / view.description.machine.volume[axis], tau).T


def _creeping(view: StopView, side: Where, axis: int, tau: float, behind: np.ndarray) -> Form:
    form = side.following(view, f'by where {AXES[axis]} stood before, over {tau:.2g} s', behind)
    return tunable(form, 'tau_s', tau,
                   lambda other: _creeping(view, side, axis, other, _place_behind(view, axis, other)))


def _jolts(view: StopView, machine: Sequence[Where]) -> Iterator[Form]:
    """Feet of rubber rock for a while after each move."""
    return (_jolted(view, where, JOLTED_S) for where in machine)


def _jolted(view: StopView, where: Where, tau: float) -> Form:
    """Each move of an axis leaves something behind, by the direction in which it was, that fades in the dwell with a
    time constant ``tau`` [s]."""
    moved, before = last_arrivals(view)
    along = by_last_moves(view, moved, where.columns)
    columns, inside = fading_columns(along, bin_means(view.bin_time + before[:, None], tau)[None])
    form = replace(numbered_form(f'{where.label} by the last move, fading with {tau:.2g} s', columns, where.scale,
                                 where.units), inside=inside)
    return tunable(form, 'tau_s', tau, lambda other: _jolted(view, where, other))


def _remembered(view: StopView, tau: float) -> Form:
    """The detector shows in part what it saw before, which fades with a time constant ``tau`` [s].

    The spot moves half-way between two stops in time, also from run to run: what a pause lets fade is gone then.
    """
    along = view.zeros(1)
    along[0, :, view.beams:] = _behind(view, view.spot_model, tau)
    columns, inside = fading_columns(along, bin_means(view.bin_time, tau)[None])
    form = Form(f'spot: in part what was seen before, fading with {tau:.2g} s', columns, ('share',), np.full(1, 0.02),
                '1', inside=inside)
    return tunable(form, 'tau_s', tau, lambda other: _remembered(view, other))


def _paces(view: StopView) -> tuple[list[TimeProfile], list[TimeProfile]]:
    """Simple time profiles, and those of any shape: over the log, anew in each run, anew in each setup."""
    time = view.elapsed
    span = max(float(np.ptp(view.time)), 1e-9)
    again = [pace for since, part, what in ((view.run_time, view.run, 'run'), (view.mount_time, view.setup, 'setup'))
             for pace in anew(since, part, what) if pace.label == f'anew in each {what}, smooth']
    return ([linear(time), *(exponential(time, share * span) for share in TAUS)],
            [unknown(time, most=WAVES)[-1], *again])


def _turned_in_time(view: StopView, sides: Sequence[Where]) -> Iterator[Form]:
    """What carries the tool turns and shifts with time, at all places alike: a shift alone has a name, and so have the
    mirror's turns in its mount and the beam's, none of which has a lever."""
    paces = [pace for each in _paces(view) for pace in each]
    for side in sides:
        names = tuple(str(i) for i in range(len(side.columns)))
        for pace in paces:
            yield drift_form(view, pace, side.columns, names, np.full(len(names), side.scale), side.label, side.units)


def _shapes_in_time(view: StopView) -> Iterator[Form]:
    """An error motion of an axis changes its shape with time: what a squareness or a scale shifts grows in proportion
    to the place, this does not; turns of a carriage have no name in time at all."""
    time, runs = view.elapsed, np.unique(view.run)
    paces, smooth = _paces(view)
    for axis, _ in _moving(view):
        share = view.commanded[:, axis] / view.description.machine.volume[axis]
        number = np.arange(1, PLACE_WAVES + 1)
        waves = np.cos(np.pi * number[:, None] * share)
        for k in range(6):
            motion = view.by_motion[6 * axis + k]
            if not np.any(motion):
                continue
            name, units = CURVES[6 * axis + k], 'm' if k < 3 else 'rad'
            straight = {} if k < 3 else {'slope': share}
            for shape, course in {**straight, 'bow': np.sin(np.pi * share), 'S': np.sin(2.0 * np.pi * share)}.items():
                signature = course[:, None] * motion
                for pace in (*paces, *smooth):
                    yield drift_form(view, pace, signature[None], ('0',), np.full(1, 2e-6),
                                     f'{name} changes its shape, {shape}', units)
            names, shaped = tuple(str(i) for i in number), waves[:, :, None] * motion
            for pace in (*paces, unknown(time, most=FEW_WAVES)[-1]):
                yield replace(drift_form(view, pace, shaped, names, 2e-6 / number,
                                         f'{name} changes its shape', units), process=True)
            if len(runs) > MOST_OWN:
                continue
            # A carriage may be turned otherwise in each run; where it is shifted otherwise, lengths begin anew.
            few = np.arange(RUN_WAVES + 1)[k < 3:]
            full = Split(np.cos(np.pi * few[:, None] * share)[:, :, None] * motion, view.run, runs,
                         np.ones((1, motion.shape[1]), bool))
            yield replace(numbered_form(f'{name} has another shape in each run', full, 2e-6, units),
                          scale=np.tile(2e-6 / np.maximum(few, 1), len(runs)), process=True)


def _fringes(view: StopView) -> Iterator[Form]:
    """Lengths or spots swing as the spot wanders: light from another surface runs beside the beam."""
    for angle in np.arange(BEARINGS) * np.pi / BEARINGS:
        along = view.spot_model @ (np.cos(angle), np.sin(angle))
        for where in (_length(view), _spot(view)):
            yield from (_fringe(view, where, float(np.degrees(angle)), along, period)
                        for period in PERIODS_M if np.ptp(along) > 0.5 * period)


def _fringe(view: StopView, where: Where, bearing: float, along: np.ndarray, period: float) -> Form:
    phase = 2.0 * np.pi * along / period
    form = where.following(view, f'and on as the spot wanders {period * 1e3:.2g} mm along {bearing:.0f}°',
                           np.stack([np.cos(phase), np.sin(phase)]))
    return tunable(form, 'period_m', period, lambda other: _fringe(view, where, bearing, along, other))
