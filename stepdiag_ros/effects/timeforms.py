"""Courses in time that a slow effect may take: no drift follows one formula.

Each course is one or a few functions of time, of order one over the log, that an effect
multiplies with its signature.  Constants are left out: resets and misalignments absorb
them or the signature's own constant stands beside.
"""

from dataclasses import dataclass

import numpy as np

TAU_FRACTIONS = (0.03, 0.06, 0.12, 0.25, 0.5, 1.0)
PERIOD_FRACTIONS = (1.0, 0.7, 0.5, 0.35, 0.25)


@dataclass(frozen=True)
class Course:
    """``values`` (k, n) over the times; ``label``; ``shape`` parameters."""

    label: str
    values: np.ndarray
    shape: dict[str, float]


def courses(time: np.ndarray, flexible: bool = True) -> list[Course]:
    """Courses over ``time`` (n,) [s]: linear, exponentials of several time constants, cycles,
    and (``flexible``) a smooth polynomial of fifth degree."""
    span = max(float(np.ptp(time)), 1e-9)
    since = time - time.min()
    result = [Course('linear', (since / span)[None], {})]
    for fraction in TAU_FRACTIONS:
        tau = fraction * span
        result.append(Course(f'exponential, τ = {tau:.0f} s',
                             (1.0 - np.exp(-since / tau))[None], {'tau_s': tau}))
    for fraction in PERIOD_FRACTIONS:
        period = fraction * span
        phase = 2.0 * np.pi * since / period
        result.append(Course(f'cycle of {period:.0f} s',
                             np.stack([np.sin(phase), np.cos(phase) - 1.0]), {'period_s': period}))
    if flexible:
        scaled = 2.0 * since / span - 1.0
        smooth = [np.polynomial.legendre.Legendre.basis(d)(scaled) / d for d in range(1, 6)]
        result.append(Course('smooth', np.stack(smooth), {}))
    return result
