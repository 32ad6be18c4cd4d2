"""A small machine with errors of all 21 kinds, for the component alone and in LinuxCNC."""

import numpy as np

from stepdiag_ros.model.machine import CURVES, SQUARENESS, Curve, GeometricErrors

TRAVEL, TOOL, ORIGIN = (0.2, 0.16, 0.12), (0.01, -0.02, -0.12), (0.05, -0.03, -0.15)


def drawn_errors(seed: int = 7, size: float = 8.0e-6, angle: float = 2.0e-5) -> GeometricErrors:
    """Errors of the size given [m, rad], each axis's curves at knots of their own number."""
    rng = np.random.default_rng(seed)
    curves = {}
    for name in CURVES:
        knots = np.linspace(0.0, TRAVEL['XYZ'.index(name[2])], 5 + 'XYZ'.index(name[2]))
        value = rng.normal(size=knots.size) * (angle if name[1] in 'ABC' else size)
        curves[name] = Curve(knots, value - value[0])
    return GeometricErrors(curves, {name: angle * rng.normal() for name in SQUARENESS})
