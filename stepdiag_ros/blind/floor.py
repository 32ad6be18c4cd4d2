"""How well can a log be predicted at all?  The gap that the noise alone leaves.

The realised noise moves the reduced χ² of what is held out by some percent off 1.  The same world without
its effects, the same noise falling, shows by how much: no diagnosis can close more of a gap than down to there.
"""

from stepdiag_ros.gap.inference.joint import fit_jointly
from stepdiag_ros.gap.inference.select_effects import noise_of
from stepdiag_ros.gap.preprocess.observe import Observation
from stepdiag_ros.gap.summary.cross_validation import cross_validated


def floor(bare: Observation) -> float:
    """Reduced χ² of what is held out of a log without effects."""
    return cross_validated(fit_jointly(bare, [], noise_of(bare))).before
