"""How many targets and cycles the standards want, and what a test falls short of.

ISO 230-2 (2014), clause 5: axes up to 2 m, at least five targets a metre and five in all, five cycles; longer axes,
a target every 250 mm on average, one approach in each direction.  ISO 230-6 (2002): five cycles along each body
diagonal; its targets are judged by the rule of ISO 230-2.  The numbers have not been checked against the texts
(decision 0290).
"""

import math

import numpy as np

CYCLES = 5
LEAST_TARGETS = 5
TARGETS_PER_METRE = 5
LONG_AXIS_M = 2.0
LONG_INTERVAL_M = 0.25
EVEN = 1e-3
"""Intervals between targets that differ by a smaller share of their mean are equal."""


def least_targets(length_m: float) -> int:
    """Number of targets that a travel of ``length_m`` [m] wants."""
    if length_m > LONG_AXIS_M:
        return math.ceil(length_m / LONG_INTERVAL_M)
    return max(LEAST_TARGETS, math.ceil(TARGETS_PER_METRE * length_m - 1e-9))


def least_cycles(length_m: float, diagonal: bool = False) -> int:
    """Number of cycles that a travel of ``length_m`` [m] wants; a ``diagonal`` wants five whatever its length."""
    return CYCLES if diagonal or length_m <= LONG_AXIS_M else 1


def shortfalls(name: str, target_m: np.ndarray, cycles: int, diagonal: bool = False) -> list[str]:
    """What a test with targets (m,) [m] and so many cycles falls short of, a sentence each; empty where of nothing."""
    target = np.asarray(target_m, float)
    length = float(np.ptp(target))
    standard = 'ISO 230-6' if diagonal else 'ISO 230-2'
    found = []
    targets, wanted = least_targets(length), least_cycles(length, diagonal)
    if target.size < targets:
        found.append(f'{name}: {_count(target.size, "target")} over {1e3 * length:.0f} mm; '
                     f'{"ISO 230-2" if not diagonal else "the rule of ISO 230-2"} wants at least {targets}.')
    if cycles < wanted:
        found.append(f'{name}: {_count(cycles, "cycle")}; {standard} wants {wanted}.'
                     + (' One cycle has no standard deviation: R and A are not given.'
                        if cycles < 2 and not diagonal else ''))
    steps = np.diff(np.sort(target))
    if not diagonal and steps.size > 1 and np.ptp(steps) < EVEN * steps.mean():
        found.append(f'{name}: the targets are evenly spaced; ISO 230-2 wants a random part in each position, so that '
                     'periodic errors of the axis are sampled.')
    return found


def _count(number: int, noun: str) -> str:
    return f'{number} {noun}' + ('' if number == 1 else 's')
