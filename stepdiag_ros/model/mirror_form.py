"""Form errors of a mirror: how its surface departs from the plane at its reference point.

Heights [m] are positive along the outward normal, towards the light, over (ξ, η) [m] along the
mirror's own axes.  A form builds the optical surface for any poses; whoever has another shape
writes ``height`` and ``gradient`` and hands them to :class:`HeightForm`.
"""

from dataclasses import dataclass
from typing import Protocol

from stepdiag_ros.model.optics import HeightSurface, Plane, Sphere, Surface
from stepdiag_ros.model.rays import Component, Gradient, Height, Vector


class MirrorForm(Protocol):
    """What a mirror looks like in its own frame."""

    def surface(self, point: Vector, axes: tuple[Vector, Vector, Vector]) -> Surface:
        """The optical surface at ``point`` [m] with unit ``axes`` ξ, η, outward normal."""
        ...


@dataclass(frozen=True)
class FlatForm:
    """The ideal mirror."""

    def surface(self, point: Vector, axes: tuple[Vector, Vector, Vector]) -> Plane:
        return Plane(point, axes[2])


@dataclass(frozen=True)
class SphericalForm:
    """An exact sphere of ``curvature`` [1/m]; positive is hollow, ``h = c r²/2 + …``."""

    curvature: float

    def surface(self, point: Vector, axes: tuple[Vector, Vector, Vector]) -> Sphere:
        return Sphere(point, axes[2], self.curvature)


@dataclass(frozen=True)
class HeightForm:
    """Any smooth shape: ``height(ξ, η)`` [m] and ``gradient(ξ, η)``, its two slopes."""

    height: Height
    gradient: Gradient

    def surface(self, point: Vector, axes: tuple[Vector, Vector, Vector]) -> HeightSurface:
        return HeightSurface(point, axes, self.height, self.gradient)


def quadratic_form(curvature: float, astigmatism: float = 0.0, astigmatism_45: float = 0.0,
                   cubic: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)) -> HeightForm:
    """``h = c (ξ²+η²)/2 + a (ξ²−η²)/2 + a45 ξη``, the three in 1/m; a sag of ``c r²/2`` at radius r.

    ``cubic`` [1/m²]: third derivatives ξξξ, ξξη, ξηη, ηηη of the height besides.
    """
    xx, yy, xy = curvature + astigmatism, curvature - astigmatism, astigmatism_45
    xxx, xxy, xyy, yyy = cubic

    def height(x: Component, y: Component) -> Component:
        bent = 0.5 * (xx * x * x + yy * y * y) + xy * x * y
        return bent + (xxx * x**3 + yyy * y**3) / 6.0 + 0.5 * (xxy * x + xyy * y) * x * y

    def gradient(x: Component, y: Component) -> tuple[Component, Component]:
        return (xx * x + xy * y + 0.5 * (xxx * x * x + xyy * y * y) + xxy * x * y,
                xy * x + yy * y + 0.5 * (xxy * x * x + yyy * y * y) + xyy * x * y)

    return HeightForm(height, gradient)
