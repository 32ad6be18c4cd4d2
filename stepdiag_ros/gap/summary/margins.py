"""How the gap's excess shares out by channel, setup, axis, direction, time and state; each margin adds up to one.

The states of a machine that measures are moving, settling and at rest.  What is wrong at rest shows in the means of
the stops, what settles or shakes inside them, both squared in standard deviations of parity space; stamps are wrong
only while axes move, and how far is known from the moves: (offset/σ)².
"""

from dataclasses import dataclass

import numpy as np

from stepdiag_ros.gap.inference.joint import Joint, unexplained
from stepdiag_ros.gap.preprocess.observe import channels
from stepdiag_ros.gap.summary.where import excess_of

THIRDS = ('first', 'middle', 'last')
MOVING, SETTLING, AT_REST = 'moving', 'settling', 'at_rest'


@dataclass(frozen=True)
class Margins:
    """Shares of the excess: ``cells`` (3, s) by channel and setup, by ``axis`` moved (X, Y, Z; 'first stop'),
    ``direction`` (forward, backward), ``time`` (thirds of the log) and ``state`` (moving, settling, at_rest).

    All but ``state`` are of what is read at the stops, and empty where nothing is wrong there.
    """

    cells: np.ndarray
    setups: tuple[str, ...]
    axis: dict[str, float]
    direction: dict[str, float]
    time: dict[str, float]
    state: dict[str, float]

    def to_json_dict(self) -> dict:
        by_channel, by_setup = self.cells.sum(axis=1), self.cells.sum(axis=0)
        at_stops = {} if not self.cells.any() else {
            'channel': dict(zip(channels(1), by_channel.tolist(), strict=True)),
            'setup': dict(zip(self.setups, by_setup.tolist(), strict=True)),
            'axis': self.axis, 'direction': self.direction, 'time': self.time}
        return {**at_stops, 'state': self.state}


def margins(joint: Joint, unmodelled: bool, stamps: float, standing: bool) -> Margins | None:
    """Shares of what ``joint`` explains and, where something is ``unmodelled``, of what it leaves; ``stamps``: squared
    standard deviations by which stamps are wrong; ``standing``: whether anything is wrong while the machine stands.
    None where there is no excess."""
    table, beams = joint.observation.table, joint.fit.model.beams
    setups = tuple(table.setup_names)
    excess = excess_of(joint, unmodelled) if standing else np.zeros(joint.fit.residual.shape)
    total = float(excess.sum())
    if total <= 0.0:
        return None if stamps <= 0.0 else Margins(np.zeros((3, len(setups))), setups, {}, {}, {}, _states(1.0, 0.0))
    excess = excess / total
    cells = np.zeros((3, len(setups)))
    for row, columns in enumerate(channels(beams).values()):
        np.add.at(cells[row], table.setup, excess[:, columns].sum(axis=1))
    stops = excess.sum(axis=1)
    axis = {letter: float(stops[table.axis == k].sum()) for k, letter in enumerate('XYZ')}
    axis['first stop of a run'] = max(0.0, 1.0 - sum(axis.values()))
    direction = {'forward': float(stops[table.direction > 0].sum()),
                 'backward': float(stops[table.direction < 0].sum())}
    gone = (table.time_s - table.time_s.min()) / max(float(np.ptp(table.time_s)), 1e-9)
    third = np.minimum(3.0 * gone, 2.0).astype(int)
    time = {f'{said} third of the log': float(stops[third == k].sum()) for k, said in enumerate(THIRDS)}
    still, inside = _standing(joint, unmodelled)
    return Margins(cells, setups, axis, direction, time, _states(stamps / (stamps + still), inside))


def _standing(joint: Joint, unmodelled: bool) -> tuple[float, float]:
    """Squares in parity space of all that is seen while the machine stands, and the share of it inside the stops."""
    space = joint.parity
    rest = unexplained(space, joint.active)
    seen = (space.data - rest) ** 2 if joint.active else np.maximum(rest**2 - 1.0, 0.0)
    total = max(float(seen.sum()), 1e-300)
    swings = joint.observation.swings is not None and not joint.active and not unmodelled
    return total, 1.0 if swings else float(seen[space.stops:].sum()) / total


def _states(moving: float, inside: float) -> dict[str, float]:
    return {MOVING: moving, SETTLING: (1.0 - moving) * inside, AT_REST: (1.0 - moving) * (1.0 - inside)}
