"""The amounts of an effect in the course of a log, as a table: a reality that follows no formula.

A hall that is heated at noon, a mount that gives way by another amount each time, a lamp that is switched: a simulator
that is to give a log again needs what was there, not what a time constant would have made of it.  Between its times a
course is straight, before and after them it stays.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from stepdiag_ros.guard import limits


@dataclass(frozen=True, repr=False)
class Course:
    """``values`` (m, k) of k amounts at ``seconds`` (m,) since the log began, in rising order."""

    seconds: np.ndarray
    values: np.ndarray

    def at(self, seconds: np.ndarray) -> np.ndarray:
        """Amounts (n, k) at ``seconds`` (n,)."""
        return np.stack([np.interp(seconds, self.seconds, column) for column in self.values.T], axis=1)

    def plus(self, amounts: np.ndarray) -> 'Course':
        """The course with ``amounts`` (k,) more at all times."""
        return Course(self.seconds, self.values + amounts)

    def to_mapping(self) -> dict[str, list]:
        """As cell files have it."""
        return {'seconds': [round(float(s), 6) for s in self.seconds],
                'values': [[float(f'{v:.6g}') for v in row] for row in self.values]}


def parse_course(given: object, amounts: int) -> Course:
    """The course of a cell file, of as many ``amounts``; ValueError with one line where it is none."""
    if not isinstance(given, Mapping) or set(given) != {'seconds', 'values'}:
        raise ValueError('course is a mapping of seconds and values')
    try:
        seconds, values = np.asarray(given['seconds'], float), np.asarray(given['values'], float)
    except (TypeError, ValueError):
        raise ValueError('course.seconds is a list of times, course.values a list of as many rows of numbers') from None
    if seconds.ndim != 1 or not 1 <= len(seconds) <= limits.COURSE_TIMES:
        raise ValueError(f'course.seconds is a list of 1 to {limits.COURSE_TIMES} times')
    if not np.isfinite(seconds).all() or (np.diff(seconds) <= 0.0).any():
        raise ValueError('course.seconds does not rise from time to time; put the rows in order, each time once')
    if values.shape != (len(seconds), amounts) or not np.isfinite(values).all():
        raise ValueError(f'course.values wants {len(seconds)} rows, one for each of course.seconds, of {amounts} '
                         f'number{"s" * (amounts > 1)}')
    return Course(seconds, values)
