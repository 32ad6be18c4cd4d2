"""A beam that a detector holds on a retroreflector: the optics of a steered beam, and the law of the loop.

The beam starts at the station P.  Two mirrors turn it by the azimuth α and the elevation β away from ``d``, the
direction from where the station is said to stand to the middle of the way:

    b = cos β (cos α · d + sin α · u) + sin β · v,   e₁ = ∂b/∂α / cos β,   e₂ = ∂b/∂β

A retroreflector at a = p − P sends it back parallel to itself, mirrored at the centre: what it misses the centre by
comes back doubled, wherever the detector stands, and the interferometer reads the part of a along the beam:

    s = 2 (a·e₁, a·e₂),   L = a·b = √(|a|² − |s|²/4) ≈ |a| − |s|²/(8 |a|)

So the detector shows by which angle the beam is off, ``(s₁/(2 |a| cos β), s₂/(2 |a|))`` to first order, and what the
loop leaves of it costs a length that the detector tells and an evaluation puts back.

The loop adds a share ``gain`` of that angle to what it commands, once a period.  With ``delay`` further periods until
a command shows, an error follows ``ε[k+1] = ε[k] − gain·ε[k−delay] + v·period`` where the retroreflector crosses the
beam at v.  It dies out where ``gain < 2 sin(π/(2 (2 delay + 1)))`` (Levin & May 1976), and in steady motion the beam
trails by ``v·period/gain``.  What lies within the deadband (the mirrors' smallest step) is left alone: an integrator
that went on would swing between two steps for ever.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.model.description import Description, Machine, Setup
from stepdiag_ros.model.path import local_triad, stops

GAIN = 0.3
"""Stable with up to four periods of delay."""
PERIOD_S = 0.010
DEADBAND = 0.6
"""Of the mirrors' smallest step; from a half on there is an angle at which the loop rests."""
SEARCH_STAYS, SEARCH_PLACES = 4, 150
"""Periods at each place of the search for a lost beam, and places before it begins anew."""
GOLDEN = np.pi * (3.0 - np.sqrt(5.0))


def stable_gain(delay: int) -> float:
    """The gain at which a loop with ``delay`` periods of delay swings for ever."""
    return 2.0 * float(np.sin(np.pi / (2.0 * (2 * delay + 1))))


def steering_frame(machine: Machine, setup: Setup) -> np.ndarray:
    """Rows u, v, d (3, 3): d from the station to the middle of the way."""
    middle = 0.5 * (np.array(setup.way.start) + np.array(setup.way.end)) + np.array(setup.tool_of(machine))
    arm = middle - np.array(setup.station)
    return local_triad(arm / np.linalg.norm(arm))


def beam_axes(frame: np.ndarray, angles: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Beam and the detector's axes as the retroreflector sees them, b, e₁, e₂ (n, 3); ``angles`` (n, 2) [rad]."""
    (ca, cb), (sa, sb) = np.cos(angles).T[..., None], np.sin(angles).T[..., None]
    u, v, d = frame
    level = ca * d + sa * u
    return cb * level + sb * v, ca * u - sa * d, cb * v - sb * level


def angles_of(frame: np.ndarray, arm: np.ndarray) -> np.ndarray:
    """Azimuth and elevation (n, 2) [rad] of a beam along ``arm`` (n, 3)."""
    u, v, d = (arm @ axis for axis in frame)
    return np.stack([np.arctan2(u, d), np.arctan2(v, np.hypot(u, d))], axis=-1)


def steered(frame: np.ndarray, angles: np.ndarray, arm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Length (n,) and spot (n, 2) [m] of a beam at ``angles`` (n, 2) with the retroreflector at ``arm`` (n, 3) [m]."""
    beam, first, second = beam_axes(frame, angles)
    return (np.sum(arm * beam, axis=-1),
            2.0 * np.stack([np.sum(arm * first, axis=-1), np.sum(arm * second, axis=-1)], axis=-1))


def missed(spot: np.ndarray, elevation: np.ndarray, distance: np.ndarray) -> np.ndarray:
    """Azimuth and elevation (n, 2) [rad] by which a beam at ``elevation`` (n,) misses a centre at ``distance`` (n,) [m]
    when it returns to ``spot`` (n, 2) [m]."""
    narrowed = np.stack([np.cos(elevation), np.ones_like(elevation)], axis=-1)
    return spot / (2.0 * np.asarray(distance)[..., None] * narrowed)


def shortened(spot_squared: np.ndarray, distance: np.ndarray) -> np.ndarray:
    """By how much [m] a length reads short where the beam returns off the centre: ``|s|²/(8 |a|)``."""
    return spot_squared / (8.0 * distance)


@dataclass(frozen=True)
class Aim:
    """Where a regulated beam begins: azimuth and elevation [rad] of the first stop; the farthest ``distance`` [m]."""

    azimuth: float
    elevation: float
    distance: float


def aim_of(description: Description, name: str) -> Aim:
    """The aim of a regulated setup as its station is said to stand."""
    angles, distances = sight(description, name)
    return Aim(float(angles[0, 0]), float(angles[0, 1]), float(distances.max()))


def sight(description: Description, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Angles (n, 2) [rad] and distances (n,) [m] of the stops of a regulated setup, of a perfect machine."""
    setup = description.setups[name]
    arm = stops(description, name).positions + np.array(setup.tool_of(description.machine)) - np.array(setup.station)
    return angles_of(steering_frame(description.machine, setup), arm), np.linalg.norm(arm, axis=-1)


def aims_of(given: Sequence[str]) -> dict[str, Aim]:
    """Aims by setup from the parameter: ``setup=azimuth,elevation,distance`` each [rad, rad, m]."""
    found = {}
    for entry in filter(None, given):
        name, _, numbers = entry.partition('=')
        try:
            azimuth, elevation, distance = (float(number) for number in numbers.split(','))
        except ValueError:
            azimuth = elevation = distance = np.nan
        if not name or not (distance > 0.0 and np.isfinite([azimuth, elevation, distance]).all()):
            raise StepdiagError(f'parameter regulated holds {entry!r}; write '
                                'setup=azimuth,elevation,distance in rad and m, e.g. around=0.10,-0.05,0.40')
        found[name] = Aim(azimuth, elevation, distance)
    return found


def told(aims: Mapping[str, Aim]) -> list[str]:
    """The parameter for ``aims``; one empty entry where there are none, which ROS can type."""
    return [f'{name}={aim.azimuth!r},{aim.elevation!r},{aim.distance!r}' for name, aim in aims.items()] or ['']


class Regulator:
    """Commands of azimuth and elevation [rad] from spots [m], one a period.

    ``deadband`` [rad]: what is left alone; ``capture`` [m]: a spot within this of the centre is on the detector.  Where
    there is no light it searches: on a spiral about where the beam was last held, then about the aim, in turn.
    """

    def __init__(self, aim: Aim, deadband: float, capture: float, gain: float = GAIN):
        self._aim, self._deadband, self._gain = np.array([aim.azimuth, aim.elevation]), deadband, gain
        self._distance = aim.distance
        self._pitch = 0.5 * capture / (2.0 * aim.distance)
        self._held = self.command = self._aim
        self._dark = 0

    @property
    def searching(self) -> bool:
        """Whether there is no light."""
        return self._dark > 0

    def next(self, spot: np.ndarray | None) -> np.ndarray:
        """Command (2,) after a period in which the mean of the spots was ``spot`` (2,); None: there was no light."""
        if spot is None:
            turn, place = divmod(self._dark // SEARCH_STAYS, SEARCH_PLACES)
            self._dark += 1
            centre = self._aim if turn % 2 else self._held
            self.command = centre + self._pitch * np.sqrt(place) * np.array(
                [np.cos(GOLDEN * place), np.sin(GOLDEN * place)])
            return self.command
        error = missed(spot, self.command[1], self._distance)
        self.command = self._held = self.command + self._gain * np.where(np.abs(error) > self._deadband, error, 0.0)
        self._dark = 0
        return self.command
