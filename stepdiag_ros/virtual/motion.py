"""Jerk-limited point-to-point motion, in closed form.

A move is up to seven phases of constant jerk (third-order profile; Lambrechts,
Boerlage, Steinbuch, *Trajectory planning and feedforward design for electromechanical
motion systems*, Control Engineering Practice 13, 2005).  The distance travelled is a
cubic in each phase, so positions at any time are exact and need no integration.

The servo behind it is a first-order lag ``τ ẏ + y = p``: for a cubic ``p`` the answer
is again exact, ``y = p − τ p' + τ² p'' − τ³ p''' + C exp(−t/τ)``, with ``C`` carried
from phase to phase.  It makes the axis trail in motion and creep in at the end.
"""

from dataclasses import dataclass

import numpy as np

PHASES = 7


@dataclass(frozen=True)
class Profile:
    """Phases of constant jerk: ``duration`` (7,) [s], ``jerk`` (7,) [m/s³], from speed and acceleration.

    ``speed`` [m/s] and ``acceleration`` [m/s²] are those at the start (zero but for a brake).
    """

    duration: np.ndarray
    jerk: np.ndarray
    speed: float = 0.0
    acceleration: float = 0.0

    @property
    def total_time(self) -> float:
        """[s] until the commanded point stands still."""
        return float(self.duration.sum())

    @property
    def length(self) -> float:
        """[m] travelled when it is over."""
        return float(tabulate(self.duration[None], self.jerk[None], np.array([self.speed]),
                              np.array([self.acceleration])).position[0, -1])


def point_to_point(distance: float, speed: float, acceleration: float, jerk: float) -> Profile:
    """The fastest profile from rest to rest over ``distance`` [m] within the limits given."""
    if distance <= 0.0:
        return Profile(np.zeros(PHASES), np.zeros(PHASES))
    rise = min(np.cbrt(distance / (2.0 * jerk)), np.sqrt(speed / jerk), acceleration / jerk)
    hold = 0.5 * (-3.0 * rise + np.sqrt(rise ** 2 + 4.0 * distance / (jerk * rise)))
    hold = max(0.0, min(hold, speed / (jerk * rise) - rise))
    top = jerk * rise * (rise + hold)
    cruise = max(0.0, distance / top - (2.0 * rise + hold))
    return Profile(np.array([rise, hold, rise, cruise, rise, hold, rise]),
                   jerk * np.array([1.0, 0.0, -1.0, 0.0, -1.0, 0.0, 1.0]))


def brake(speed: float, acceleration_now: float, acceleration: float, jerk: float) -> Profile:
    """From ``speed`` [m/s] and ``acceleration_now`` [m/s²] to rest within the limits.

    The acceleration is taken to zero first; what speed is left then is ramped down.
    """
    ease = abs(acceleration_now) / jerk
    left = max(0.0, speed + 0.5 * acceleration_now * ease)
    rise = min(acceleration / jerk, np.sqrt(left / jerk))
    hold = max(0.0, left / (jerk * rise) - rise) if rise > 0.0 else 0.0
    return Profile(np.array([ease, rise, hold, rise, 0.0, 0.0, 0.0]),
                   np.array([-np.sign(acceleration_now) * jerk, -jerk, 0.0, jerk, 0.0, 0.0, 0.0]),
                   speed, acceleration_now)


@dataclass(frozen=True)
class Table:
    """Many profiles laid out for arithmetic: boundaries and the state at each, all (m, 8)."""

    time: np.ndarray
    position: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray
    jerk: np.ndarray   # (m, 8); the last column is zero: at rest after the end


def tabulate(duration: np.ndarray, jerk: np.ndarray, speed: np.ndarray,
             acceleration: np.ndarray) -> Table:
    """State at the phases' boundaries for (m, 7) durations and jerks, (m,) starting states."""
    m = len(duration)
    time = np.zeros((m, PHASES + 1))
    time[:, 1:] = np.cumsum(duration, axis=1)
    p, v, a = np.zeros((m, PHASES + 1)), np.zeros((m, PHASES + 1)), np.zeros((m, PHASES + 1))
    v[:, 0], a[:, 0] = speed, acceleration
    for k in range(PHASES):
        t, j = duration[:, k], jerk[:, k]
        p[:, k + 1] = p[:, k] + t * (v[:, k] + t * (a[:, k] / 2.0 + t * j / 6.0))
        v[:, k + 1] = v[:, k] + t * (a[:, k] + t * j / 2.0)
        a[:, k + 1] = a[:, k] + t * j
    # Rounding leaves 1e-17 m/s; at the end a profile stands still by definition.
    v[:, -1], a[:, -1] = 0.0, 0.0
    return Table(time, p, v, a, np.pad(jerk, ((0, 0), (0, 1))))


def evaluate(table: Table, row: np.ndarray, time: np.ndarray,
             lag: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Where row ``row`` (n,) is at ``time`` (n,) [s] after its start.

    Returns (n,) arrays: commanded travel [m], speed [m/s], acceleration [m/s²], and the
    travel [m] of a servo with the time constant ``lag`` [s] that was settled at the start.
    """
    time = np.maximum(time, 0.0)
    phase = np.sum(time[:, None] >= table.time[row][:, 1:], axis=1)
    dt = time - table.time[row, phase]
    p0, v0 = table.position[row, phase], table.speed[row, phase]
    a0, j = table.acceleration[row, phase], table.jerk[row, phase]
    p = p0 + dt * (v0 + dt * (a0 / 2.0 + dt * j / 6.0))
    v = v0 + dt * (a0 + dt * j / 2.0)
    a = a0 + dt * j
    if lag <= 0.0:
        return p, v, a, p
    constant = _lag_constants(table, lag)[row, phase]
    actual = p - lag * (v - lag * (a - lag * j)) + constant * np.exp(-dt / lag)
    return p, v, a, actual


def _lag_constants(table: Table, lag: float) -> np.ndarray:
    """C of each phase, (m, 8), for a servo that was settled at position 0 when the move began."""
    def trail(k, j):
        return lag * (table.speed[:, k] - lag * (table.acceleration[:, k] - lag * j))
    constant = np.zeros_like(table.time)
    constant[:, 0] = trail(0, table.jerk[:, 0])
    for k in range(PHASES):
        span = table.time[:, k + 1] - table.time[:, k]
        # p is the same on both sides of a boundary, so y = p − trail + C fixes the next C.
        constant[:, k + 1] = constant[:, k] * np.exp(-span / lag) \
            - trail(k + 1, table.jerk[:, k]) + trail(k + 1, table.jerk[:, k + 1])
    return constant


def settling_time(table: Table, lag: float, window: float) -> np.ndarray:
    """(m,) [s] after its start at which each profile is in position and stays there.

    The servo is in position when it is within ``window`` [m] of the target and the
    commanded point has arrived.
    """
    end = table.time[:, -1]
    if lag <= 0.0:
        return end
    residual = np.abs(_lag_constants(table, lag)[:, -1])
    return end + lag * np.log(np.maximum(residual / window, 1.0))
