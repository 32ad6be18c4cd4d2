"""What each part of a log contributed to a joint estimate: what would be less known, or open, without it.

A part is all setups of one kind.  Runs are weighed independently, so that the information of a part adds to that of
the others, ``C⁻¹ = P + Σ N_part``; without it the covariance is that of the other parts and the priors P, at the
solution found with it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from stepdiag_ros.estimate.dense import factored, inverse, normal_equations
from stepdiag_ros.estimate.enhanced import Fit
from stepdiag_ros.estimate.gauge import reporting_matrix
from stepdiag_ros.estimate.identifiability import LOOSE
from stepdiag_ros.estimate.reduce import StopTable
from stepdiag_ros.model.description import Description

MORE = 1.1
"""An error whose standard uncertainty would be so many times as large owes something to a part."""


@dataclass(frozen=True)
class Contribution:
    """One part: its ``kind``, ``setups``, number of ``readings`` and ``rms`` of their whitened residuals (1: as noise).

    ``narrowed``: error → by which factor its standard uncertainty (by repeats, at its worst place) would be larger
    without the part, where that is more than :data:`MORE`; ``settled``: errors that would be open without it.
    """

    kind: str
    setups: tuple[str, ...]
    readings: int
    rms: float
    narrowed: dict[str, float]
    settled: tuple[str, ...]

    def to_json_dict(self) -> dict[str, Any]:
        return {'kind': self.kind, 'setups': list(self.setups), 'readings': self.readings, 'rms_residual': self.rms,
                'narrowed': self.narrowed, 'settled': list(self.settled)}


def contributions(description: Description, table: StopTable, result: Fit) -> tuple[Contribution, ...]:
    """The parts of a log in the order of measuring; empty where it has but one."""
    kinds: dict[str, list[int]] = {}
    for number in dict.fromkeys(table.setup.tolist()):
        kinds.setdefault(description.setups[table.setup_names[number]].kind, []).append(number)
    if len(kinds) < 2:
        return ()
    parameters, channels = result.parameters, result.present.shape[1]
    names, reporting = reporting_matrix(parameters.knots, parameters.first, parameters.size)
    sigma = _sigma(reporting, result.covariance)
    filled, found = np.where(result.present, result.residual, 0.0).ravel(), []
    for kind, numbers in kinds.items():
        white, others = [], []
        for one in result.whiteners:
            (white if table.setup[one.rows[0] // channels] in numbers else others).append(one)
        # The others' sum: taking a part off the whole would lose every digit of what it alone shows.
        rest = normal_equations(result.jacobian, others) + result.precision
        without = _sigma(reporting, inverse(*factored(rest)))
        narrowed, settled = {}, []
        for name in dict.fromkeys(name for name, _ in names):
            rows = [i for i, (n, _) in enumerate(names) if n == name]
            before, after = float(without[rows].max()), float(sigma[rows].max())
            if before > LOOSE >= after:
                settled.append(name)
            elif after > 0.0 and before > MORE * after and after <= LOOSE:
                narrowed[name] = before / after
        count = sum(len(w.rows) for w in white)
        squares = sum(float(np.sum(w(filled)**2)) for w in white)
        found.append(Contribution(kind, tuple(table.setup_names[n] for n in numbers), count,
                                  float(np.sqrt(squares / max(count, 1))), narrowed, tuple(settled)))
    return tuple(found)


def _sigma(reporting: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    return np.sqrt(np.maximum(np.einsum('ij,jk,ik->i', reporting, covariance, reporting), 0.0))


def contribution_words(part: Contribution) -> str:
    """One part in a sentence."""
    said = []
    if part.settled:
        said.append(f'without it open: {", ".join(part.settled)}')
    if part.narrowed:
        most = sorted(part.narrowed, key=lambda name: -part.narrowed[name])
        said.append('without it less certain: ' + ', '.join(f'{name} {part.narrowed[name]:.3g}×' for name in most))
    return '; '.join(said) or 'every error is known as well without it'


def listed(parts: Sequence[Contribution]) -> list[str]:
    """A line for each part."""
    return [f'{part.kind} ({", ".join(part.setups)}): {part.readings} readings, residuals {part.rms:.2f} times the '
            f'noise; {contribution_words(part)}' for part in parts]
