"""What a control takes off a machine's errors, whatever its tables look like.

A table of an axis, read as its control applies it, is an error motion that the control takes off: the screw
table of X takes off an EXX, the sag table of Y by X an EYX, a volumetric model rotations as well.  So a set of
tables is a set of curves by their names of ISO 230-1, at positions in the volume's own coordinates; forward and
reverse differ by what a table does about the reversal of its axis.

The deviation of a machine is linear in its errors but for products of errors (a nanometre and less), so what is
left of a machine under its tables is the machine whose errors are the difference.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from stepdiag_ros.estimate.gauge import SLOPES, STRAIGHTNESS, slope_weights
from stepdiag_ros.model.machine import CURVES, SQUARENESS, Curve, GeometricErrors

SAME_PLACE_M = 1e-9
"""Positions closer than this are one."""


@dataclass(frozen=True)
class Trim:
    """An error motion that is taken off: at ``position`` (k,) [m], rising, ``forward`` and ``reverse`` (k,) [m or rad].

    ``forward`` counts where the axis was approached in its positive direction.  Straight between positions,
    constant outside.
    """

    position: np.ndarray
    forward: np.ndarray
    reverse: np.ndarray

    @property
    def mean(self) -> np.ndarray:
        return 0.5 * (self.forward + self.reverse)

    def at(self, position: np.ndarray) -> 'Trim':
        """The same at other positions (n,) [m]."""
        return Trim(np.asarray(position, float), np.interp(position, self.position, self.forward),
                    np.interp(position, self.position, self.reverse))


Taken = Mapping[str, Trim]
"""What a control takes off, by the names of ISO 230-1 (``EXX`` … ``ECZ``)."""


def nothing(taken: Taken) -> bool:
    """Whether nothing is taken off."""
    return not any(np.any(trim.forward) or np.any(trim.reverse) for trim in taken.values())


def places(*sets: Iterable[float]) -> np.ndarray:
    """All positions [m] of several curves in rising order, each once."""
    merged = np.unique(np.concatenate([np.asarray(s, float).ravel() for s in sets]))
    return merged[np.concatenate([[True], np.diff(merged) > SAME_PLACE_M])]


def added(one: Taken, other: Taken) -> dict[str, Trim]:
    """The sum of two sets."""
    total = dict(one)
    for name, trim in other.items():
        if name in total:
            position = places(total[name].position, trim.position)
            a, b = total[name].at(position), trim.at(position)
            trim = Trim(position, a.forward + b.forward, a.reverse + b.reverse)
        total[name] = trim
    return total


def scaled(taken: Taken, factor: float) -> dict[str, Trim]:
    """Every value times ``factor``."""
    return {name: Trim(t.position, factor * t.forward, factor * t.reverse) for name, t in taken.items()}


def difference(one: Taken, other: Taken) -> dict[str, Trim]:
    """``one`` less ``other``: what changes when ``other`` is replaced by ``one``."""
    return added(one, scaled(other, -1.0))


def errors_of(taken: Taken) -> GeometricErrors:
    """What is taken off as the errors of a machine, the mean of both directions of approach."""
    return GeometricErrors({name: Curve(trim.position, trim.mean) for name, trim in taken.items()}, {})


def left_of(errors: GeometricErrors, taken: Taken) -> GeometricErrors:
    """The machine that is left when a control takes ``taken`` off ``errors``; same frame, same origin."""
    curves = dict(errors.curves)
    for name, trim in taken.items():
        known = curves.get(name)
        position = trim.position if known is None else places(known.position, trim.position)
        value = np.zeros(len(position)) if known is None else known(position)
        curves[name] = Curve(position, value - np.interp(position, trim.position, trim.mean))
    return GeometricErrors(curves, errors.square)


def as_measured(errors: GeometricErrors, positions: Mapping[str, np.ndarray]) -> GeometricErrors:
    """What an evaluation at ``positions`` would report of a machine: curves there, zero at the first, reference lines.

    As :func:`stepdiag_ros.estimate.gauge.to_reference_lines`, for curves that have more knots than the evaluation.
    """
    curves, slopes = {}, {}
    for name in CURVES:
        if name not in positions or name not in errors.curves:
            continue
        position = np.asarray(positions[name], float)
        value = errors.curves[name](position)
        value = value - value[0]
        if name in STRAIGHTNESS:
            slopes[name] = float(slope_weights(position) @ value)
            value = value - slopes[name] * (position - position[0])
        curves[name] = Curve(position, value)
    square = {name: errors.square.get(name, 0.0)
              + sum(sign * slopes.get(curve, 0.0) for curve, sign in SLOPES[name]) for name in SQUARENESS}
    return GeometricErrors(curves, square)
