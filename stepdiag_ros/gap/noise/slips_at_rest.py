"""Counts that the laser loses while the axes stand, read off the samples of the dwell in which it happens.

A slip in motion lies between two stops.  One in a dwell leaves a part of itself in the dwell's mean, so that there are
two steps from stop to stop, neither a whole number of counts: it looks as if an axis had lost a step.  In the samples
it is seen by itself, to nanometres.  So the dwell counts as if it had lasted without the slip, which begins with the
next stop.  Where errors of arrivals have tails the stops alone may not tell a slip from one arrival that is far off, of
any size; that it stays by as much as was seen in the dwell does.

What settles, swings or hops between two units of length does so in many dwells; what steps in more than a few is no
slip.
"""

from dataclasses import dataclass, replace

import numpy as np

from stepdiag_ros.effects.count_slip import whole_fringes
from stepdiag_ros.estimate.reduce import StopTable
from stepdiag_ros.gap.constants import SUSPICION
from stepdiag_ros.gap.inference.projection import Projection
from stepdiag_ros.gap.noise.arrival_law import evidence_of_best_law, made_tidy
from stepdiag_ros.gap.noise.mode_hops import steps
from stepdiag_ros.model.log import Samples

MOST = 3
"""Dwells of a log in which a counter may slip."""


@dataclass(frozen=True)
class SlipAtRest:
    """A slip of a ``beam`` by ``jump`` ± ``sigma`` [m] in the dwell of stop ``row``, of which the share ``behind`` lies
    behind it."""

    row: int
    beam: int
    jump: float
    sigma: float
    behind: float


def slips_at_rest(samples: Samples, table: StopTable) -> tuple[SlipAtRest, ...]:
    """The whole counts lost inside dwells; none where steps are found in more than a few."""
    beams = samples.values.shape[1]
    least = SUSPICION + float(np.log(beams * max(len(table.displacement_rows), 1)))
    found = [SlipAtRest(int(row), beam, float(jump), float(sigma), float(behind))
             for beam in range(beams)
             for row, jump, sigma, behind in zip(*steps(samples.values[:, beam], table, least), strict=True)]
    if len({slip.row for slip in found}) > MOST:
        return ()
    return tuple(slip for slip in found if whole_fringes(slip.jump, slip.sigma) > 0.0)


def without(table: StopTable, slips: tuple[SlipAtRest, ...]) -> StopTable:
    """The stops with the lengths that their dwells would have had without the slips in them."""
    displacement = table.displacement.copy()
    for slip in slips:
        displacement[slip.row, slip.beam] -= slip.behind * slip.jump
    return replace(table, displacement=displacement)


def staying(slips: tuple[SlipAtRest, ...], space: Projection, rest: StopTable) -> tuple[float, ...]:
    """Of each slip the log evidence that all lengths are off by it from its dwell to the end of its run, against that
    none is; ``rest``: the stops freed of all effects."""
    space = made_tidy(space)
    without_any = evidence_of_best_law(space, rest)

    def off_by(slip: SlipAtRest) -> StopTable:
        after = (rest.run == rest.run[slip.row]) & (rest.time_s > rest.time_s[slip.row])
        displacement = rest.displacement.copy()
        displacement[after, slip.beam] -= slip.jump
        return replace(rest, displacement=displacement)
    return tuple(evidence_of_best_law(space, off_by(slip)) - without_any for slip in slips)


def place_of(table: StopTable, slip: SlipAtRest) -> str:
    """The dwell of a slip, in words."""
    return f'{table.run_ids[table.run[slip.row]]} stop {table.index[slip.row]}'


def words(table: StopTable, slip: SlipAtRest) -> str:
    """What was found, for the page."""
    return (f'displacement: the laser lost count by {slip.jump * 1e6:.3f} µm while the axes stood, in the dwell of '
            + place_of(table, slip)
            + (f', beam {slip.beam}' if table.displacement.shape[1] > 1 else '')
            + '; that dwell counts without it')
