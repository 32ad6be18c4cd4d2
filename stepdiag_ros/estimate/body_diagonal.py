"""Body and face diagonal displacement, ISO 230-6:2002 and ASME B5.54-2005.

A retroreflector (or the corner stops of a step diagonal) is moved along each
diagonal, the interferometer looks along it, and the deviation from the commanded
length is read at equidistant targets, forward and backward, several times.  Per
diagonal, with means over the runs of one direction,

    E = max(x̄↑, x̄↓) − min(x̄↑, x̄↓),     B_i = x̄_i↑ − x̄_i↓,     B = max |B_i|

and for the machine ``Ed = max E``, ``Bd = max B``.

Derivation of what it sees.  For small errors the reading is the deviation of the
tool point projected on the diagonal, ``x = δp · d``.  Angular motions move the
point across the line from the axis to the point; where that line is the diagonal
itself, they drop out.

Assumes: the laser is aligned to the diagonal (a cosine error otherwise), runs are
comparable.  Cannot see: which error is at work, and opposite errors at all.  An
over-travel of one axis against an under-travel of another leaves the diagonal as
long as it was (Chapman's examples, reproduced in the tests), so neither Ed nor a
compensation follows for the volume.  B5.54-2005 asks for linear tests beside it.

Source: ISO 230-6:2002; ASME B5.54-2005 as described in Renishaw, *Laser diagonal
measurements for machine tool performance assessment*, 2016; Wang & Liotto 2003,
eqs. 1–4.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.iso_rules import shortfalls
from stepdiag_ros.estimate.readings import CellReadings
from stepdiag_ros.estimate.traceability import Traceability
from stepdiag_ros.model.description import DIAGONALS, Machine, Setup
from stepdiag_ros.model.machine import GeometricErrors, tool_pose
from stepdiag_ros.model.path import setup_direction, start_corner


@dataclass(frozen=True)
class DiagonalResult:
    """One diagonal: ``position_m`` (n,) along it, mean deviations (n,) [m], E and B [m].

    ``backward_m``, ``reversal_m`` and ``B`` are None where only one direction was run.
    """

    position_m: np.ndarray
    forward_m: np.ndarray
    backward_m: np.ndarray | None
    E: float

    @property
    def reversal_m(self) -> np.ndarray | None:
        return None if self.backward_m is None else self.forward_m - self.backward_m

    @property
    def B(self) -> float | None:
        return None if self.backward_m is None else float(np.max(np.abs(self.reversal_m)))

    def to_json_dict(self) -> dict[str, Any]:
        lists = {'position_m': self.position_m, 'forward_m': self.forward_m,
                 'backward_m': self.backward_m, 'reversal_m': self.reversal_m}
        return {'E_m': self.E, 'B_m': self.B,
                **{key: None if v is None else [float(x) for x in v] for key, v in lists.items()}}


@dataclass(frozen=True)
class DiagonalTest:
    """All diagonals of a machine by name, and the worst of them.

    ``sigma_m``: standard uncertainty [m] of each of :meth:`figures` by the whole budget, empty where not computed.
    ``travel_m``: (3,) of the axes from end to end, by name; the volume's where nothing is said.  ``cycles`` of each
    diagonal, by name, where they were counted.  ``cautions``: what its figures do not show, a sentence each.
    """

    diagonals: Mapping[str, DiagonalResult]
    method: str = 'body_diagonal'
    sigma_m: Mapping[str, float] = field(default_factory=dict)
    traceability: Traceability | None = None
    travel_m: Mapping[str, np.ndarray] = field(default_factory=dict)
    cycles: Mapping[str, int] = field(default_factory=dict)
    cautions: tuple[str, ...] = ()

    @property
    def remarks(self) -> tuple[str, ...]:
        """What the test falls short of, and its cautions, a sentence each."""
        return (*(text for name, cycles in self.cycles.items()
                  for text in shortfalls(name, self.diagonals[name].position_m, cycles, diagonal=True)), *self.cautions)

    def figures(self) -> dict[str, float]:
        """E and B of each diagonal and of the worst [m], by name; without those that were not measured."""
        named = {f'{letter} {name}': value for name, r in self.diagonals.items()
                 for letter, value in (('E', r.E), ('B', r.B))} | {'Ed': self.Ed, 'Bd': self.Bd}
        return {name: value for name, value in named.items() if value is not None}

    def repeat_sigma(self, cell: CellReadings) -> dict[str, float]:
        """Standard uncertainty [m] of the figures by repeats: differences of two means of one direction each."""
        own = {name: 2.0 * float(cell.setups[name].displacement_sigma_m.max()) for name in self.diagonals}
        return {name: own.get(name[2:], max(own.values())) for name in self.figures()}

    def slope_sigma(self, slopes: Mapping[str, np.ndarray], machine: Machine) -> dict[str, float]:
        """What uncertain slopes (k,) [1] of EXX, EYY, EZZ do to each E [m]."""
        def effect(travel: np.ndarray | tuple[float, ...]) -> float:
            length = np.linalg.norm(travel)
            return float(np.linalg.norm([float(np.linalg.norm(slopes.get(f'E{a}{a}', 0.0))) * travel[i]**2 / length
                                         for i, a in enumerate('XYZ')]))
        own = {name: effect(self.travel_m.get(name, machine.volume)) for name in self.diagonals}
        return {name: own.get(name[2:], max(own.values())) for name in self.figures() if name[0] == 'E'}

    @property
    def Ed(self) -> float:
        return max(r.E for r in self.diagonals.values())

    @property
    def Bd(self) -> float | None:
        known = [r.B for r in self.diagonals.values() if r.B is not None]
        return max(known) if known else None

    def text(self) -> str:
        """For people, µm."""
        lines = [f'{self.method}: ISO 230-6 / ASME B5.54', '', f'{"":6} {"E [µm]":>9}  U (k=2) {"B [µm]":>9}  U (k=2)']
        figures = self.figures()
        for name in (*self.diagonals, 'worst'):
            keys = ('Ed', 'Bd') if name == 'worst' else (f'E {name}', f'B {name}')
            cells = [_micrometres(factor, values.get(key))
                     for key in keys for factor, values in ((1e6, figures), (2e6, self.sigma_m))]
            lines.append(f'{name:6} {cells[0]:>9} {cells[1]:>8} {cells[2]:>9} {cells[3]:>8}')
        return '\n'.join(lines)

    @property
    def status(self) -> str:
        """``ok``, or that the lengths are no metres."""
        return 'ok' if self.traceability is None else self.traceability.status

    def to_json_dict(self) -> dict[str, Any]:
        tied = self.traceability
        return {'method': self.method, 'status': self.status, 'Ed_m': self.Ed,
                'Bd_m': self.Bd, 'sigma_m': dict(self.sigma_m), 'remarks': list(self.remarks),
                'traceability': None if tied is None else tied.to_json_dict(),
                'diagonals': {n: r.to_json_dict() for n, r in self.diagonals.items()}}


def _micrometres(factor: float, value: float | None) -> str:
    return '–' if value is None else f'{factor * value:.3f}'


def diagonal(position_m: np.ndarray, forward_m: np.ndarray,
             backward_m: np.ndarray | None = None) -> DiagonalResult:
    """E and B of one diagonal.

    ``position_m`` (n,); ``forward_m`` (runs, n) or (n,) deviations of the forward runs [m],
    ``backward_m`` likewise at the same targets in the same order, or None.
    """
    position = np.asarray(position_m, float)
    means = []
    for name, runs in (('forward', forward_m), ('backward', backward_m)):
        if runs is None:
            means.append(None)
            continue
        runs = np.atleast_2d(np.asarray(runs, float))
        if runs.shape[1] != position.size:
            raise StepdiagError(f'body_diagonal: {name} runs have {runs.shape[1]} targets, '
                                f'positions {position.size}; give one deviation per target')
        if not np.isfinite(runs).all():
            raise StepdiagError(f'body_diagonal: a deviation of the {name} runs is not a number; '
                                'leave incomplete runs out')
        means.append(runs.mean(axis=0))
    forward, backward = means
    both = forward if backward is None else np.concatenate([forward, backward])
    return DiagonalResult(position, forward, backward, float(np.ptp(both)))


def deviations_of(errors: GeometricErrors, machine: Machine, setup: Setup | str,
                  targets: int) -> tuple[np.ndarray, np.ndarray]:
    """What the test reads on a known machine: target positions (n,) and deviations (n,) [m].

    A retroreflector returns the beam whatever its tilt and has no lever: the length is that
    from the start projected on the nominal diagonal.
    """
    start, d = start_corner(machine, setup), setup_direction(machine, setup)
    way = setup.way if isinstance(setup, Setup) else None
    length = np.linalg.norm(machine.volume if way is None else np.subtract(way.end, way.start))
    along = np.linspace(0.0, length, targets)
    commanded = start + along[:, None] * d
    point, _ = tool_pose(errors, commanded, machine.tool, machine.chain)
    deviation = (point - commanded - np.array(machine.tool)) @ d
    return along, deviation - deviation[0]


def worst_deviation(errors: GeometricErrors, machine: Machine, points: int = 11) -> float:
    """Length [m] of the longest deviation vector on a grid, referred to the machine's origin."""
    axes = [np.linspace(0.0, length, points) for length in machine.volume]
    grid = np.stack(np.meshgrid(*axes, indexing='ij'), axis=-1).reshape(-1, 3)
    point, _ = tool_pose(errors, grid, machine.tool, machine.chain)
    deviation = point - grid
    return float(np.max(np.linalg.norm(deviation - deviation[0], axis=1)))


def diagonal_length(errors: GeometricErrors, machine: Machine, setup: str) -> float:
    """Distance [m] between the two end corners of a body diagonal, nothing linearised."""
    start = start_corner(machine, setup)
    end = np.array(machine.volume) - start
    end[2] = machine.volume[2]
    point, _ = tool_pose(errors, np.stack([start, end]), machine.tool, machine.chain)
    return float(np.linalg.norm(point[1] - point[0]))


def evaluate_runs(runs: Mapping[str, tuple[np.ndarray, np.ndarray, np.ndarray | None]]) -> DiagonalTest:
    """All diagonals: name → (positions, forward runs, backward runs or None)."""
    unknown = [name for name in runs if name not in DIAGONALS]
    if unknown or not runs:
        raise StepdiagError(f'body_diagonal: need diagonals out of {", ".join(DIAGONALS)}; '
                            f'got {", ".join(unknown) or "none"}')
    return DiagonalTest({name: diagonal(*given) for name, given in runs.items()},
                        cycles={name: cycles_of(*given[1:]) for name, given in runs.items()})


def cycles_of(forward: np.ndarray, backward: np.ndarray | None) -> int:
    """Number of cycles of the runs (r, n) of each direction, or of the one direction that was run."""
    counts = [len(np.atleast_2d(runs)) for runs in (forward, backward) if runs is not None and len(runs)]
    return min(counts)
