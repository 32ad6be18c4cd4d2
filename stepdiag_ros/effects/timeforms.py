"""Courses in time that a slow effect may take: no drift follows one formula.

Each course is one or a few functions of time, of order one over the log, that an effect
multiplies with its signature.  Constants are left out: resets and misalignments absorb
them or the signature's own constant stands beside.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from stepdiag_ros.effects.base import Form, StopView

TAU_FRACTIONS = (0.03, 0.06, 0.12, 0.25, 0.5, 1.0)
PERIOD_FRACTIONS = (1.0, 0.7, 0.5, 0.35, 0.25)


@dataclass(frozen=True)
class Course:
    """``values`` (k, n) over the times and their ``rates`` (k, n) [1/s]; ``label``; ``shape`` parameters;
    ``retune``: the course with other ones, None where there are none."""

    label: str
    values: np.ndarray
    rates: np.ndarray
    shape: dict[str, float]
    retune: Callable[[Mapping[str, float]], 'Course'] | None = None


def exponential(since: np.ndarray, tau: float) -> Course:
    """``1 − exp(−t/τ)`` over ``since`` (n,) [s]."""
    fading = np.exp(-since / tau)[None]
    return Course(f'exponential, τ = {tau:.0f} s', 1.0 - fading, fading / tau, {'tau_s': tau},
                  lambda shape: exponential(since, shape['tau_s']))


def cycle(since: np.ndarray, period: float) -> Course:
    """A sine and a cosine of ``period`` [s] over ``since`` (n,) [s], both zero at 0."""
    angular = 2.0 * np.pi / period
    phase = angular * since
    return Course(f'cycle of {period:.0f} s', np.stack([np.sin(phase), np.cos(phase) - 1.0]),
                  angular * np.stack([np.cos(phase), -np.sin(phase)]), {'period_s': period},
                  lambda shape: cycle(since, shape['period_s']))


def courses(time: np.ndarray) -> list[Course]:
    """Courses over ``time`` (n,) [s]: linear, exponentials of several time constants, cycles, smooth
    polynomials of fifth and twelfth degree."""
    span = max(float(np.ptp(time)), 1e-9)
    since = time - time.min()
    result = [Course('linear', (since / span)[None], np.full((1, len(time)), 1.0 / span), {})]
    result += [exponential(since, fraction * span) for fraction in TAU_FRACTIONS]
    result += [cycle(since, fraction * span) for fraction in PERIOD_FRACTIONS]
    scaled = 2.0 * since / span - 1.0
    for label, degree in (('smooth', 5), ('winding', 12)):
        basis = [np.polynomial.legendre.Legendre.basis(d) for d in range(1, degree + 1)]
        result.append(Course(label, np.stack([p(scaled) / d for d, p in enumerate(basis, 1)]),
                             np.stack([p.deriv()(scaled) * 2.0 / span / d
                                       for d, p in enumerate(basis, 1)]), {}))
    return result


def drift_form(view: StopView, course: Course, signature: np.ndarray, names: tuple[str, ...],
               scale: np.ndarray, label: str = '', units: str = 'm') -> Form:
    """A signature (m, n, c) that follows a course: columns at the stops and the slope inside the dwells.

    ``names`` (m,) and ``scale`` (m,) belong to the signature; each is repeated for every function
    of the course.
    """
    count = len(course.values)
    columns = np.einsum('tn,anc->tanc', course.values, signature)
    rates = np.einsum('tn,anc->tanc', course.rates, signature)
    columns = columns.reshape(-1, *view.reading.shape)
    rates = rates.reshape(-1, *view.reading.shape)
    away = view.bin_time - view.bin_time.mean(axis=1, keepdims=True)
    inside = rates[:, :, None, :] * away[None, :, :, None]
    return Form(f'{label}{", " if label else ""}{course.label}', columns,
                tuple(f'{name}{i or ""}' for i in range(count) for name in names),
                np.tile(scale, count), units, inside, course.shape,
                None if course.retune is None else lambda shape: drift_form(
                    view, course.retune(shape), signature, names, scale, label, units))
