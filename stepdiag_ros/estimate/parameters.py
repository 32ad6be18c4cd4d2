"""The unknowns of the enhanced method, and how they reach each stop.

Raw curves (no squareness: it is a slope of a straightness curve, see
:mod:`stepdiag_ros.estimate.gauge`) at their knots beyond position 0, where they
are zero by definition; a laser and a mirror misalignment for every setup, or the place of its station; one
reset offset for every beam of every run, which is the unknown dead path where a beam follows a retroreflector.

A positioning curve (EXX, EYY, EZZ) has knots at the plan's positions and wherever
a line of that axis stops; the others at the plan's positions only.  A stop between
knots takes part in both neighbours.  Where no way of the log goes by the plan's positions, those
that its ways do go by are the knots: between them nothing is seen.  Nor has a log of less than half of the plan knots
where it never was.
"""

from dataclasses import dataclass, field

import numpy as np
from scipy import sparse

from stepdiag_ros.estimate.reduce import StopTable
from stepdiag_ros.model.description import Description
from stepdiag_ros.model.machine import AXES, CURVES
from stepdiag_ros.model.path import plan_positions, stops

MISALIGNMENTS = ('laser u', 'laser v', 'mirror u', 'mirror v')
STATION = ('station X', 'station Y', 'station Z')
OF_SETUPS = (*MISALIGNMENTS, *STATION)
"""What is unknown of a setup: with a mirror the former, with a station the latter."""
MERGE_M = 1e-6
"""Commanded positions closer than this are one knot."""


@dataclass(frozen=True)
class Parameters:
    """Names and places of the unknowns of one log.

    ``knots``: curve name → (k,) [m], the first being 0.  ``first``: curve name → column of
    its knot 1.  ``setup_first``: setup → column of the first of its ``unknowns``, names out of
    :data:`OF_SETUPS`.  ``offset_first``: column of run 0, beam 0; then row-major [run, beam].
    ``straight``: setups whose beam lies along the motion; ``tilted``: others, in which a detector is
    to show how the mirror tilts.  ``size``: number of columns.
    """

    knots: dict[str, np.ndarray]
    first: dict[str, int]
    setups: tuple[str, ...]
    setup_first: dict[str, int]
    offset_first: int
    runs: int
    beams: int
    straight: frozenset[str] = frozenset()
    tilted: frozenset[str] = frozenset()
    unknowns: dict[str, tuple[str, ...]] = field(default_factory=dict)

    @property
    def size(self) -> int:
        return self.offset_first + self.runs * self.beams

    def slice(self, name: str) -> slice:
        """Columns of a curve's knots 1 … k−1."""
        start = self.first[name]
        return slice(start, start + len(self.knots[name]) - 1)

    def labels(self) -> list[str]:
        """A readable name for every column."""
        labels = [f'{name}[{i}]' for name in CURVES for i in range(1, len(self.knots[name]))]
        labels += [f'{setup} {what}' for setup in self.setups for what in self.unknowns[setup]]
        labels += [f'offset run {run} beam {beam}'
                   for run in range(self.runs) for beam in range(self.beams)]
        return labels


def parameters_of(description: Description, table: StopTable) -> Parameters:
    """Lay out the unknowns for the stops in ``table``."""
    knots: dict[str, np.ndarray] = {}
    linear = np.array([description.setups[s].is_line for s in table.setup_names])
    # A log without diagonals knows nothing between its own stops: its stops are the knots.
    only_linear = bool(linear[table.setup].all())
    used = [s for i, s in enumerate(table.setup_names) if np.any(table.setup == i)]
    ways = _own_ways(description, used)
    for axis, letter in enumerate(AXES):
        plan = plan_positions(description, axis)
        if ways is not None:
            plan = _base(plan, ways[:, axis])
        plan = _met(plan, table.commanded[:, axis])
        own = np.isin(table.setup, [i for i, s in enumerate(table.setup_names)
                                    if description.setups[s].axes == (axis,)])
        extra = np.unique(table.commanded[own, axis])
        for motion in 'XYZABC':
            name = f'E{motion}{letter}'
            if motion == letter and len(extra):
                base = np.array([0.0]) if only_linear else plan
                knots[name] = _merge(np.concatenate([base, extra]))
            else:
                knots[name] = plan
    first, column = {}, 0
    for name in CURVES:
        first[name] = column
        column += len(knots[name]) - 1
    setup_first = {}
    unknowns = {setup: STATION if description.setups[setup].follows else MISALIGNMENTS for setup in used}
    for setup in used:
        setup_first[setup] = column
        column += len(unknowns[setup])
    return Parameters(knots, first, tuple(used), setup_first, column, len(table.run_ids),
                      table.displacement.shape[1], frozenset(s for s in used if description.setups[s].is_straight),
                      frozenset(s for s in used if description.setups[s].sees_tilt
                                and not description.setups[s].is_straight), unknowns)


def _own_ways(description: Description, used: list[str]) -> np.ndarray | None:
    """Where the log's ways stop (n, 3) [m], its lines left away; None where one of them goes by the plan."""
    names = [name for name in used if not description.setups[name].is_line]
    if not names or any(description.setups[name].way is None for name in names):
        return None
    return np.concatenate([np.zeros((1, 3)), *(stops(description, name).positions for name in names)])


def _base(plan: np.ndarray, gone: np.ndarray) -> np.ndarray:
    """Knots (k,) [m] of an axis's curves where the log stops at ``gone``: the plan's, or, gone by otherwise, these."""
    gone = _merge(gone)
    missed = np.abs(gone[:, None] - plan).min(axis=0) > MERGE_M
    # Ways that go only part of the axis leave the rest to the plan.
    whole = abs(gone[0]) <= MERGE_M and abs(gone[-1] - plan[-1]) <= MERGE_M
    return gone if missed.any() and whole and len(gone) > 2 else plan


def _met(plan: np.ndarray, commanded: np.ndarray) -> np.ndarray:
    """Knots (k,) [m]: the plan's, or of a log that holds less than half of them those that it met, and the end.

    What no reading meets would be thousands of unknowns of a small log that was broken off.
    """
    places = _merge(commanded)
    met = np.abs(places[:, None] - plan).min(axis=0) <= MERGE_M
    met[[0, -1]] = True
    return plan if 2 * met.sum() >= len(plan) else plan[met]


def _merge(positions: np.ndarray) -> np.ndarray:
    positions = np.sort(positions)
    return positions[np.concatenate([[True], np.diff(positions) > MERGE_M])]


def curve_matrices(parameters: Parameters, commanded: np.ndarray) -> list[sparse.csr_array]:
    """For each of the 18 motions the matrix (n, size) that takes the unknowns to its value at each stop.

    Order as :data:`~stepdiag_ros.model.machine.CURVES`.
    """
    n = len(commanded)
    matrices = []
    for place, name in enumerate(CURVES):
        knots, position = parameters.knots[name], commanded[:, place // 6]
        lower = np.clip(np.searchsorted(knots, position + MERGE_M) - 1, 0, len(knots) - 2)
        part = (position - knots[lower]) / (knots[lower + 1] - knots[lower])
        part = np.clip(part, 0.0, 1.0)
        part[np.abs(position - knots[lower]) < MERGE_M] = 0.0
        part[np.abs(position - knots[lower + 1]) < MERGE_M] = 1.0
        columns = np.concatenate([lower, lower + 1]) - 1
        weights = np.concatenate([1.0 - part, part])
        rows = np.tile(np.arange(n), 2)
        keep = (weights != 0.0) & (columns >= 0)
        matrices.append(sparse.csr_array(
            (weights[keep], (rows[keep], parameters.first[name] + columns[keep])),
            shape=(n, parameters.size)))
    return matrices
