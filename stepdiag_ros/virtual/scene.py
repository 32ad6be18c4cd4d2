"""The virtual sensor: base unit and mirror as an optical scene.

One base unit sends parallel beams against a mirror that the machine carries.  Interferometer
beams end at the mirror, the PSD's beam comes back to a detector in the plane that it started
from.  Everything follows from the laws of refraction and reflection in
:mod:`stepdiag_ros.model.optics`; the closed forms of :mod:`stepdiag_ros.model.sensor` are not used,
so that each can be held against the other.

What an interferometer reports when the light does not return into itself is a matter of
definition.  Here it is half the optical path out to the mirror and back along the same line,
that is the optical path from the start to the strike.  For a flat mirror that is the contract's
``((p − O)·m)/(b·m)``; for a curved one it includes the height at the strike.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from stepdiag_ros.model.description import Description, Machine, Setup
from stepdiag_ros.model.mirror_form import FlatForm, MirrorForm
from stepdiag_ros.model.optics import Body, Path, Plane, Scene, Trace
from stepdiag_ros.model.rays import Component, Vector
from stepdiag_ros.model.sensor import station

BLOCK = 32768
"""Poses traced together: enough to hide the interpreter, few enough to stay in the cache."""

MIRROR, DETECTOR = 0, 1


class Reading(NamedTuple):
    """``distance`` (n, beams) [m] of optical path, no reset taken off; ``spot`` (n, 2) [m] or None."""

    distance: np.ndarray
    spot: np.ndarray | None


class SensorScene:
    """One base unit and its mirror.

    ``origin`` (3,) [m] and ``triad`` (3, 3), rows u, v, d: the base unit in the machine frame.
    ``standoff`` [m]: where the mirror roughly is at the first stop.  ``beams``: (u, v) offsets [m]
    of the interferometer's beams; ``psd_offset``: of the PSD's beam, or None without a PSD.
    ``bodies`` stand in the light, fixed to the base unit: windows, wedges, prisms, in its own frame
    (x = u, y = v, z = d, origin at the beams' reference).

    Hardware layout a of Dahlem et al. is three ``beams`` with perpendicular offsets, layout b one
    beam and a PSD.
    """

    def __init__(self, origin: np.ndarray, triad: np.ndarray, standoff: float,
                 beams: Sequence[tuple[float, float]] = ((0.0, 0.0),),
                 psd_offset: tuple[float, float] | None = (0.0, 0.0),
                 bodies: Sequence[Body] = ()):
        self.origin = np.asarray(origin, float)
        self.triad = np.asarray(triad, float)
        self.beams = tuple((float(u), float(v)) for u, v in beams)
        self.psd_offset = None if psd_offset is None else (float(psd_offset[0]), float(psd_offset[1]))
        self.bodies = tuple(bodies)
        nominal = self._scene(Plane((0.0, 0.0, standoff or 1.0), (0.0, 0.0, -1.0)), 1.0)
        self._beam_paths = [_to_mirror(nominal.find_path((*beam, 0.0), (0.0, 0.0, 1.0)), beam)
                            for beam in self.beams]
        self._psd_path: Path = ()
        if self.psd_offset is not None:
            self._psd_path = nominal.find_path((*self.psd_offset, 0.0), (0.0, 0.0, 1.0))
            _to_mirror(self._psd_path, self.psd_offset)

    @classmethod
    def of_setup(cls, machine: Machine, setup: Setup, bodies: Sequence[Body] = ()) -> 'SensorScene':
        """The nominal base unit of one setup."""
        base = station(machine, setup)
        return cls(base.origin, base.triad, setup.standoff, setup.beams, setup.psd_offset, bodies)

    @classmethod
    def from_description(cls, description: Description, setup: str,
                         bodies: Sequence[Body] = ()) -> 'SensorScene':
        """As :meth:`of_setup`, by the setup's name in a cell description."""
        return cls.of_setup(description.machine, description.setups[setup], bodies)

    def measure(self, p: np.ndarray, R: np.ndarray, *,
                beam_tilt: np.ndarray | tuple[float, float] = (0.0, 0.0),
                mirror_tilt: np.ndarray | tuple[float, float] = (0.0, 0.0),
                mirror_form: MirrorForm | None = None,
                psd_zero: tuple[float, float] = (0.0, 0.0),
                ambient: float | np.ndarray = 1.0) -> Reading:
        """Read both sensors at ``n`` poses.

        ``p`` (n, 3) [m] and ``R`` (n, 3, 3): the mirror's reference point and attitude in the machine
        frame (:func:`stepdiag_ros.model.machine.tool_pose`).  ``beam_tilt`` and ``mirror_tilt``: small
        turns [rad] about (u, v), (2,) or (n, 2), the mirror's fixed in the tool.  ``psd_zero`` [m] is
        what the detector adds to the true spot.  ``ambient``: refractive index of the air, one or
        (n,); distances are optical path, divide by the index that the instrument believes.

        Returns absolute distances and spots; NaN where the light does not reach the sensor.
        """
        p = np.atleast_2d(np.asarray(p, float))
        R = np.asarray(R, float).reshape(-1, 3, 3)
        n = len(p)
        distance = np.empty((n, len(self.beams)))
        spot = None if self.psd_offset is None else np.empty((n, 2))
        for start in range(0, n, BLOCK):
            rows = slice(start, start + BLOCK)
            scene, beam = self._placed(p[rows], R[rows], _rows(beam_tilt, rows, 1),
                                       _rows(mirror_tilt, rows, 1), mirror_form,
                                       _rows(ambient, rows, 0))
            for number, (path, offset) in enumerate(zip(self._beam_paths, self.beams, strict=True)):
                trace = scene.trace(path, (*offset, 0.0), beam)
                distance[rows, number] = trace.optical_path[-1]
            if spot is not None:
                home = scene.trace(self._psd_path, (*self.psd_offset, 0.0), beam).points[-1]
                for axis in range(2):
                    spot[rows, axis] = home[axis] + (psd_zero[axis] - self.psd_offset[axis])
        return Reading(distance, spot)

    def beam_lines(self, p: np.ndarray, R: np.ndarray, *,
                   beam_tilt: np.ndarray | tuple[float, float] = (0.0, 0.0),
                   mirror_tilt: np.ndarray | tuple[float, float] = (0.0, 0.0),
                   mirror_form: MirrorForm | None = None) -> list[np.ndarray]:
        """Every beam as a polyline, PSD's last: (points, n, 3) [m] in the machine frame, for pictures."""
        p, R = np.atleast_2d(np.asarray(p, float)), np.asarray(R, float).reshape(-1, 3, 3)
        scene, beam = self._placed(p, R, np.asarray(beam_tilt, float), np.asarray(mirror_tilt, float),
                                   mirror_form, 1.0)
        traces = [scene.trace(path, (*offset, 0.0), beam)
                  for path, offset in zip(self._beam_paths, self.beams, strict=True)]
        if self.psd_offset is not None:
            traces.append(scene.trace(self._psd_path, (*self.psd_offset, 0.0), beam))
        return [self._machine_frame(trace, len(p)) for trace in traces]

    def _machine_frame(self, trace: Trace, n: int) -> np.ndarray:
        local = np.array([[np.broadcast_to(c, n) for c in point] for point in trace.points])
        return np.moveaxis(local, 1, 2) @ self.triad + self.origin

    def _scene(self, mirror: Plane, ambient: Component) -> Scene:
        detector = Plane((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
        return Scene((Body.mirror('mirror', mirror), Body.detector('detector', detector), *self.bodies),
                     ambient)

    def _placed(self, p: np.ndarray, R: np.ndarray, beam_tilt: np.ndarray, mirror_tilt: np.ndarray,
                form: MirrorForm | None, ambient: Component) -> tuple[Scene, Vector]:
        """The scene of some poses in the base unit's frame, and the beams' direction there."""
        x, y, z = self.triad @ (p - self.origin).T
        u, v, d = _tilted(mirror_tilt)
        point, normal = (x, y, z), self._carried(R, -d)
        if form is None:
            surface = FlatForm().surface(point, (u, v, normal))
        else:
            # First-order rotations are a little off orthogonal; the form wants unit axes.
            axes = [_unit(self._carried(R, axis)) for axis in (u, v)]
            surface = form.surface(point, (*axes, _unit(normal)))
        bx, by, bz = (c if c.ndim else float(c) for c in np.moveaxis(_tilted(beam_tilt)[2], -1, 0))
        return self._scene(surface, ambient), (bx, by, bz)

    def _carried(self, R: np.ndarray, axis: np.ndarray) -> Vector:
        """A direction fixed in the tool, given in (u, v, d), as the turned tool holds it: components."""
        if axis.ndim == 1:
            # triad · R · (triadᵀ axis) in one matrix product whose rows are the components.
            kernel = np.einsum('ij,k->ijk', self.triad, axis @ self.triad).reshape(3, 9)
            x, y, z = kernel @ R.reshape(-1, 9).T
        else:
            x, y, z = self.triad @ np.einsum('njk,nk->jn', R, axis @ self.triad)
        return x, y, z


def _tilted(angles: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Axes u, v, d turned by small angles (α, β) about u and v, in (u, v, d): each (…, 3).

    ``d + (α u + β v)×d = d + β u − α v``, to unit length, as the contract's closed forms have it.
    """
    a, b = np.moveaxis(np.asarray(angles, float), -1, 0)
    zero, one = np.zeros_like(a), np.ones_like(a)
    d = np.stack([b, -a, one], -1) / np.sqrt(1.0 + a * a + b * b)[..., None]
    u = np.stack([one, zero, -b], -1) / np.sqrt(1.0 + b * b)[..., None]
    return u, np.cross(d, u), d


def _unit(vector: Vector) -> Vector:
    scale = 1.0 / np.sqrt(vector[0]**2 + vector[1]**2 + vector[2]**2)
    return vector[0] * scale, vector[1] * scale, vector[2] * scale


def _rows(value: np.ndarray | Sequence[float] | float, rows: slice, ndim: int) -> np.ndarray | float:
    """The block's rows of a parameter that may be one for all poses (``ndim`` axes) or one a pose."""
    value = np.asarray(value, float)
    if value.ndim > ndim:
        return value[rows]
    return value if ndim else float(value)


def _to_mirror(path: Path, offset: tuple[float, float]) -> Path:
    """The part of a beam's path that ends at the mirror."""
    for number, meeting in enumerate(path):
        if meeting.body == MIRROR:
            return (*path[:number], replace(meeting, action='stop'))
    raise ValueError(f'the beam at offset {offset} m does not reach the mirror; '
                     'check standoff, psd_offset and beams, and the bodies that stand in the light')
