"""The log of a virtual machine whose control takes something off everywhere in its volume."""

from collections.abc import Callable

import numpy as np
import pytest

from stepdiag_ros.model.log import CalibrationLog
from stepdiag_ros.model.machine import compose, rotation
from stepdiag_ros.virtual.cell import Cell
from stepdiag_ros.virtual.offline import simulate_log
from stepdiag_ros.virtual.world import World


def compensated_log(cell: Cell, off: Callable[[np.ndarray], np.ndarray]) -> CalibrationLog:
    """What the cell gives when its joints are moved by ``off``: rotations stay, whatever is taken off the tool."""
    class Compensated(World):
        def pose(self, moment, angle):
            machine = self.cell.description.machine
            joints = moment.position - off(moment.position)
            motions = [self.cell.geometry.motions(axis, joints[:, axis]) for axis in range(3)]
            point, attitude = compose(machine.chain, np.array([shift for shift, _ in motions]),
                                      np.array([turn for _, turn in motions]), machine.tool)
            return point + moment.shift, rotation(angle + moment.turn) @ attitude
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr('stepdiag_ros.virtual.offline.World', Compensated)
        return simulate_log(cell)
