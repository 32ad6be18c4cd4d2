"""How high a retroreflector stands above a station that follows it in a plane, as the square on which lengths depend.

Targets of a way that leaves one axis alone lie in a plane.  There the length to a station is √(a² + h²), a its part
within the plane and h the height of the retroreflector above the station, the same at every target.  Sought is how far
the station stands along that axis from where it is said to stand; but a station that was levelled with its targets has
a height of about zero, and what depends on its square has no derivative there: steps go astray along a flat, bent
valley, and an uncertainty of first order is none.  So the unknown is u with

    h² = s² − 2 c u,      c = sign(s) √(s² + ¾ p²)

s the height as stated, p the prior standard deviation of the station.  For a station far from the plane u is how far it
was moved; in the plane lengths follow u as they follow any other unknown, and noise may bring h² below zero.  In both
cases what is known beforehand of u has the deviation p: h² − s² of a station that is off by δ is δ² − 2sδ, whose second
moment is 4s²p² + 3p⁴.

On which side of the plane a station stands only the errors across it show, by nanometres; it is the side that was
stated.  They lengthen the way by h e / L, two unknowns of which either may be had for the other: with priors of 20 mm
and 1 mm a level station would seem to find both.  So what is known of e besides is put into the length, but nothing is
learnt of it there.
"""

from dataclasses import dataclass

import numpy as np

from stepdiag_ros.model.description import Description, Setup

PRIOR_STATION_M = 2e-2
"""How well it is known where a station stands: by a rule held beside it."""
LEVEL = 2.0
"""A station whose stated height is less than so many standard deviations of its prior may be level."""
ROUND_M = 1e-4
"""Heights below this count as less than they are where an error across the plane changes a length, by a nanometre at
most: a root has no slope at 0."""


def across(setup: Setup) -> int | None:
    """The axis that stands still on the way of a setup whose beam follows; None where no plane holds its targets, or
    a line does."""
    if not setup.follows or setup.way is None or setup.way.is_straight or len(setup.axes) != 2:
        return None
    return next(axis for axis in range(3) if axis not in setup.axes)


@dataclass(frozen=True)
class Heights:
    """Of n stops: ``axis`` (n,) across their plane, −1 where there is none; ``stated`` s and ``unit`` c (n,) [m]."""

    axis: np.ndarray
    stated: np.ndarray
    unit: np.ndarray

    @classmethod
    def of_stops(cls, description: Description, names: np.ndarray) -> 'Heights':
        """``names`` (n,): the setup of each stop."""
        axis, stated = np.full(len(names), -1), np.zeros(len(names))
        for name in dict.fromkeys(names.tolist()):
            setup = description.setups[name]
            own = across(setup)
            if own is not None:
                axis[names == name] = own
                stated[names == name] = (setup.way.start[own] + setup.tool_of(description.machine)[own]
                                         - setup.station[own])
        return cls(axis, stated, np.where(stated < 0.0, -1.0, 1.0) * np.sqrt(stated**2 + 0.75 * PRIOR_STATION_M**2))

    @property
    def level(self) -> np.ndarray:
        """Whether (n,) a station may stand in the plane of its targets."""
        return np.abs(self.stated) < LEVEL * PRIOR_STATION_M

    def square(self, unknown: np.ndarray) -> np.ndarray:
        """h² (n,) [m²] for u (n,) [m]; below zero where noise has it so."""
        return self.stated**2 - 2.0 * self.unit * unknown

    def height(self, unknown: np.ndarray) -> np.ndarray:
        """h (n,) [m], on the side that was stated."""
        return np.sign(self.unit) * np.sqrt(np.maximum(self.square(unknown), 0.0))

    def moved(self, unknown: np.ndarray) -> np.ndarray:
        """How far (n,) [m] the station stands along the axis from where it is said to stand."""
        return self.stated - self.height(unknown)

    def sigma(self, unknown: np.ndarray, sigma: np.ndarray) -> np.ndarray:
        """Half of what h could be more (n,) [m] if h² were two standard uncertainties more; of a station that may be
        level so much that k = 2 reaches the other side.  ``sigma`` (n,) [m] of u."""
        height = np.abs(self.height(unknown))
        own = 0.5 * (np.sqrt(height**2 + 4.0 * np.abs(self.unit) * sigma) - height)
        return np.hypot(own, np.where(self.level, height, 0.0))

    def errors(self, arms: np.ndarray) -> np.ndarray:
        """What the machine is off across the plane (n,) [m], 0 without one; ``arms`` as for :meth:`lengths`."""
        found, rows = np.zeros(len(arms)), np.flatnonzero(self.axis >= 0)
        found[rows] = arms[rows, self.axis[rows]] - self.stated[rows]
        return found

    def lengths(self, arms: np.ndarray, unknown: np.ndarray, believed: np.ndarray,
                ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Lengths (n,), their derivatives (n, 3) by the retroreflector's place, and (n,) by u.

        ``arms`` (n, 3) [m] from the station as stated across the plane, and as sought within it.  What the machine is
        off across the plane, e, makes (h + e)² of h²; of level stations e is ``believed`` (n,) [m] and not ``arms``'.
        """
        rows = np.flatnonzero(self.axis >= 0)
        own, arms, by = self.axis[rows], arms.copy(), np.zeros(len(arms))
        square = self.square(unknown)[rows]
        above = np.maximum(square, 0.0)
        height = np.sign(self.unit[rows]) * above / np.sqrt(above + ROUND_M**2)
        slope = np.sign(self.unit[rows]) * (square > 0.0) * (0.5 * above + ROUND_M**2) / (above + ROUND_M**2)**1.5
        error = np.where(self.level, believed, self.errors(arms))[rows]
        arms[rows, own] = 0.0
        total = np.sum(arms**2, axis=1)
        total[rows] += square + 2.0 * height * error + error**2
        arms[rows, own] = np.where(self.level[rows], 0.0, height + error)
        length = np.sqrt(np.maximum(total, ROUND_M**2))
        by[rows] = -self.unit[rows] * (1.0 + 2.0 * slope * error) / length[rows]
        return length, arms / length[:, None], by
