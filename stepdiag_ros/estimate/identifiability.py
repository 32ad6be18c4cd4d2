"""What the data leave open, by name.

A direction counts as unidentifiable where the data narrow its prior (see
:mod:`stepdiag_ros.estimate.enhanced`) by less than half.  Judged are the reported
errors, with each curve split into its slope and its shape, and the misalignments.
Errors that no reading depends on are named alone; of what remains, the open
directions are brought to echelon form, so that each names as few things as it can.
"""

import numpy as np

from stepdiag_ros.estimate.eigen import eigen
from stepdiag_ros.estimate.parameters import STATION, Parameters
from stepdiag_ros.estimate.solution import Unidentifiable
from stepdiag_ros.model.machine import CURVES, SQUARENESS

OPEN = 0.25
"""Share of the prior variance left by the data above which a direction is open."""
LOOSE = 1e-4
"""Standard uncertainty [m, rad] of a single error above which it is open too: readings that depend on it to second
order only narrow a millimetre to a tenth of one, which is no measurement."""
LOOSELY = 'the readings depend on it to second order only; its uncertainty is larger than such an error of any machine'
NAMED = 0.25
"""Weight, against the greatest of a direction, from which a name takes part in it."""


def unidentifiable(parameters: Parameters, names: list[tuple[str, int]], reporting: np.ndarray,
                   covariance: np.ndarray, precision: np.ndarray,
                   information: np.ndarray) -> tuple[Unidentifiable, ...]:
    """Open directions of a fit.

    ``reporting`` (p, size) takes unknowns to reported values called ``names``; ``covariance``,
    ``precision`` (of the prior) and ``information`` (of the data) are (size, size).
    """
    labels, rows = _features(parameters, names, reporting)
    sigma = np.sqrt(np.einsum('ij,jk,ik->i', rows, np.linalg.inv(precision), rows))
    seen = np.einsum('ij,jk,ik->i', rows, information, rows) / np.sum(rows**2, axis=1)
    blind = seen * sigma**2 < 1e-9
    found = [Unidentifiable((label,), 'no reading of this log depends on it')
             for label, is_blind in zip(labels, blind, strict=True) if is_blind]
    named = {label for label, is_blind in zip(labels, blind, strict=True) if is_blind}
    rows, sigma = rows[~blind], sigma[~blind]
    labels = [label for label, is_blind in zip(labels, blind, strict=True) if not is_blind]
    if len(labels):
        scaled = rows / sigma[:, None]
        share, vectors = eigen(scaled @ covariance @ scaled.T)
        for direction in _echelon(vectors[:, share > OPEN].T):
            weight = np.abs(direction)
            members = tuple(dict.fromkeys(
                labels[i] for i in np.argsort(-weight, kind='stable')
                if weight[i] > NAMED * weight.max()))
            found.append(Unidentifiable(members, _why(members, parameters.straight)))
            named.update(members)
        loose = np.sqrt(np.einsum('ij,jk,ik->i', rows, covariance, rows)) > LOOSE
        errors = {name for name, _ in names}
        found += [Unidentifiable((label,), LOOSELY) for label, is_loose in zip(labels, loose, strict=True)
                  if is_loose and label not in named and label.split()[0] in errors]
    unique = {tuple(sorted(entry.names)): entry for entry in found}
    return tuple(unique.values())


def _features(parameters: Parameters, names: list[tuple[str, int]],
              reporting: np.ndarray) -> tuple[list[str], np.ndarray]:
    """Labels and rows (f, size) of what is judged."""
    labels, rows = [], []
    for name in CURVES:
        block = reporting[[i for i, (n, k) in enumerate(names) if n == name and k > 0]]
        position = parameters.knots[name][1:]
        if not len(position):
            continue   # an axis that did not move: a log that was cut short
        slope = position @ block / (position @ position)
        labels.append(f'{name} slope')
        rows.append(slope * position[-1])
        if len(position) > 1:
            shape = block - np.outer(position, slope)
            middle = shape[np.argmax(np.sum(shape**2, axis=1))]
            if np.any(middle):
                labels.append(name)
                rows.append(middle)
    for name in SQUARENESS:
        labels.append(name)
        rows.append(reporting[names.index((name, -1))])
    for setup in parameters.setups:
        for k, what in enumerate(parameters.unknowns[setup]):
            labels.append(f'{setup} {what}')
            alone = np.zeros(parameters.size)
            alone[parameters.setup_first[setup] + k] = 1.0
            rows.append(alone)
    rows = np.array(rows)
    # Of a straightness curve the slope is the reference line: nothing is left of it to judge.
    real = np.sum(rows**2, axis=1) > 1e-20
    return [label for label, keep in zip(labels, real, strict=True) if keep], rows[real]


def _echelon(directions: np.ndarray) -> np.ndarray:
    """Reduced row echelon form with the greatest pivots: sparse combinations of the same space."""
    rows = directions.copy()
    for i in range(len(rows)):
        pivot = np.unravel_index(np.argmax(np.abs(rows[i:])), rows[i:].shape)
        rows[[i, i + pivot[0]]] = rows[[i + pivot[0], i]]
        rows[i] /= rows[i, pivot[1]]
        others = np.arange(len(rows)) != i
        rows[others] -= np.outer(rows[others, pivot[1]], rows[i])
    return rows


def _why(members: tuple[str, ...], straight: frozenset[str]) -> str:
    kinds = {member.split()[-2] if ' laser ' in member or ' mirror ' in member else 'error'
             for member in members}
    if all(member.split()[0] in straight for member in members):
        return ('a beam that is not along its line lengthens the readings to second order only (cosine '
                'error); its prior is part of the uncertainty of the positioning errors')
    if kinds == {'laser'} or kinds == {'laser', 'mirror'}:
        return ('turning these together with the machine changes the readings to second order only; '
                'the reported errors do not depend on the choice')
    if any(member.endswith(STATION) for member in members):
        return ('moving the station and changing these errors together leaves the readings as they are; a further '
                'station whose beams cross these, or another tool vector, would separate them')
    if len(members) == 1:
        return 'the readings depend on it too little to narrow it down'
    return ('the readings depend on their combination only; a linear setup of each axis, a further '
            'diagonal or the tilt channel would separate them')
