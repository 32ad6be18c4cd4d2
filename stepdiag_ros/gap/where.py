"""Where the gap lies: shares of the excess by channel and setup, with axis and direction where they matter.

The excess is what the effects put into parity space; where none was named, what the residual has above
its expectation.  A cell is split by the axis that moved or the direction of the run only if nearly all
of it lies in one of them: the smallest description that covers most.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stepdiag_ros.gap.joint import Joint, unexplained
from stepdiag_ros.gap.observe import Observation
from stepdiag_ros.gap.thresholds import LEAST_SHARE

CONCENTRATED = 0.85
"""Share of a cell in one axis or direction from which it is said."""


@dataclass(frozen=True)
class Share:
    """A cell and its share of the excess variance; None: does not matter."""

    channel: str
    setup: str | None
    axis: str | None
    direction: int | None
    share: float

    def to_json_dict(self) -> dict:
        full = {'channel': self.channel, 'setup': self.setup, 'axis': self.axis,
                'direction': self.direction, 'share': self.share}
        return {key: value for key, value in full.items() if value is not None}


def shares(joint: Joint, observation: Observation, found: Sequence) -> tuple[Share, ...]:
    """Cells that hold at least a few percent of the excess, largest first."""
    space, table = joint.parity, joint.observation.table
    rest = unexplained(space, joint.active)
    explained = space.data - rest
    if not found and not joint.active:
        return ()
    excess = explained**2
    if not joint.active:
        # Only shaking or a clock was found: the excess is what the bins show.
        excess = np.maximum(rest**2 - 1.0, 0.0)
    total = float(excess.sum())
    if total <= 0.0:
        return ()
    beams = joint.fit.model.beams
    channel = np.array(['displacement'] * beams + ['spot_x', 'spot_y'])[space.channel]
    setup = np.array(table.setup_names, dtype=object)[table.setup][space.row]
    axis = np.array([{0: 'X', 1: 'Y', 2: 'Z'}.get(int(a)) for a in table.axis],
                    dtype=object)[space.row]
    direction = table.direction[space.row]
    result = []
    for c in ('displacement', 'spot_x', 'spot_y'):
        for s in table.setup_names:
            cell = (channel == c) & (setup == s)
            mass = float(excess[cell].sum())
            if mass < LEAST_SHARE * total:
                continue
            result.append(Share(c, s, _only(axis[cell], excess[cell]),
                                _only(direction[cell], excess[cell]), mass / total))
    return tuple(sorted(result, key=lambda r: -r.share))


def _only(labels: np.ndarray, excess: np.ndarray):
    """The label that holds nearly all of the excess, or None."""
    total = excess.sum()
    for label in set(labels.tolist()) - {None}:
        if excess[labels == label].sum() > CONCENTRATED * total:
            return int(label) if isinstance(label, int) else label
    return None
