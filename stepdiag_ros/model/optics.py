"""An optical scene: an ambient medium, homogeneous bodies, beams that refract and reflect.

Nothing here knows of machines or step diagonals.  A beam is followed in two stages.
:meth:`Scene.find_path` walks one ray through the scene without being told an order (nearest
surface first, the medium being the body that the ray is in) and notes what it met.
:meth:`Scene.trace` then sends the rays of all poses down that list with the vectorised kernels
of :mod:`stepdiag_ros.model.rays`.  A ray of a pose that cannot follow the list (it misses, leaves an
aperture, is totally reflected where the first was not) comes out as NaN, never as a number
for another path.

Vectors of surfaces and beams are component tuples (:func:`~stepdiag_ros.model.rays.components`),
constant or over poses.  Optical path is the sum of index times length [m].
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from stepdiag_ros.model.rays import (
    Component,
    Gradient,
    Height,
    Vector,
    along,
    dot,
    hit_height,
    hit_plane,
    hit_sphere,
    minus,
    reflect,
    refract,
)

Action = Literal['reflect', 'refract', 'stop']

START_GAP = 1e-12
"""[m]: a strike nearer than this is the surface that the ray has just left."""


def _at(vector: Vector, pose: int) -> Vector:
    x, y, z = (float(c[pose]) if np.ndim(c) else float(c) for c in vector)
    return x, y, z


@dataclass(frozen=True)
class Plane:
    """A flat surface through ``point``; ``normal`` points out of its body, of any length.

    ``aperture`` [m] is the radius about ``point`` that the surface reaches, ``None`` without end.
    """

    point: Vector
    normal: Vector
    aperture: float | None = None

    def hit(self, origin: Vector, direction: Vector) -> tuple[Component, Vector]:
        return hit_plane(origin, direction, self.point, self.normal)

    def outside(self, point: Vector) -> Component:
        """[m·|normal|] above zero on the side that the normal points to."""
        return dot(minus(point, self.point), self.normal)

    def at(self, pose: int) -> 'Plane':
        return replace(self, point=_at(self.point, pose), normal=_at(self.normal, pose))


@dataclass(frozen=True)
class Sphere:
    """A spherical cap at ``point`` with unit outward ``normal`` and centre ``point + normal/curvature``.

    A positive ``curvature`` [1/m] is hollow as seen from outside, a negative one bulges.
    """

    point: Vector
    normal: Vector
    curvature: Component
    aperture: float | None = None

    def hit(self, origin: Vector, direction: Vector) -> tuple[Component, Vector]:
        return hit_sphere(origin, direction, self.point, self.normal, self.curvature)

    def outside(self, point: Vector) -> Component:
        r = minus(point, self.point)
        return dot(r, self.normal) - 0.5 * self.curvature * dot(r, r)

    def at(self, pose: int) -> 'Sphere':
        curvature = self.curvature
        return replace(self, point=_at(self.point, pose), normal=_at(self.normal, pose),
                       curvature=float(curvature[pose]) if np.ndim(curvature) else curvature)


@dataclass(frozen=True)
class HeightSurface:
    """A surface ``height(x, y)`` [m] above the plane through ``point``, along the outward normal.

    ``axes`` are unit vectors x, y, outward normal; ``gradient(x, y)`` gives both slopes.
    """

    point: Vector
    axes: tuple[Vector, Vector, Vector]
    height: Height
    gradient: Gradient
    aperture: float | None = None

    def hit(self, origin: Vector, direction: Vector) -> tuple[Component, Vector]:
        return hit_height(origin, direction, self.point, self.axes, self.height, self.gradient)

    def outside(self, point: Vector) -> Component:
        x, y, z = (dot(minus(point, self.point), axis) for axis in self.axes)
        return z - self.height(x, y)

    def at(self, pose: int) -> 'HeightSurface':
        x, y, n = (_at(axis, pose) for axis in self.axes)
        return replace(self, point=_at(self.point, pose), axes=(x, y, n))


Surface = Plane | Sphere | HeightSurface


@dataclass(frozen=True)
class Body:
    """A homogeneous body bounded by ``surfaces`` (where several, their common inside).

    ``kind`` glass refracts with ``index``, mirror reflects at its surface, detector ends the ray.
    """

    name: str
    kind: Literal['glass', 'mirror', 'detector']
    surfaces: tuple[Surface, ...]
    index: Component = 1.0

    @classmethod
    def glass(cls, name: str, index: Component, *surfaces: Surface) -> 'Body':
        return cls(name, 'glass', surfaces, index)

    @classmethod
    def mirror(cls, name: str, *surfaces: Surface) -> 'Body':
        return cls(name, 'mirror', surfaces)

    @classmethod
    def detector(cls, name: str, *surfaces: Surface) -> 'Body':
        return cls(name, 'detector', surfaces)


@dataclass(frozen=True)
class Meeting:
    """One entry of a path: which surface, what happens, and the bodies (−1 ambient) on both sides."""

    body: int
    surface: int
    action: Action
    before: int
    after: int


Path = tuple[Meeting, ...]


@dataclass(frozen=True)
class Trace:
    """What :meth:`Scene.trace` found.

    ``points``: start and every strike, each a vector [m]; ``optical_path``: the optical length [m]
    from the start to each strike; ``direction``: after the last meeting.
    """

    points: tuple[Vector, ...]
    optical_path: tuple[Component, ...]
    direction: Vector


@dataclass(frozen=True)
class Scene:
    """Bodies in an ambient medium of refractive index ``ambient`` (one value or one a pose)."""

    bodies: tuple[Body, ...]
    ambient: Component = 1.0

    def index(self, body: int) -> Component:
        return self.ambient if body < 0 else self.bodies[body].index

    def find_path(self, origin: Vector, direction: Vector, pose: int = 0, limit: int = 100) -> Path:
        """What the ray of one pose meets, in order, until a detector or open space.

        ``ValueError`` if it is still inside the scene after ``limit`` meetings.
        """
        origin, direction = _at(origin, pose), _at(direction, pose)
        inside, path = -1, []
        while len(path) < limit:
            nearest = self._nearest(origin, direction, pose, inside)
            if nearest is None:
                return tuple(path)
            t, normal, number, side = nearest
            body = self.bodies[number]
            if body.kind == 'detector':
                return (*path, Meeting(number, side, 'stop', inside, inside))
            after = -1 if inside == number else number
            turned = None
            if body.kind == 'glass':
                n_before, n_after = (float(np.ravel(self.index(b))[pose if np.ndim(self.index(b)) else 0])
                                     for b in (inside, after))
                turned = refract(direction, normal, n_before, n_after)
            if turned is None or np.isnan(turned[0]):
                path.append(Meeting(number, side, 'reflect', inside, inside))
                turned = reflect(direction, normal)
            else:
                path.append(Meeting(number, side, 'refract', inside, after))
                inside = after
            origin, direction = along(origin, t, direction), turned
        raise ValueError(f'the beam met {limit} surfaces without leaving the scene; '
                         'check that no bodies overlap')

    def _nearest(self, origin: Vector, direction: Vector, pose: int,
                 inside: int) -> tuple[float, Vector, int, int] | None:
        best = None
        for number, body in enumerate(self.bodies):
            if inside not in (-1, number):
                continue
            surfaces = [surface.at(pose) for surface in body.surfaces]
            for side, surface in enumerate(surfaces):
                t, normal = surface.hit(origin, direction)
                if not START_GAP < t < (best[0] if best else np.inf):
                    continue
                strike = along(origin, t, direction)
                if not _within(surface, strike):
                    continue
                # Glass is entered against and left along the outward normal; a mirror has a back too.
                if body.kind == 'glass' and (dot(direction, normal) > 0.0) != (inside == number):
                    continue
                if body.kind == 'glass' and any(other.outside(strike) > START_GAP
                                                for other in surfaces if other is not surface):
                    continue
                best = (float(t), normal, number, side)
        return best

    def trace(self, path: Path, origin: Vector, direction: Vector) -> Trace:
        """Send every pose's ray down ``path``; what cannot follow it is NaN from there on."""
        points, lengths, total = [origin], [], 0.0
        for meeting in path:
            surface = self.bodies[meeting.body].surfaces[meeting.surface]
            t, normal = surface.hit(origin, direction)
            if not np.all(t > 0.0):
                t = np.where(t > 0.0, t, np.nan)
            before = self.index(meeting.before)
            total = total + before * t
            origin = along(origin, t, direction)
            if surface.aperture is not None and not np.all(within := _within(surface, origin)):
                total = np.where(within, total, np.nan)
                origin = tuple(np.where(within, c, np.nan) for c in origin)
            points.append(origin)
            lengths.append(total)
            if meeting.action == 'reflect':
                direction = reflect(direction, normal)
            elif meeting.action == 'refract':
                direction = refract(direction, normal, before, self.index(meeting.after))
        return Trace(tuple(points), tuple(lengths), direction)


def _within(surface: Surface, strike: Vector) -> Component:
    if surface.aperture is None:
        return True
    r = minus(strike, surface.point)
    return dot(r, r) <= surface.aperture**2
