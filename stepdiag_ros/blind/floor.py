"""How well can a log be foretold at all?  The gap that the noise alone leaves.

The noise that fell moves the reduced χ² of what is held out by some percent off 1.  The same world without
its effects, the same noise falling, shows by how much: no diagnosis can close more of a gap than down to there.
"""

from stepdiag_ros.gap.closing import closing
from stepdiag_ros.gap.joint import fit_jointly
from stepdiag_ros.gap.observe import Observation
from stepdiag_ros.gap.turns import noise_of


def floor(bare: Observation) -> float:
    """Reduced χ² of what is held out of a log without effects."""
    return closing(fit_jointly(bare, [], noise_of(bare))).before
