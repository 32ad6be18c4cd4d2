"""Setups, their stops and their local triads (contract, section Geometry)."""

from dataclasses import dataclass

import numpy as np

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.model.description import LINEAR, Description, Machine, Setup, path_of
from stepdiag_ros.model.log import NONE


@dataclass(frozen=True)
class SetupPath:
    """The stops of one setup in forward order.

    ``positions`` (n, 3) [m] commanded; ``axis`` (n,) number of the axis that moved to
    reach the stop going forward, 255 at the first and where several moved together.
    """

    positions: np.ndarray
    axis: np.ndarray

    def __len__(self) -> int:
        return len(self.positions)

    def moved(self, direction: int) -> np.ndarray:
        """Number (n,) of the axis that moves to each stop in the order of going: back (−1), the axis that led from a
        stop forward."""
        return self.axis if direction > 0 else np.concatenate([self.axis[:1], self.axis[:0:-1]])


def start_corner(machine: Machine, setup: Setup | str) -> np.ndarray:
    """The point where a setup begins, (3,) [m]: a lower corner for a short name."""
    if isinstance(setup, Setup) and setup.way is not None:
        return np.array(setup.way.start)
    setup = path_of(setup if isinstance(setup, str) else setup.name)
    if setup in LINEAR:
        return np.zeros(3)
    return np.array([0.0 if sign == 'p' else length
                     for sign, length in zip(setup, machine.volume, strict=True)])


def setup_direction(machine: Machine, setup: Setup | str) -> np.ndarray:
    """Unit vector ``d`` (3,) along which a setup measures; a short name needs no more than the name."""
    if isinstance(setup, Setup) and setup.way is not None:
        travel = np.array(setup.way.end) - setup.way.start
        return travel / np.linalg.norm(travel)
    setup = path_of(setup if isinstance(setup, str) else setup.name)
    if setup in LINEAR:
        return np.eye(3)['xyz'.index(setup[-1])]
    signs = np.array([1.0 if sign == 'p' else -1.0 for sign in setup])
    travel = signs * np.array(machine.volume)
    return travel / np.linalg.norm(travel)


def local_triad(direction: np.ndarray) -> np.ndarray:
    """Rows ``u, v, d`` (3, 3) of a setup: ``u = ẑ×d/|ẑ×d|`` (``x̂`` where d is ẑ), ``v = d×u``."""
    d = np.asarray(direction, float)
    u = np.cross([0.0, 0.0, 1.0], d)
    norm = np.linalg.norm(u)
    u = np.array([1.0, 0.0, 0.0]) if norm < 1e-12 else u / norm
    return np.array([u, np.cross(d, u), d])


def stops(description: Description, setup: str) -> SetupPath:
    """The stops of ``setup``: a zig-zag of ``3 steps + 1`` stops, a line from the origin, or a way of its own."""
    machine, plan = description.machine, description.plan
    if setup not in description.setups:
        raise StepdiagError(f'setup {setup!r} is not in the cell description; '
                            f'it has {", ".join(description.setups)}')
    given = description.setups[setup]
    if given.way is not None:
        positions, axes = given.way.stops(given.way.steps or plan.steps)
        moved = np.array([NONE, *(NONE if axis < 0 else axis for axis in axes)], np.uint8)
    elif given.is_linear:
        axis = 'xyz'.index(path_of(setup)[-1])
        positions = np.zeros((given.stops, 3))
        positions[:, axis] = np.linspace(0.0, given.length, given.stops)
        moved = np.full(given.stops, axis, np.uint8)
    else:
        n = 3 * plan.steps + 1
        moved = np.resize(['XYZ'.index(letter) for letter in plan.order], n - 1).astype(np.uint8)
        moved = np.concatenate([[NONE], moved])
        counts = np.cumsum(moved[:, None] == np.arange(3), axis=0)
        fraction = counts / plan.steps
        corner = start_corner(machine, setup)
        far = np.where(corner > 0.0, -1.0, 1.0) * np.array(machine.volume)
        positions = corner + fraction * far
        # The corner opposite is reached exactly, whatever the division left over.
        positions = np.where(counts == plan.steps, corner + far, positions)
    moved[0] = NONE
    return SetupPath(positions, moved)


def plan_positions(description: Description, axis: int) -> np.ndarray:
    """The plan's positions of one axis, (steps + 1,) [m]."""
    return np.linspace(0.0, description.machine.volume[axis], description.plan.steps + 1)
