"""Rectangular path with the beam regulated: 2D error motions by three simple tests.

An interferometer on the spindle, turned by a rotary axis C, looks at a cat's eye on the
table.  (1) X is run at y = y_a with the eye in line: EXX.  (2) Y is run at x = x_b: EYY.
(3) Both axes follow a rectangular path while C keeps the beam on the eye at P3,

    c_n = atan( −(P3_x − x_n)/(P3_y − y_n) )                                 (4)

With the kinematic model of the plane, ``p̂ = p* + K θ`` (5, 6), all three are one problem,

    min Σ_1 (|p̂ − P1| − L01 − ΔL1)² + Σ_2 (…)² + Σ_3 (|p̂ − P3| − L03 − ΔL3)²   (7)

under the constraints that the curves are zero at the origin, and EYX at the last x and EXY at the
last y (8), squareness beside them.  In a test along a line the eye's place on the line and
the dead path do the same; here P1 and P2 are held and L01, L02 found, so that θ is unchanged.

Uncertainty, as in Table 5.  A beam that misses the eye's centre by an angle ε costs only
``L ε²/2``; with ε² the sum of four squares that is u4.  The radial error of C (u2) acts in
the third test only, wavelength and repeatability (u1) in all.  The draws of the readings
go through (7) (:func:`~stepdiag_ros.estimate.multilateration.monte_carlo`).

Assumes: the plane; eye and spindle point in it; errors of the position do not steer the
beam off the eye.  Cannot see: anything out of the plane; EYX and ECX from one another in
an x where the path passes only once.  The sensitivity is worst where the beam runs along
an axis.

Source: Ibaraki & Hiruya 2020, eqs. 2–8, Tables 1 and 5, fig. 12.  The path of fig. 5 is not in
the text: 53 points on a 9 × 9 grid over ±400 mm can be laid in several ways (see
:func:`rectangular_path`), and P3 is taken where Table 5's u4 puts it.  The published shape of
fig. 12 comes out in the frame of the X line's least-squares line; with (8) to the letter
the map leans towards the last x.
"""

from dataclasses import dataclass

import numpy as np

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.gauge import slope_weights
from stepdiag_ros.estimate.multilateration import (
    PLANE_CURVES,
    Answer,
    Motions,
    Problem,
    monte_carlo,
    plane_kinematics,
    report,
    solve,
)
from stepdiag_ros.estimate.solution import Solution

RANGE_M = 0.4
GRID = 9


@dataclass(frozen=True)
class Budget:
    """Table 5, one standard deviation: lengths [m], angles [rad]."""

    wavelength: float = 0.03e-6
    wavelength_correction: float = 0.16e-6
    environment: float = 0.08e-6
    repeatability: float = 0.63e-6
    radial_error: float = 2.12e-6
    c_zero: float = 2.88e-4
    c_positioning: float = 0.18e-4
    eye_position: float = 6.73e-4
    machine_positioning: float = 0.34e-4

    @classmethod
    def of_readings(cls, sigma_m: float) -> 'Budget':
        """Of a beam that a station turns, whose centre stands still: nothing but the ``sigma_m`` of its readings."""
        return cls(0.0, 0.0, 0.0, sigma_m, 0.0, 0.0, 0.0, 0.0, 0.0)

    @property
    def length(self) -> float:
        """u1 [m]."""
        return float(np.sqrt(self.wavelength ** 2 + self.wavelength_correction ** 2
                             + self.environment ** 2 + self.repeatability ** 2))

    @property
    def interferometer(self) -> float:
        """u2 [m]."""
        return self.radial_error

    @property
    def angle(self) -> float:
        """The beam's angle against the eye's centre [rad]: u41 … u44 together."""
        return float(np.sqrt(self.c_zero ** 2 + self.c_positioning ** 2 + self.eye_position ** 2
                             + self.machine_positioning ** 2))

    def orientation(self, distance_m: np.ndarray) -> np.ndarray:
        """u4 [m] at a distance: the cosine error ``L ε²/2``."""
        return np.asarray(distance_m) * self.angle ** 2 / 2.0

    def distance_of(self, orientation_m: float) -> float:
        """The distance [m] at which u4 has a given value."""
        return 2.0 * orientation_m / self.angle ** 2


@dataclass(frozen=True)
class Test:
    """The three tests' geometry [m]: grid, lines y_a and x_b, the eye's places, the path (n, 2)."""

    x: np.ndarray
    y: np.ndarray
    y_a: float
    x_b: float
    eyes: np.ndarray
    path: np.ndarray

    __test__ = False

    def commanded(self) -> list[np.ndarray]:
        """Points (n, 2) of each of the three tests."""
        return [np.stack([self.x, np.full_like(self.x, self.y_a)], axis=1),
                np.stack([np.full_like(self.y, self.x_b), self.y], axis=1), self.path]


def rectangular_path(half: float = RANGE_M, count: int = GRID) -> np.ndarray:
    """53 commands (n, 2) [m] on the grid: from the centre along y = 0 to the left edge, down it,
    once round the outline, up again and along y = 0 to the right edge.

    The publication's figure is lost; this path has its number of points, starts at the origin where
    the errors are zero, and meets every x on three lines and every y on both edges.
    """
    if count % 2 == 0:
        raise StepdiagError(f'regulated_beam: a grid of {count} has no middle line; take an odd number')
    grid = np.linspace(-half, half, count)
    end, middle = count - 1, count // 2
    corners = [(middle, middle), (0, middle), (0, 0), (end, 0), (end, end), (0, end), (0, 0),
               (0, middle), (end, middle)]
    cells = [corners[0]]
    for target in corners[1:]:
        while cells[-1] != target:
            i, j = cells[-1]
            cells.append((i + int(np.sign(target[0] - i)), j + int(np.sign(target[1] - j))))
    return grid[np.array(cells)]


def published_test(budget: Budget | None = None) -> Test:
    """9 × 9 positions over ±400 mm, 53 commands; the eye on the diagonal beyond (−400, −400).

    Its distance there is the one that gives Table 5's 0.14 µm for u4.
    """
    grid = np.linspace(-RANGE_M, RANGE_M, GRID)
    distance = (budget or Budget()).distance_of(0.14e-6)
    place = -RANGE_M - distance / np.sqrt(2.0)
    eyes = np.array([[-0.8, 0.0], [0.0, -0.8], [place, place]])
    return Test(grid, grid, 0.0, 0.0, eyes, rectangular_path())


def c_angle(eye: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Eq. 4: C (n,) [rad] that points the beam from ``points`` (n, 2) at ``eye`` (2,); 0 is along +Y."""
    arm = np.asarray(eye) - np.asarray(points)
    return np.arctan2(-arm[..., 0], arm[..., 1])


def motions_of(test: Test) -> Motions:
    """θ with the constraints (8); the squareness is a curve of one slope, its knots the grid's."""
    knots = {n: test.x if n[2] == 'X' else test.y for n in PLANE_CURVES}
    # Squareness beside EXY(y_N) = 0 is the same unknown as EXY(y_N): the latter is kept.
    return Motions.lay_out(knots, ('EYX',))


def problem_of(test: Test, readings: list[np.ndarray], budget: Budget | None = None) -> Problem:
    """Eq. 7: ``readings`` (n,) [m] of the three tests, weights from the budget."""
    budget = budget or Budget()
    points = test.commanded()
    if [len(r) for r in readings] != [len(p) for p in points]:
        raise StepdiagError('regulated_beam: readings of the three tests have lengths '
                            f'{[len(r) for r in readings]}, expected {[len(p) for p in points]}')
    nominal = np.concatenate(points)
    station = np.repeat(np.arange(3), [len(p) for p in points])
    tracking = station == 2
    distance = np.linalg.norm(nominal - test.eyes[station], axis=1)
    variance = np.full(len(nominal), budget.length ** 2)
    variance[tracking] += budget.interferometer ** 2 + budget.orientation(distance[tracking]) ** 2
    free = np.array([[False, False], [False, False], [True, True]])
    return Problem(nominal, plane_kinematics(motions_of(test), nominal), station,
                   np.concatenate(readings), np.sqrt(variance), test.eyes, free)


def evaluate(test: Test, readings: list[np.ndarray], budget: Budget | None = None) -> Solution:
    """EXX, EYX, ECX, EXY, EYY and EC0Y from the three tests."""
    problem = problem_of(test, readings, budget)
    return report('regulated_beam', motions_of(test), problem, solve(problem), ('EC0Y',))


def nominal_readings(test: Test) -> list[np.ndarray]:
    """What a perfect machine reads in the three tests, zero at each first point."""
    lengths = [np.linalg.norm(p - eye, axis=1)
               for p, eye in zip(test.commanded(), test.eyes, strict=True)]
    return [length - length[0] for length in lengths]


def grid_kinematics(test: Test) -> tuple[np.ndarray, np.ndarray]:
    """All grid points (k, 2) and their derivatives (k, 2, p) by θ."""
    points = np.stack(np.meshgrid(test.x, test.y, indexing='ij'), axis=-1).reshape(-1, 2)
    return points, plane_kinematics(motions_of(test), points)


def in_reference_line(test: Test, points: np.ndarray, kinematic: np.ndarray) -> np.ndarray:
    """Derivatives (k, 2, p) in the frame whose x is the least-squares line of EYX, not its end.

    Turning the frame by the line's slope φ about the origin takes p to ``(x + φ y, y − φ x)``.
    """
    slope = slope_weights(test.x) @ motions_of(test).curve_rows('EYX')
    turned = kinematic.copy()
    turned[:, 0] += points[:, 1:] * slope
    turned[:, 1] -= points[:, :1] * slope
    return turned


def position_uncertainty(test: Test, draws: int = 10_000, seed: int = 0,
                         budget: Budget | None = None, chords: int = 2,
                         frame: str = 'reference line'
                         ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Fig. 12: k = 2 uncertainty of the estimated position on the grid.

    ``frame``: ``'reference line'`` (the X line by least squares, as everywhere here) or ``'end
    point'`` (eq. 8 to the letter: the frame hangs on the last x, whose error turns all others).
    Returns points (k, 2) [m], by Monte Carlo (k,) and by linear propagation (k,) [m]: twice the root
    of the summed variances of x and y.
    """
    if frame not in ('reference line', 'end point'):
        raise StepdiagError(f"regulated_beam: frame={frame!r}; give 'reference line' or 'end point'")
    problem = problem_of(test, nominal_readings(test), budget)
    answer = solve(problem)
    points, kinematic = grid_kinematics(test)
    if frame == 'reference line':
        kinematic = in_reference_line(test, points, kinematic)
    drawn = monte_carlo(problem, answer, draws, np.random.default_rng(seed), chords)
    theta = drawn[:, :problem.motions]
    centred = theta - theta.mean(axis=0)
    drawn_covariance = centred.T @ centred / (draws - 1)
    return points, _radial(kinematic, drawn_covariance), _radial(kinematic, _motion_part(answer, problem))


def _motion_part(answer: Answer, problem: Problem) -> np.ndarray:
    return answer.covariance[:problem.motions, :problem.motions]


def _radial(kinematic: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    return 2.0 * np.sqrt(np.einsum('kdp,pq,kdq->k', kinematic, covariance, kinematic))
