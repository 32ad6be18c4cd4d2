"""One ray meeting one surface, for many poses of the surface at once.

A vector is a tuple of its three components, each a float or an array ``(n,)`` over
poses; they broadcast.  What does not change with the pose (the beam of a fixed laser)
stays a float and costs nothing, and no ``(n, 3)`` temporary is made: that is why these
kernels run at the speed of the bare formula.  All lengths are metres.

Surfaces are given by a point, a normal there (its length is free for the plane, one
elsewhere) and what bends it.  Every kernel returns the distance along the ray, whose
direction has unit length, and the normal at the strike, of any length.

Rounding: a distance ``t`` carries a few units of the last place of the largest length
that went in, 1e-15 m over metres.  The sphere's quadratic is solved in the form without
cancellation, so that a radius of kilometres is as exact as one of millimetres.
"""

from collections.abc import Callable

import numpy as np

Component = float | np.ndarray
Vector = tuple[Component, Component, Component]

NEWTON_STEPS = 30
NEWTON_TOLERANCE = 1e-15
"""[m] of path; a metre in float64 is known to 2e-16."""


def components(vectors: np.ndarray) -> Vector:
    """``(3,)`` → three floats, ``(n, 3)`` → three contiguous ``(n,)``."""
    vectors = np.asarray(vectors, float)
    if vectors.ndim == 1:
        return float(vectors[0]), float(vectors[1]), float(vectors[2])
    x, y, z = np.ascontiguousarray(vectors.T)
    return x, y, z


def stacked(vector: Vector) -> np.ndarray:
    """The inverse of :func:`components`, broadcast: ``(3,)`` or ``(n, 3)``."""
    return np.stack(np.broadcast_arrays(*vector), axis=-1)


def dot(a: Vector, b: Vector) -> Component:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def minus(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def along(origin: Vector, t: Component, direction: Vector) -> Vector:
    """``origin + t·direction``."""
    return (origin[0] + t * direction[0], origin[1] + t * direction[1],
            origin[2] + t * direction[2])


def hit_plane(origin: Vector, direction: Vector, point: Vector,
              normal: Vector) -> tuple[Component, Vector]:
    """Distance to the plane through ``point``; negative behind the ray, infinite if parallel."""
    with np.errstate(divide='ignore', invalid='ignore'):
        return np.divide(dot(minus(point, origin), normal), dot(direction, normal)), normal


def hit_sphere(origin: Vector, direction: Vector, vertex: Vector, normal: Vector,
               curvature: Component) -> tuple[Component, Vector]:
    """Distance to the spherical cap at ``vertex`` whose centre is ``vertex + normal/curvature``.

    ``normal`` is of unit length, ``curvature`` [1/m] may be zero.  With ``r = origin − vertex``
    the sphere is ``c|r + t d|² − 2 (r + t d)·n = 0``, that is ``c t² − 2 G t + F = 0`` with
    ``F = c|r|² − 2 r·n`` and ``G = d·n − c r·d``; the root near the vertex is ``F/(G ± √(G² − c F))``
    with the sign of ``d·n``.  NaN where the ray misses.
    """
    r = minus(origin, vertex)
    cosine = dot(direction, normal)
    f = curvature * dot(r, r) - 2.0 * dot(r, normal)
    g = cosine - curvature * dot(r, direction)
    with np.errstate(invalid='ignore'):
        t = f / (g + np.copysign(np.sqrt(g * g - curvature * f), cosine))
    s = along(r, t, direction)
    return t, (normal[0] - curvature * s[0], normal[1] - curvature * s[1],
               normal[2] - curvature * s[2])


Height = Callable[[Component, Component], Component]
Gradient = Callable[[Component, Component], tuple[Component, Component]]


def hit_height(origin: Vector, direction: Vector, point: Vector, axes: tuple[Vector, Vector, Vector],
               height: Height, gradient: Gradient) -> tuple[Component, Vector]:
    """Distance to the surface ``z = height(x, y)`` over the plane through ``point``.

    ``axes`` are the surface's unit x, y and normal.  Newton's iteration from the plane's strike;
    it is quadratic where the slopes stay below one.  NaN where it does not settle to
    :data:`NEWTON_TOLERANCE`, as for a ray that misses.
    """
    r = minus(origin, point)
    x0, y0, z0 = (dot(r, axis) for axis in axes)
    dx, dy, dz = (dot(direction, axis) for axis in axes)
    with np.errstate(invalid='ignore', divide='ignore', over='ignore'):
        t = np.divide(-z0, dz)
        for _ in range(NEWTON_STEPS):
            x, y = x0 + t * dx, y0 + t * dy
            hx, hy = gradient(x, y)
            step = (z0 + t * dz - height(x, y)) / (dz - hx * dx - hy * dy)
            t = t - step
            # Rounding of t itself bounds what a step can still improve.
            settled = np.abs(step) <= NEWTON_TOLERANCE + 4e-16 * np.abs(t)
            if np.all(settled | ~np.isfinite(step)):
                break
        t = np.where(settled, t, np.nan)
    hx, hy = gradient(x0 + t * dx, y0 + t * dy)
    ex, ey, n = axes
    return t, (n[0] - hx * ex[0] - hy * ey[0], n[1] - hx * ex[1] - hy * ey[1],
               n[2] - hx * ex[2] - hy * ey[2])


def reflect(direction: Vector, normal: Vector) -> Vector:
    """``d − 2 (d·n)/(n·n) n``: no unit normal is needed, so no square root is taken."""
    factor = -2.0 * dot(direction, normal) / dot(normal, normal)
    return along(direction, factor, normal)


def refract(direction: Vector, normal: Vector, before: Component, after: Component) -> Vector:
    """Snell's law in vector form, from index ``before`` to ``after``; NaN on total reflection.

    With ``η = before/after``, unit ``n`` against the ray and ``k = −d·n``:
    ``d' = η d + (η k − √(1 − η² (1 − k²))) n``.
    """
    length = np.sqrt(dot(normal, normal))
    k = -dot(direction, normal) / length
    eta = before / after
    # The root takes the sign of k, which serves a normal along the ray as well.
    with np.errstate(invalid='ignore'):
        root = np.copysign(np.sqrt(1.0 - eta * eta * (1.0 - k * k)), k)
    return along((eta * direction[0], eta * direction[1], eta * direction[2]),
                 (eta * k - root) / length, normal)
