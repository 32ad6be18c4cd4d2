"""What interferometer and PSD see of a flat mirror: the contract's closed forms.

For a beam from ``O`` along the unit vector ``b`` and a mirror through ``p`` with
normal ``m`` the distance along the beam is ``L = ((p − O)·m)/(b·m)``; ``m`` need not
be of unit length.  The PSD's beam strikes at its own ``L``, leaves along
``b − 2 (b·m) m/|m|²`` and meets the detector's plane, through its start and normal
to ``d``.
"""

from dataclasses import dataclass

import numpy as np

from stepdiag_ros.model.description import Machine, Setup
from stepdiag_ros.model.path import local_triad, setup_direction, start_corner


@dataclass(frozen=True)
class Misalignment:
    """Small turns of one setup about its (u, v) [rad]: of the laser's beams and of the mirror's mount; of a setup with
    a station instead how far [m] it is from where it is said to stand; or the standard uncertainties of these."""

    laser: tuple[float, float] = (0.0, 0.0)
    mirror: tuple[float, float] = (0.0, 0.0)
    station: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Station:
    """A base unit in the machine frame, nominal.

    ``triad`` (3, 3) rows u, v, d; ``origin`` (3,) [m] of the beams' reference.
    """

    triad: np.ndarray
    origin: np.ndarray

    def beam_origins(self, offsets: np.ndarray) -> np.ndarray:
        """Start points (k, 3) [m] of beams with ``offsets`` (k, 2) [m] along u and v."""
        return self.origin + np.atleast_2d(offsets) @ self.triad[:2]


def station(machine: Machine, setup: Setup) -> Station:
    """The nominal base unit of a setup: ``O = S + τ − standoff·d``."""
    d = setup_direction(machine, setup)
    origin = start_corner(machine, setup) + np.array(machine.tool) - setup.standoff * d
    return Station(local_triad(d), origin)


def nominal_sight(machine: Machine, setup: Setup, commanded: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance (n,) [m] from source to mirror or retroreflector at ``commanded`` (n, 3) [m] of a perfect machine, and
    the direction (n, 3) along which its moves lengthen it."""
    if setup.follows:
        arm = commanded + np.array(setup.tool_of(machine)) - setup.station
        distance = np.linalg.norm(arm, axis=-1)
        return distance, arm / distance[..., None]
    d = setup_direction(machine, setup)
    return setup.standoff + (commanded - start_corner(machine, setup)) @ d, np.broadcast_to(d, np.shape(commanded))


def turned(triad: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Direction ``d`` turned by small angles about u and v, of unit length.

    ``angles`` (…, 2) [rad] → (…, 3).  ``d + (α u + β v)×d = d − α v + β u``, then normalised.
    """
    angles = np.asarray(angles, float)
    vector = triad[2] - angles[..., :1] * triad[1] + angles[..., 1:] * triad[0]
    return vector / np.linalg.norm(vector, axis=-1, keepdims=True)


def turned_frame(triad: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Rows u, v, d (3, 3) turned by small ``angles`` (2,) [rad] about u and v, rectangular again."""
    d = turned(triad, angles)
    u = triad[0] - (triad[0] @ d) * d
    u /= np.linalg.norm(u)
    return np.array([u, np.cross(d, u), d])


def distance(point: np.ndarray, normal: np.ndarray, origin: np.ndarray,
             beam: np.ndarray) -> np.ndarray:
    """Distance along ``beam`` from ``origin`` to the plane: broadcast (…, 3) → (…) [m]."""
    return np.sum((point - origin) * normal, -1) / np.sum(beam * normal, -1)


def spot(point: np.ndarray, normal: np.ndarray, origin: np.ndarray, beam: np.ndarray,
         triad: np.ndarray) -> np.ndarray:
    """Where the beam returns to the plane of its start: (n, 2) [m] along u and v."""
    cosine = np.sum(beam * normal, -1)
    out = np.sum((point - origin) * normal, -1) / cosine
    back = beam - (2.0 * cosine / np.sum(normal * normal, -1))[..., None] * normal
    d = triad[2]
    home = -out * (beam @ d) / (back @ d)
    path = out[..., None] * beam + home[..., None] * back
    return path @ triad[:2].T


def measure(machine: Machine, setup: Setup, misalignment: Misalignment,
            point: np.ndarray, attitude: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distances and spots of one setup for mirror poses.

    ``point`` (n, 3) [m], ``attitude`` (n, 3, 3) from :func:`~stepdiag_ros.model.machine.tool_pose`.
    Returns absolute distances (n, beams) [m] (no reset taken off) and spots (n, 2) [m], NaN without a detector.
    """
    if setup.follows:
        arm = point - np.add(setup.station, misalignment.station)
        return np.linalg.norm(arm, axis=-1)[:, None], np.full((len(point), 2), np.nan)
    base = station(machine, setup)
    beam = turned(base.triad, misalignment.laser)
    normal = attitude @ -turned(base.triad, misalignment.mirror)
    lengths = np.stack([distance(point, normal, start, beam)
                        for start in base.beam_origins(np.array(setup.beams))], axis=-1)
    start = base.beam_origins(np.array(setup.psd_offset))[0]
    spots = spot(point, normal, start, np.broadcast_to(beam, point.shape), base.triad)
    return lengths, spots if setup.psd else np.full_like(spots, np.nan)
