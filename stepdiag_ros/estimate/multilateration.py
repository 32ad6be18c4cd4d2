"""Multilateration: all error motions from distances to stations whose places are unknown.

A retroreflector at the tool is brought to N commanded positions p*_n; from each of several
stations m, one after the other, a tracking interferometer reads the displacement ΔL_n,m.
Solved is

    min Σ ( |p̂_n − P_m| − L0_m − ΔL_n,m )² / σ²                            (1)

over the error motions θ in p̂_n = p*_n + K_n θ, the stations P_m and the dead paths L0_m.
In the plane, with Y on X, K is

    p̂ = p* + [ EXX(x) + EXY(y) − (ECX(x) + EC0Y) y,   EYX(x) + EYY(y) ]      (2)

and three stations are enough; in space K is the derivative of the contract's chain by the
18 motions at each point, and four are.  Gauss–Newton with the analytic Jacobian
``[e·K, −e, −1]``, e the unit vector from station to point; columns are scaled to one, the
step is the smallest by singular values, and directions without information are named.

Gauge.  The curves are zero at the origin (which pins the frame there) and EYX, EZX, EZY
at their last knot (which pins its orientation); squareness is in the slopes of EXY, EXZ,
EYZ.  After solving everything is referred to the lines of ISO 230-1.

Assumes: the machine repeats between the stations; a point-like reflector; rigid body.
Cannot see: rotations of the last axis with one tool vector only (they shift the tool by
a constant, like its translations do): give the stations different tool vectors.

Source: Ibaraki & Hiruya 2020, section 2.1, eqs. 1–3; the form in space after the same
idea with four stations.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.eigen import eigen
from stepdiag_ros.estimate.gauge import GAUGE
from stepdiag_ros.estimate.solution import Solution, Unidentifiable
from stepdiag_ros.estimate.stepwise import solution
from stepdiag_ros.model.machine import AXES, CURVES, SQUARENESS, compose

MAX_ITERATIONS = 40
SETTLED_M = 1e-14
RANK = 1e-9
"""Singular values below this share of the largest carry no information."""
PLANE_CURVES = ('EXX', 'EYX', 'ECX', 'EXY', 'EYY')
DRAWS_AT_ONCE = 500


@dataclass(frozen=True)
class Problem:
    """Distances to be explained.

    ``nominal`` (n, d) [m] commanded points, ``kinematic`` (n, d, p) their derivatives by the error
    motions θ; ``station`` (n,) number of the station; ``reading`` (n,) and ``sigma`` (n,) [m];
    ``start`` (m, d) [m] guessed stations, ``free`` (m, d) which of their coordinates are unknown.
    """

    nominal: np.ndarray
    kinematic: np.ndarray
    station: np.ndarray
    reading: np.ndarray
    sigma: np.ndarray
    start: np.ndarray
    free: np.ndarray

    @property
    def motions(self) -> int:
        return self.kinematic.shape[2]

    @property
    def size(self) -> int:
        """Unknowns: motions, free station coordinates, dead paths."""
        return self.motions + int(self.free.sum()) + len(self.start)

    def initial(self) -> np.ndarray:
        """Unknowns (size,) of a perfect machine with the stations as guessed."""
        distance = np.linalg.norm(self.nominal - self.start[self.station], axis=1) - self.reading
        dead = [np.mean(distance[self.station == m]) for m in range(len(self.start))]
        return np.concatenate([np.zeros(self.motions), self.start[self.free], dead])

    def stations(self, unknown: np.ndarray) -> np.ndarray:
        """Station positions (…, m, d) from unknowns (…, size)."""
        places = np.broadcast_to(self.start, (*unknown.shape[:-1], *self.start.shape)).copy()
        places[..., self.free] = unknown[..., self.motions:self.motions + int(self.free.sum())]
        return places

    def dead_paths(self, unknown: np.ndarray) -> np.ndarray:
        return unknown[..., self.size - len(self.start):]

    def points(self, theta: np.ndarray) -> np.ndarray:
        """Estimated points (…, n, d) from motions (…, p)."""
        n, d, p = self.kinematic.shape
        moved = theta @ self.kinematic.reshape(n * d, p).T
        return self.nominal + moved.reshape(*theta.shape[:-1], n, d)

    def predict(self, unknown: np.ndarray) -> np.ndarray:
        """Readings (…, n) [m]."""
        arm = self.points(unknown[..., :self.motions]) - self.stations(unknown)[..., self.station, :]
        return (np.sqrt(np.sum(arm * arm, axis=-1))
                - self.dead_paths(unknown)[..., self.station])

    def jacobian(self, unknown: np.ndarray) -> np.ndarray:
        """Derivatives (n, size) of the readings."""
        arm = self.points(unknown[:self.motions]) - self.stations(unknown)[self.station]
        unit = arm / np.linalg.norm(arm, axis=1, keepdims=True)
        own = self.station[:, None] == np.arange(len(self.start))
        by_station = -(own[:, :, None] * unit[:, None, :])[:, self.free]
        by_motion = np.einsum('nd,ndp->np', unit, self.kinematic)
        return np.concatenate([by_motion, by_station, -own.astype(float)], axis=1)


@dataclass(frozen=True)
class Answer:
    """Unknowns (size,), covariance, null directions (k, size) of the scaled problem, χ², passes."""

    unknown: np.ndarray
    covariance: np.ndarray
    null: np.ndarray
    chi2: float
    dof: int
    iterations: int
    converged: bool


def solve(problem: Problem) -> Answer:
    """Gauss–Newton to the last digit."""
    unknown, converged, iterations = problem.initial(), False, 0
    while iterations < MAX_ITERATIONS:
        iterations += 1
        inverse, _, _ = _inverse(problem, unknown)
        step = inverse @ (problem.reading - problem.predict(unknown))
        unknown = unknown + step
        if not np.isfinite(unknown).all():
            raise StepdiagError('multilateration: the iteration ran away; check the guessed stations '
                                'and the order of the readings')
        if np.max(np.abs(step[:problem.motions])) < SETTLED_M:
            converged = True
            break
    inverse, null, rank = _inverse(problem, unknown)
    residual = (problem.reading - problem.predict(unknown)) / problem.sigma
    covariance = (inverse * problem.sigma ** 2) @ inverse.T
    return Answer(unknown, covariance, null, float(residual @ residual), residual.size - rank,
                  iterations, converged)


def _inverse(problem: Problem, unknown: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """Weighted generalised inverse (size, n) of the Jacobian, null directions and rank."""
    matrix = problem.jacobian(unknown) / problem.sigma[:, None]
    norm = np.linalg.norm(matrix, axis=0)
    norm[norm == 0.0] = 1.0
    left, values, right = np.linalg.svd(matrix / norm, full_matrices=True)
    kept = values > RANK * values[0]
    rank = int(kept.sum())
    inverse = (right[:rank].T / values[kept]) @ left[:, :rank].T / norm[:, None] / problem.sigma
    return inverse, right[rank:], rank


def monte_carlo(problem: Problem, answer: Answer, draws: int, rng: np.random.Generator,
                chords: int = 2) -> np.ndarray:
    """Unknowns (draws, size) from readings redrawn with ``sigma``, GUM Supplement 1.

    Every draw is solved with the fixed Jacobian of the answer, ``chords`` passes: one gives
    the linear answer, each further takes some four digits of the curvature.  All draws of a block go
    through the same matrix products.
    """
    inverse, _, _ = _inverse(problem, answer.unknown)
    base = problem.predict(answer.unknown)
    out = np.empty((draws, problem.size))
    for first in range(0, draws, DRAWS_AT_ONCE):
        count = min(DRAWS_AT_ONCE, draws - first)
        reading = base + rng.standard_normal((count, base.size)) * problem.sigma
        unknown = np.broadcast_to(answer.unknown, (count, problem.size))
        for _ in range(chords):
            unknown = unknown + (reading - problem.predict(unknown)) @ inverse.T
        out[first:first + count] = unknown
    return out


# ---- kinematics -------------------------------------------------------------------------------

@dataclass(frozen=True)
class Motions:
    """Which entry of θ is which knot of which curve; entries that the gauge holds are missing.

    ``knots``: curve → (k,) [m]; ``entry``: curve → (k,) number in θ or −1 (zero).
    """

    knots: dict[str, np.ndarray]
    entry: dict[str, np.ndarray]
    size: int

    @classmethod
    def lay_out(cls, knots: dict[str, np.ndarray], held_last: Sequence[str]) -> 'Motions':
        """Zero at the knot nearest to coordinate 0; ``held_last`` also at the last."""
        entry, size = {}, 0
        for name, places in knots.items():
            numbers = np.zeros(len(places), int)
            numbers[np.argmin(np.abs(places))] = -1
            if name in held_last:
                numbers[-1] = -1
            free = numbers >= 0
            numbers[free] = size + np.arange(free.sum())
            size += int(free.sum())
            entry[name] = numbers
        return cls(knots, entry, size)

    def spread(self, name: str, position: np.ndarray) -> np.ndarray:
        """Weights (n, size) of θ in a curve at commanded positions, which must be knots."""
        places = self.knots[name]
        nearest = np.argmin(np.abs(position[:, None] - places), axis=1)
        off = np.abs(position - places[nearest])
        if off.max() > 1e-6:
            raise StepdiagError(f'multilateration: {name} has no knot at {position[off.argmax()]:g} m; '
                                'command the points on the grid of the knots')
        matrix = np.zeros((len(position), self.size))
        number = self.entry[name][nearest]
        matrix[np.flatnonzero(number >= 0), number[number >= 0]] = 1.0
        return matrix

    def curve_rows(self, name: str) -> np.ndarray:
        """Matrix (k, size) from θ to a curve's values."""
        number = self.entry[name]
        rows = np.zeros((len(number), self.size))
        rows[np.flatnonzero(number >= 0), number[number >= 0]] = 1.0
        return rows


def plane_kinematics(motions: Motions, points: np.ndarray) -> np.ndarray:
    """Eq. 2: derivatives (n, 2, size) at commanded points (n, 2) [m]."""
    x, y = points[:, 0], points[:, 1]
    along_x = motions.spread('EXX', x) + motions.spread('EXY', y) \
        - y[:, None] * motions.spread('ECX', x)
    return np.stack([along_x, motions.spread('EYX', x) + motions.spread('EYY', y)], axis=1)


def space_kinematics(motions: Motions, points: np.ndarray, tool: np.ndarray,
                     chain: str = 'FXYZ') -> np.ndarray:
    """Derivatives (n, 3, size) of the tool point at commanded points (n, 3) [m], any chain."""
    points = np.asarray(points, float)
    n = len(points)
    matrix = np.zeros((n, 3, motions.size))
    for place, name in enumerate(CURVES):
        axis, part = divmod(place, 6)
        moved = []
        for small in (1e-6, -1e-6):
            shifts, turns = np.zeros((3, n, 3)), np.zeros((3, n, 3))
            shifts[np.arange(3), :, np.arange(3)] = points.T
            (shifts if part < 3 else turns)[axis, :, part % 3] += small
            moved.append(compose(chain, shifts, turns, tool)[0])
        by = (moved[0] - moved[1]) / 2e-6
        matrix += by[:, :, None] * motions.spread(name, points[:, axis])[:, None, :]
    return matrix


# ---- the two forms ----------------------------------------------------------------------------

def plane_motions(x_m: np.ndarray, y_m: np.ndarray) -> Motions:
    """θ of eq. 3 for a grid; the squareness is the slope of EXY, so that only EYX is held."""
    knots = {n: np.asarray(x_m if n[2] == 'X' else y_m, float) for n in PLANE_CURVES}
    return Motions.lay_out(knots, ('EYX',))


def evaluate_plane(points: Sequence[np.ndarray], readings: Sequence[np.ndarray],
                   stations: np.ndarray, sigma_m: float = 1e-6) -> Solution:
    """Eq. 1 in the plane: ``points`` (n, 2), ``readings`` (n,) [m] of each station, guesses (m, 2)."""
    stations = np.asarray(stations, float)
    if len(stations) < 3:
        raise StepdiagError(f'multilateration: {len(stations)} stations; a plane needs three')
    every = np.concatenate(points)
    motions = plane_motions(np.unique(np.round(every[:, 0], 9)), np.unique(np.round(every[:, 1], 9)))
    problem = _problem(points, [plane_kinematics(motions, p) for p in points], readings, stations,
                       sigma_m)
    return report('multilateration', motions, problem, solve(problem), ('EC0Y',))


def evaluate(points: Sequence[np.ndarray], readings: Sequence[np.ndarray], stations: np.ndarray,
             tools: np.ndarray, sigma_m: float = 1e-6, chain: str = 'FXYZ') -> Solution:
    """Eq. 1 in space: ``points`` (n, 3) of each station, readings (n,), guesses and tools (m, 3) [m]."""
    stations, tools = np.asarray(stations, float), np.asarray(tools, float)
    if len(stations) < 4:
        raise StepdiagError(f'multilateration: {len(stations)} stations; space needs four')
    every = np.concatenate(points)
    grid = [np.unique(np.round(every[:, k], 9)) for k in range(3)]
    motions = Motions.lay_out({n: grid[AXES.index(n[2])] for n in CURVES}, ('EYX', 'EZX', 'EZY'))
    kinematic = [space_kinematics(motions, p, t, chain) for p, t in zip(points, tools, strict=True)]
    moved = [np.asarray(p, float) + t for p, t in zip(points, tools, strict=True)]
    problem = _problem(moved, kinematic, readings, stations, sigma_m)
    return report('multilateration', motions, problem, solve(problem), SQUARENESS)


def _problem(points, kinematic, readings, stations, sigma_m) -> Problem:
    counts = [len(r) for r in readings]
    if [len(p) for p in points] != counts or len(points) != len(stations):
        raise StepdiagError('multilateration: points, readings and stations do not match; '
                            'give one array of each per station')
    total = sum(counts)
    return Problem(np.concatenate(points), np.concatenate(kinematic),
                   np.repeat(np.arange(len(counts)), counts), np.concatenate(readings),
                   np.full(total, sigma_m), stations, np.ones(stations.shape, bool))


def report(method: str, motions: Motions, problem: Problem, answer: Answer,
           square: Sequence[str]) -> Solution:
    """A solution in the reference lines of ISO 230-1, stations and dead paths in ``extra``."""
    theta = answer.unknown[:motions.size]
    # The covariance is not diagonal: its root serves as independent unit readings.
    covariance = answer.covariance[:motions.size, :motions.size]
    values, vectors = eigen(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    curves, sensitivity = {}, {}
    for name in motions.knots:
        rows = motions.curve_rows(name)
        curves[name], sensitivity[name] = rows @ theta, rows @ root
    found = solution(method, motions.knots, curves, sensitivity, np.ones(root.shape[1]), square,
                     unidentifiable=_blind(motions, answer))
    return replace(found, status='ok' if answer.converged else 'not converged',
                   gauge=GAUGE, dof=answer.dof,
                   reduced_chi2=answer.chi2 / answer.dof if answer.dof > 0 else None,
                   extra={'stations_m': problem.stations(answer.unknown).tolist(),
                          'dead_path_m': problem.dead_paths(answer.unknown).tolist(),
                          'iterations': answer.iterations})


def _blind(motions: Motions, answer: Answer) -> tuple[Unidentifiable, ...]:
    """The curves that take part in the null directions, all together."""
    if not len(answer.null):
        return ()
    weight = np.sum(answer.null ** 2, axis=0)
    names = tuple(name for name, entry in motions.entry.items()
                  if weight[entry[entry >= 0]].max(initial=0.0) > 1e-6)
    return (Unidentifiable(names, f'{len(answer.null)} combinations move no distance; '
                           'the smallest was taken, use other tool vectors to separate them'),)
