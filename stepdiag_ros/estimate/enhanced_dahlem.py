"""Enhanced step diagonal in closed form: tilts step by step, then distances (Dahlem et al.).

The mirror's tilt (α, β) about the setup's u and v is measured with every distance, by a
position sensing device (layout b) or by three parallel interferometer beams (layout a).
The printed equations are lost; this is their content, derived from the wire contract.

**Rotations.**  To first order the rotations add up, ``R = I + [θ]×`` (eq. 1), and the
transformation between mirror and machine axes of a setup is the matrix with rows u, v, d
(eqs. 2, 3, one for each diagonal).  Axis a moving by one step turns the mirror by the
change ``Δθ_a,k = (ΔEA, ΔEB, ΔEC)``, alike in all setups, of which each sees two components:

    s_a Δα = u_s · Δθ_a,k        s_a Δβ = v_s · Δθ_a,k                    (4)

Eight equations for three unknowns with four diagonals (six with three), solved by the
pseudo-inverse ``Δθ = B⁺ (Δα, Δβ)`` (5), with variance ``B⁺ Σ B⁺ᵀ`` (6).  The roll about one
diagonal is pitch and yaw for another.

**Tilt from the sensors.**  Layout b: ``(α, β) = (y, −x)/2L`` with the length L of the beam;
its mean over the setup, the motions taken off, is mirror less laser misalignment.
Layout a: beams at e_k differ by ``ΔL_k − ΔL_0 = −(e_u β − e_v α)``, of changes since the reset only.

**Distances.**  With the angles known, their effect on each distance is known: the arm from
carriage to tool point and the tilted mirror met beside its centre.  What remains reads
``s_a ΔL = d_s·Δt_a,k + h_a (μ_s × d_s)·e_a``, translations and the constant mirror angle μ_s (two
a setup).  The mean steps, the slopes of EXX, EYY, EZZ from linear setups of two stops,
and the reference frame along the machine's lines, give 12 equations for eight mirror
angles and three squarenesses; the single steps then give Δt by the pseudo-inverse of the
vector method.  Without linear setups the slopes and the mirrors are indistinguishable;
the mirrors are then taken for aligned.

**To the last digit.**  All this is linear, the sensor is not.  The closed form serves as an
approximate inverse: the exact sensor is predicted with the answer, what it leaves is
solved by the same closed form and added, until nothing changes.  A pass gains some three
digits (the size of the misalignments).

Assumes: rigid body; stiff setups; the PSD's zero at zero angle (layout b).  Cannot see: a
PSD zero that is off, which looks like a tilt falling with 1/L; in layout a the laser's
angle to first order (give it, bear λ²/2 of scale, or let it be found from what is left of the
redundant equations, an effect of 10 nm: quiet readings only); the laser's angle in a linear setup; slopes of the
positioning errors without linear setups.

Source: Dahlem, Emonts, Sanders, Schmitt 2018, chapter 3.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.readings import CellReadings, observe
from stepdiag_ros.estimate.solution import Solution, Unidentifiable
from stepdiag_ros.estimate.step_diagonal import vector_steps
from stepdiag_ros.estimate.stepwise import (
    accumulate,
    angle_effect,
    at_stops,
    increments,
    knots,
    rotation_names,
    solution,
    translation_names,
)
from stepdiag_ros.model.machine import CURVES, Curve, GeometricErrors
from stepdiag_ros.model.sensor import Misalignment

LASER_STEPS = 12
LASER_PROBE = 1e-4
"""[rad] half the step by which the lasers are turned to see what that does."""
MAX_PASSES = 15
SETTLED = 5e-13
"""A pass that changes no curve by more [m, rad] is the last; rounding alone makes some 1e-13."""
PLACES = ((1, 0), (2, 0), (2, 1))
"""(axis, component) of the mean steps that are squareness: EXY, EXZ, EYZ."""


@dataclass(frozen=True)
class _State:
    """Raw estimate: ``shift``, ``turn`` (3 axes, 3 components, n + 1); per setup (α, β) of mirror and laser."""

    shift: np.ndarray
    turn: np.ndarray
    mirror: dict[str, np.ndarray]
    laser: dict[str, np.ndarray]

    def errors(self, places: np.ndarray) -> GeometricErrors:
        both = np.concatenate([self.shift, self.turn], axis=1).reshape(18, -1)
        return GeometricErrors({name: Curve(places[i // 6], both[i])
                                for i, name in enumerate(CURVES)}, {})

    def misalignment(self, name: str) -> Misalignment:
        return Misalignment(tuple(self.laser[name]), tuple(self.mirror[name]))


def evaluate(cell: CellReadings, layout: str | None = None,
             laser: Mapping[str, tuple[float, float]] | str | None = None) -> Solution:
    """All 18 curves and three squareness errors.

    ``layout``: ``'a'`` (three beams) or ``'b'`` (PSD); by default b where every diagonal has spots.
    ``laser``: for layout a only, the lasers' misalignments (u, v) [rad], zero where not named, or
    ``'find'`` to look for those of the diagonals (their uncertainty is not propagated).
    """
    names = cell.diagonals('enhanced_dahlem', 3)
    if layout is None:
        layout = 'b' if all(cell.setups[n].spot_m is not None for n in names) else 'a'
    if isinstance(laser, str) and laser != 'find':
        raise StepdiagError(f"enhanced_dahlem: laser={laser!r}; give angles by setup, or 'find'")
    form = _ClosedForm(cell, names, layout)
    places = knots(cell.machine, cell.steps)
    n = cell.steps + 1
    zero = {name: np.zeros(2) for name in cell.setups}
    start = _State(np.zeros((3, 3, n)), np.zeros((3, 3, n)), zero, dict(zero))
    if layout == 'a' and laser == 'find':
        start = _find_lasers(form, start, places)
    elif layout == 'a':
        start = replace(start, laser=zero | {k: np.array(v, float) for k, v in (laser or {}).items()})
    state, passes, settled = _settle(form, start, places)
    unit = form.sensitivity()
    positions, curves, sensitivity = {}, {}, {}
    for axis in range(3):
        for kind, values, by in ((translation_names, state.shift, unit.shift),
                                 (rotation_names, state.turn, unit.turn)):
            for component, name in enumerate(kind(axis)):
                positions[name], curves[name] = places[axis], values[axis, component]
                sensitivity[name] = by[axis, component]
    return solution('enhanced_dahlem', positions, curves, sensitivity, form.variance(),
                    unidentifiable=form.blind(), status='ok' if settled else 'not settled',
                    misalignments={n: state.misalignment(n) for n in cell.setups},
                    extra={'layout': layout, 'passes': passes})


def _settle(form: '_ClosedForm', state: _State, places: np.ndarray,
            most: int = MAX_PASSES) -> tuple[_State, int, bool]:
    """Pass the residual through the closed form until nothing changes."""
    for passes in range(1, most + 1):
        left, tilt = form.residuals(state, places)
        change = form.solve(left[..., None], tilt[..., None])
        state = form.advance(state, change)
        if max(np.abs(change.shift).max(), np.abs(change.turn).max()) < SETTLED:
            return state, passes, True
    return state, most, False


def _find_lasers(form: '_ClosedForm', state: _State, places: np.ndarray) -> _State:
    """Layout a: the diagonals' lasers with which the redundant equations agree best.

    Four diagonals give twelve distances and eight tilts for six unknowns a step.  What they leave
    depends on the lasers through ``L λ·θ`` and the scale ``λ²/2 − λμ``.  Gauss–Newton; the derivatives
    by turning one laser at a time and settling again.
    """
    def turned(base: _State, column: int, angle: float) -> _State:
        name, part = form.names[column // 2], column % 2
        return replace(base, laser=base.laser | {name: base.laser[name] + angle * np.eye(2)[part]})

    def left_by(base: _State) -> np.ndarray:
        left, tilt = form.residuals(_settle(form, base, places, 3)[0], places)
        # A tilt counts by what it does over a beam's offset.
        return np.concatenate([left, np.ravel(tilt) * form.offset])

    for _ in range(LASER_STEPS):
        state = _settle(form, state, places)[0]
        left, tilt = form.residuals(state, places)
        by = np.stack([(left_by(turned(state, k, LASER_PROBE)) - left_by(turned(state, k, -LASER_PROBE)))
                       / (2.0 * LASER_PROBE) for k in range(2 * len(form.names))], axis=1)
        step = -np.linalg.lstsq(by, np.concatenate([left, np.ravel(tilt) * form.offset]), rcond=None)[0]
        for k, angle in enumerate(step):
            state = turned(state, k, angle)
        if np.abs(step).max() < 1e-9:
            break
    return state


@dataclass(frozen=True)
class _Change:
    """One linear answer, (3, 3, n + 1, columns); mirror and mirror-less-laser (setups, 2, columns)."""

    shift: np.ndarray
    turn: np.ndarray
    mirror: np.ndarray
    against_laser: np.ndarray


class _ClosedForm:
    """The linear equations of one cell, for any number of right-hand sides at once.

    Rows of a right-hand side: the distances of beam 0 at the stops of all setups laid end to
    end (diagonals first, then linear setups); tilts (rows, 2) alike.
    """

    def __init__(self, cell: CellReadings, names: list[str], layout: str):
        self.cell, self.names, self.layout = cell, names, layout
        linear = [f'lin_{axis}' for axis in 'xyz']
        self.linear = linear if all(n in cell.setups for n in linear) else []
        self.all = names + self.linear
        self.setups = {n: cell.setups[n] for n in self.all}
        counts = [len(s.displacement_m) for s in self.setups.values()]
        edges = np.concatenate([[0], np.cumsum(counts)])
        self.rows = {n: slice(a, b) for n, a, b in zip(self.all, edges, edges[1:], strict=False)}
        self.size = int(edges[-1])
        self.triads = np.array([self.setups[n].sight.triad for n in names])
        self.directions = self.triads[:, 2]
        self.step = np.array(cell.machine.volume) / cell.steps
        # Eq. 4: rows (setup, u or v), then eq. 5.
        self.tilt_inverse = np.linalg.pinv(self.triads[:, :2].reshape(-1, 3))
        self.mean_inverse = np.linalg.pinv(self._mean_matrix())
        self.angle_effect = {n: angle_effect(s.sight, cell.machine) for n, s in self.setups.items()}
        if layout == 'b':
            self.length = {n: self._lengths(n) for n in self.all}
        else:
            self._check_beams()

    # ---- what the sensors say of the tilt -----------------------------------------------------

    def _lengths(self, name: str) -> np.ndarray:
        setup = self.setups[name]
        if setup.spot_m is None:
            raise StepdiagError(f'enhanced_dahlem: setup {name} has no psd/spot; layout b needs it')
        lengths = setup.sight.standoff + (setup.sight.positions - setup.sight.positions[0]) \
            @ setup.sight.direction
        if not np.all(lengths > 0.0):
            raise StepdiagError(f'enhanced_dahlem: setup {name} has a mirror at the detector itself (standoff '
                                f'{setup.sight.standoff:g} m), where a spot tells no angle')
        return lengths

    def _check_beams(self) -> None:
        self.offset = float(np.ptp([b for s in self.setups.values() for b in s.sight.beams]))
        for name in self.all:
            offsets = np.array(self.setups[name].sight.beams)
            offsets = offsets[1:] - offsets[0]
            if np.linalg.matrix_rank(offsets) < 2:
                raise StepdiagError(
                    f'enhanced_dahlem: setup {name} has no psd/spot and its {len(offsets) + 1} '
                    'beams do not span a plane; give a PSD or three beams not in line')

    def _tilt(self, name: str, lengths: np.ndarray, spots: np.ndarray | None) -> np.ndarray:
        """(α, β) (n, 2) from residuals of distances (n, beams) and spots (n, 2)."""
        if self.layout == 'b':
            return np.stack([spots[:, 1], -spots[:, 0]], 1) / (2.0 * self.length[name][:, None])
        offsets = np.array(self.setups[name].sight.beams)
        offsets = offsets[1:] - offsets[0]
        matrix = np.stack([offsets[:, 1], -offsets[:, 0]], axis=1)
        return (lengths[:, 1:] - lengths[:, :1]) @ np.linalg.pinv(matrix).T

    def residuals(self, state: _State, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What the estimate leaves: distances (size,), tilts (size, 2)."""
        errors = state.errors(places)
        left, tilt = np.zeros(self.size), np.zeros((self.size, 2))
        for name, setup in self.setups.items():
            lengths, spots = observe(setup.sight, self.cell.machine, errors,
                                     state.misalignment(name))
            lengths = setup.displacement_m - (lengths - lengths[0])
            left[self.rows[name]] = lengths[:, 0]
            spots = setup.spot_m - spots if self.layout == 'b' else None
            tilt[self.rows[name]] = self._tilt(name, lengths, spots)
        return left, tilt

    # ---- equations ----------------------------------------------------------------------------

    def _mean_matrix(self) -> np.ndarray:
        """Mean steps (setup, axis) by three squarenesses [m a step] and two mirror angles a setup."""
        count = len(self.names)
        matrix = np.zeros((count, 3, 3 + 2 * count))
        for column, (axis, part) in enumerate(PLACES):
            matrix[:, axis, column] = self.directions[:, part]
        for s in range(count):
            u, v = self.triads[s, :2]
            # (α u + β v) × d = −α v + β u
            matrix[s, :, 3 + 2 * s] = -v * self.step
            matrix[s, :, 4 + 2 * s] = u * self.step
        matrix = matrix.reshape(3 * count, -1)
        if not self.linear:
            matrix[:, 3:] = 0.0
        return matrix

    def solve(self, left: np.ndarray, tilt: np.ndarray) -> _Change:
        """Answer to distances (size, c) and tilts (size, 2, c)."""
        steps, count = self.cell.steps, len(self.names)
        turned = np.stack([increments(self.setups[n].sight, tilt[self.rows[n]], steps)
                           for n in self.names])
        stacked = np.moveaxis(turned, 3, 1).reshape(2 * count, 3, steps, -1)
        turn = np.moveaxis(accumulate(np.moveaxis(
            np.tensordot(self.tilt_inverse, stacked, axes=(1, 0)), 0, 2)), 2, 1)
        left = left.copy()
        against_laser = []
        for name in self.all:
            rows = self.rows[name]
            at = at_stops(self.setups[name].sight, self.cell.machine, turn)
            left[rows] -= np.einsum('nk,nkc->nc', self.angle_effect[name], at)
            left[rows] -= left[rows][:1]
            total = at[:, 0:3] + at[:, 3:6] + at[:, 6:9]
            seen = np.einsum('wi,nic->nwc', self.setups[name].sight.triad[:2], total)
            against_laser.append((tilt[rows] - seen).mean(axis=0))
        y = np.stack([increments(self.setups[n].sight, left[self.rows[n]], steps)
                      for n in self.names])
        mean = y.mean(axis=2)
        if self.linear:
            for axis, name in enumerate(self.linear):
                travel = self.setups[name].sight.positions[-1, axis]
                slope = left[self.rows[name]][-1] / travel * self.step[axis]
                mean[:, axis] -= self.directions[:, axis, None] * slope
            answer = np.tensordot(self.mean_inverse, mean.reshape(3 * count, -1), axes=(1, 0))
            mirror = answer[3:].reshape(count, 2, -1)
            u, v = self.triads[:, 0], self.triads[:, 1]
            y -= (self.step[:, None] * (-v[..., None] * mirror[:, :1] + u[..., None] * mirror[:, 1:])
                  )[:, :, None]
        else:
            mirror = np.zeros((count, 2, left.shape[1]))
        shift = np.moveaxis(accumulate(vector_steps(self.directions, y)), 2, 1)
        return _Change(shift, turn, mirror, np.array(against_laser))

    def advance(self, state: _State, change: _Change) -> _State:
        """The state with one answer (a single column) added."""
        mirror, laser = dict(state.mirror), dict(state.laser)
        for i, name in enumerate(self.names):
            mirror[name] = mirror[name] + change.mirror[i, :, 0]
            if self.layout == 'b':
                laser[name] = laser[name] + (change.mirror[i] - change.against_laser[i])[:, 0]
        for i, name in enumerate(self.linear, len(self.names)):
            if self.layout == 'b':
                # Only the difference shows in a linear setup; it is booked to the mirror.
                mirror[name] = mirror[name] + change.against_laser[i, :, 0]
        return _State(state.shift + change.shift[..., 0], state.turn + change.turn[..., 0],
                      mirror, laser)

    # ---- propagation ----------------------------------------------------------------------------

    def sensitivity(self) -> _Change:
        """Answer to a unit error of every reading, in the order of :meth:`variance`."""
        n = self.size
        if self.layout == 'b':
            left, tilt = np.zeros((n, 3 * n)), np.zeros((n, 2, 3 * n))
            left[:, :n] = np.eye(n)
            tilt[np.arange(n), 0, n + np.arange(n)] = 1.0
            tilt[np.arange(n), 1, 2 * n + np.arange(n)] = 1.0
            return self.solve(left, tilt)
        # Beam 0 serves distance and tilt at once.
        beams = max(len(s.sight.beams) for s in self.setups.values())
        left, tilt = np.zeros((n, beams * n)), np.zeros((n, 2, beams * n))
        left[:, :n] = np.eye(n)
        for name, setup in self.setups.items():
            unit = self._tilt(name, np.eye(len(setup.sight.beams)), None)
            for row in range(self.rows[name].start, self.rows[name].stop):
                tilt[row, :, row + n * np.arange(len(unit))] = unit
        return self.solve(left, tilt)

    def variance(self) -> np.ndarray:
        """Layout b: variances (3 size,) of distances [m²], then α, then β [rad²].

        Layout a: variances (beams size,) of the distances of beam 0, then beam 1, … [m²].
        """
        length, tilt = np.zeros(self.size), np.zeros(self.size)
        for name, setup in self.setups.items():
            length[self.rows[name]] = setup.displacement_sigma_m ** 2
            if self.layout == 'b':
                tilt[self.rows[name]] = (setup.spot_sigma_m / (2.0 * self.length[name])) ** 2
        if self.layout == 'b':
            return np.concatenate([length, tilt, tilt])
        return np.tile(length, max(len(s.sight.beams) for s in self.setups.values()))

    def blind(self) -> tuple[Unidentifiable, ...]:
        found = []
        if not self.linear:
            found.append(Unidentifiable(
                ('EXX slope', 'EYY slope', 'EZZ slope', *(f'{n} mirror' for n in self.names)),
                'without three linear setups a constant mirror angle looks like slopes; '
                'the mirrors are taken for aligned'))
        if self.layout == 'a':
            found.append(Unidentifiable(
                tuple(f'{n} laser' for n in self.names),
                'three beams show changes of the tilt only; the laser\'s angle is as given, or '
                'found from its second-order effect'))
        elif self.linear:
            found.append(Unidentifiable(
                tuple(f'{n} laser' for n in self.linear),
                'a linear setup shows mirror less laser; the laser is taken for aligned'))
        if self.layout == 'b':
            found.append(Unidentifiable(('psd zero', 'mirror', 'laser'),
                                        'the PSD\'s zero is taken at zero angle'))
        return tuple(found)
