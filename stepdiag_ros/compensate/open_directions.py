"""Which errors a log leaves open, so that no table may be made of them, and the run that would settle them.

Open is what a solution names as unidentifiable, and what owes most of its variance to what is named: without
linear setups the slopes of EYY and EZZ are named, and the slope of EXX follows from theirs.  An error that no
reading depends on (the Y axis of a log of X) is not open but not measured: nothing is made of it either.
"""

import re
from dataclasses import dataclass, replace

import numpy as np

from stepdiag_ros.estimate.gauge import STRAIGHTNESS
from stepdiag_ros.estimate.solution import Solution
from stepdiag_ros.model.description import LINEAR, path_of
from stepdiag_ros.model.machine import AXES, CURVES, SQUARENESS

OWED = 0.5
"""Share of an error's variance that named open directions explain, from which it is open with them."""


@dataclass(frozen=True)
class Openness:
    """``unmeasured`` names, ``open`` names, and in ``runs`` what would settle the open ones, in words."""

    unmeasured: tuple[str, ...]
    open: tuple[str, ...]
    runs: tuple[str, ...]


def openness(solution: Solution) -> Openness:
    """What ``solution`` leaves open; needs nothing but what it reports."""
    absent = [name for name in CURVES if not solution.has(name) or len(solution.positions[name]) < 2]
    absent += [name for name in SQUARENESS if not solution.has(name)]
    if solution.misalignments and all(path_of(setup) in LINEAR for setup in solution.misalignments):
        # A line tells how far an axis goes (and how it turns), not how straight or square.
        absent += [*STRAIGHTNESS, *SQUARENESS]
    named = []
    for entry in solution.unidentifiable:
        errors = [error for error in map(_error, entry.names) if error]
        if len(entry.names) == 1 and 'no reading' in entry.why:
            absent += errors
        else:
            named += errors
    named = [name for name in dict.fromkeys(named) if name not in absent]
    found = [name for name in CURVES + SQUARENESS
             if name not in absent and (name in named or _owes(solution, name, named))]
    return Openness(tuple(dict.fromkeys(absent)), tuple(found), tuple(dict.fromkeys(map(_settling, found))))


def _error(label: str) -> str:
    """The error that a label of the solution means; '' for a beam or mirror."""
    match = re.fullmatch(r'(E[XYZABC][XYZ]|EC0Y|EB0Z|EA0Z)( slope)?', label)
    return match[1] if match else ''


def _last(solution: Solution, name: str) -> int:
    """Row of an error's value at its far end, or of a squareness error."""
    return max(i for i, (n, _) in enumerate(solution.names) if n == name)


def _owes(solution: Solution, name: str, named: list[str]) -> bool:
    """Whether the named errors explain most of the variance of ``name``."""
    if not named:
        return False
    rows, own = [_last(solution, n) for n in named], _last(solution, name)
    # Of the repeats: a scale or a tool that the budget knows little of ties errors together that no log could part.
    covariance = solution.covariance if solution.repeatability is None else solution.repeatability
    own_variance = covariance[own, own]
    if own_variance <= 0.0:
        return False
    cross = covariance[own, rows]
    explained = cross @ np.linalg.pinv(covariance[np.ix_(rows, rows)]) @ cross
    return bool(explained > OWED * own_variance)


def _settling(name: str) -> str:
    if name in SQUARENESS:
        return 'all four body diagonals (ppp, npp, pnp, nnp) settle squareness'
    if name[1] == name[2]:
        return f'a linear setup lin_{name[2].lower()} settles {name}'
    if name[1] in AXES:
        return 'a further body diagonal settles the straightness'
    return 'diagonals with the tilt channel (PSD, or three beams) settle the rotations'


def unknown(solution: Solution, names: tuple[str, ...]) -> Solution:
    """The solution with nothing said of the errors ``names``: of value zero, their uncertainty as it is."""
    return replace(solution, value=np.where([name in names for name, _ in solution.names], 0.0, solution.value))


def without(solution: Solution, names: tuple[str, ...]) -> Solution:
    """The solution as if it had never held the errors ``names``."""
    kept = [i for i, (name, _) in enumerate(solution.names) if name not in names]
    repeats = solution.repeatability
    return replace(solution, names=tuple(solution.names[i] for i in kept), value=solution.value[kept],
                   covariance=solution.covariance[np.ix_(kept, kept)],
                   repeatability=None if repeats is None else repeats[np.ix_(kept, kept)],
                   positions={name: p for name, p in solution.positions.items() if name not in names})
