"""Reference lines: which of many equal answers is reported.

A slope of EXY is the same as ``−EC0Y``, one of EXZ as ``EB0Z``, one of EYZ as
``−EA0Z``; and turning the machine with all its setups changes nothing that can be
seen to first order.  As ISO 230-1 has it, a straightness deviation is therefore
counted from its own least-squares reference line and squareness is the angle
between such lines, X's line being the frame's X and Y's line lying in its XY plane:

    EC0Y ← EC0Y − slope(EXY) − slope(EYX)
    EB0Z ← EB0Z + slope(EXZ) + slope(EZX)
    EA0Z ← EA0Z − slope(EYZ) − slope(EZY)

A curve stays zero at position 0 (the line is drawn through that point).  Two
solutions, or a solution and a truth, can be compared after this, and only then.
"""

import numpy as np

from stepdiag_ros.model.machine import CURVES, SQUARENESS, Curve, GeometricErrors

STRAIGHTNESS = ('EYX', 'EZX', 'EXY', 'EZY', 'EXZ', 'EYZ')
SLOPES = {'EC0Y': (('EXY', -1.0), ('EYX', -1.0)),
          'EB0Z': (('EXZ', 1.0), ('EZX', 1.0)),
          'EA0Z': (('EYZ', -1.0), ('EZY', -1.0))}
GAUGE = ('each axis on its line through the lower corner of the volume, the other axes at 0, for the point without '
         'tool: what rotations do over the levers of tool and positions comes on top; positioning (EXX, EYY, EZZ) '
         'along that line, zero at position 0; straightness from least-squares reference lines, zero at position 0; '
         'squareness between those lines; X line along X, Y line in the XY plane (ISO 230-1)')


def slope_weights(position: np.ndarray) -> np.ndarray:
    """Weights (k,) [1/m] whose product with a curve's values is its least-squares slope."""
    centred = np.asarray(position, float) - np.mean(position)
    square = centred @ centred
    return centred / square if square > 0.0 else np.zeros_like(centred)


def to_reference_lines(errors: GeometricErrors) -> GeometricErrors:
    """The same machine, straightness and squareness counted from the reference lines."""
    curves, slopes = {}, {}
    for name, curve in errors.curves.items():
        value = np.asarray(curve.value) - curve.value[0]
        if name in STRAIGHTNESS:
            slopes[name] = float(slope_weights(curve.position) @ value)
            value = value - slopes[name] * (curve.position - curve.position[0])
        curves[name] = Curve(curve.position, value)
    square = {name: errors.square.get(name, 0.0)
              + sum(sign * slopes.get(curve, 0.0) for curve, sign in SLOPES[name])
              for name in SQUARENESS}
    return GeometricErrors(curves, square)


def reporting_matrix(knots: dict[str, np.ndarray], first: dict[str, int],
                     size: int) -> tuple[list[tuple[str, int]], np.ndarray]:
    """Matrix (p, size) from raw unknowns (no squareness among them) to reported values, and its names."""
    names: list[tuple[str, int]] = []
    rows: list[np.ndarray] = []
    slopes: dict[str, np.ndarray] = {}
    for name in CURVES:
        position = knots[name]
        block = np.zeros((len(position), size))
        block[np.arange(1, len(position)), first[name] + np.arange(len(position) - 1)] = 1.0
        if name in STRAIGHTNESS:
            slopes[name] = slope_weights(position) @ block
            block = block - np.outer(position - position[0], slopes[name])
        names += [(name, i) for i in range(len(position))]
        rows += list(block)
    for name in SQUARENESS:
        names.append((name, -1))
        rows.append(sum(sign * slopes[curve] for curve, sign in SLOPES[name]))
    return names, np.array(rows)
