"""The amounts of an effect in the course of a log, for a simulator: where its formula is not what happened.

A scale that warms with a hall, a mount that gives way anew after each mounting, a detector's zero that is another in
each setup: what follows no time constant is taken over as a table of time that does, along the log's own moves, what
the forms did that the log was fitted with.  In parity space readings are linear in the amounts at the table's times;
where that says nothing, for the machine's errors do as much, it goes as the forms went.
"""

from collections.abc import Callable

import numpy as np
from scipy.linalg import lstsq

from stepdiag_ros.effects.base import Effect
from stepdiag_ros.effects.course import Course
from stepdiag_ros.gap.preprocess.observe import Observation
from stepdiag_ros.twin.twin import Twin

TIMES = 192
"""Spans of time into which a log is cut evenly: runs that last longer than one have times of their own inside."""
EARLY = (1 / 64, 1 / 16, 1 / 4)
"""Shares of a setup's first run at which it has times besides: what begins with a mounting is fast at first."""
FREE = 10.0
"""How far an amount walks in a log, or jumps as a run begins, in its plausible range, where next to nothing is seen of
it: what the readings do show outweighs that by far, and what they hardly do must not become millimetres for a
thousandth of a standard deviation."""
HIDDEN = 0.01
"""Weight of what a course does to the readings in directions in which the machine does the same, beside what the log
shows of it: there it is as the forms had it, for the machine's errors are stated as they are beside these."""
TURNS = 3
"""Times that derivatives are taken anew: what a detector's turn does is not linear in it."""
STEP = 1e-4
"""Difference by which derivatives are taken, in an amount's plausible range."""
AT_ONCE = 2e7
"""Numbers of columns that are held at a time."""


def by_course(observation: Observation, effect: Effect, twin: Twin, did: np.ndarray, basis: np.ndarray,
              at_stops: np.ndarray, near: Course | None = None) -> Effect:
    """``effect`` with the course with which it does what its forms ``did`` (N,) in parity space, but along ``basis``
    (N, r), which says nothing of it; and ``at_stops`` (n, c) [m], where the machine may hide it; ``near``: the course
    along the same moves in a twin that hardly differs."""
    times, begins = _times(observation, twin)
    sizes = np.array([max(abs(p.low), abs(p.high)) for p in effect.amounts()])    # 1 is the plausible range
    hats = _hats(times, twin.seconds)
    course = near or Course(times, np.zeros((len(times), len(sizes))))
    prior = np.kron(_unevenness(times, begins, effect.course_begins), np.eye(len(sizes)))

    def seen(readings: np.ndarray) -> np.ndarray:
        """Readings (k, n, b, c) as far as they count (N + n·c, k)."""
        shown = twin.projected(readings)
        return np.concatenate([shown - basis @ (basis.T @ shown), HIDDEN * twin.at_stops(readings.mean(axis=2))])

    did = np.concatenate([did, HIDDEN * twin.at_stops(at_stops[None])[:, 0]])
    for _ in range(TURNS):
        columns = _columns(twin, effect, course, sizes, hats, seen)
        wanted = did - seen(twin.adds(effect.following(course))[None])[:, 0] + columns @ (course.values / sizes).ravel()
        design, data = np.concatenate([columns, prior]), np.concatenate([wanted, np.zeros(len(prior))])
        found = lstsq(design, data, lapack_driver='gelsy')[0].reshape(course.values.shape) * sizes
        steady = np.abs(found - course.values).max() <= 0.01 * np.abs(found).max()
        course = Course(times, found)
        if steady:
            break
    return effect.following(course)


def _times(observation: Observation, twin: Twin) -> tuple[np.ndarray, np.ndarray]:
    """Begin and end of each run and times between (m,) [s], and at which a run begins (m,)."""
    view, seconds = observation.view, twin.seconds.reshape(len(observation.view.run), -1)
    span = max(float(np.ptp(seconds)), 1e-9) / TIMES
    at, begins, before = [], [], -1
    for number in view.run[np.sort(np.unique(view.run, return_index=True)[1])]:
        rows = view.run == number
        first, last = float(seconds[rows].min()), float(seconds[rows].max())
        own = set(np.linspace(first, last, 2 + int((last - first) / span)).tolist())
        if view.setup[rows][0] != before:
            own |= {first + share * (last - first) for share in EARLY}
        before = view.setup[rows][0]
        at += sorted(own)
        begins += [True] + [False] * (len(own) - 1)
    return np.array(at), np.array(begins)


def _unevenness(times: np.ndarray, begins: np.ndarray, from_nothing: bool) -> np.ndarray:
    """Rows (m, m) of how far a course walks and jumps, in standard deviations, where it begins ``from_nothing`` too."""
    took = np.diff(times, prepend=times[0]) / max(float(np.ptp(times)), 1e-9)
    most = FREE * np.sqrt(took + begins)
    if from_nothing:
        most[0] = 1e-6
    return (np.eye(len(times)) - np.eye(len(times), k=-1)) / most[:, None]


def _hats(times: np.ndarray, seconds: np.ndarray) -> np.ndarray:
    """Weights (m, t) of the amounts at ``times`` (m,) in those at ``seconds`` (t,), straight between."""
    return np.array([np.interp(seconds, times, row) for row in np.eye(len(times))])


def _columns(twin: Twin, effect: Effect, course: Course, sizes: np.ndarray, hats: np.ndarray,
             seen: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """What each amount of a course does as it is ``seen`` (N, m·k), per plausible range."""
    by_amount = twin.by_amounts(effect, course, STEP * sizes) * sizes[:, None, None]
    at_once = max(1, int(AT_ONCE / by_amount.size))
    parts = []
    for first in range(0, len(hats), at_once):
        some = hats[first:first + at_once, None, :, None] * by_amount
        parts.append(seen(twin.in_bins(some.reshape(-1, *by_amount.shape[1:]))))
    return np.concatenate(parts, axis=1)
