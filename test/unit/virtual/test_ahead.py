"""What is worked out ahead is what the sensor sees, while axes move and while they stand."""

from pathlib import Path

import numpy as np
import pytest

from stepdiag_ros.virtual.ahead import STEP_NS, STILL_STEP_NS, Ahead
from stepdiag_ros.virtual.cell import load_cell
from stepdiag_ros.virtual.history import History
from stepdiag_ros.virtual.motion import point_to_point
from stepdiag_ros.virtual.world import World

CELL = Path(__file__).resolve().parents[3] / 'cells' / 'demo.yaml'
BEGIN = 10**12
MS = 1_000_000


class Announced(History):
    """A history whose moves are all known when they are appended."""

    def follow(self) -> int:
        return len(self)


@pytest.fixture
def moved():
    """A world in which X has just been told to go 0.1 m, the window that looks at it, and how to send X further."""
    cell, history = load_cell(CELL), Announced()
    motion, at = cell.motion, [0.0]

    def go(start_ns: int, to: float) -> None:
        profile = point_to_point(abs(to - at[0]), motion.feed, motion.acceleration, motion.jerk)
        history.append(start_ns, np.array([at[0], 0.0, 0.0]), np.array([to, 0.0, 0.0]), profile, 0)
        at[0] = to
    go(BEGIN, 0.1)
    world = World(cell, history, BEGIN)
    return cell.setup_names[0], world, Ahead(world, 0), go


@pytest.mark.parametrize(('since_ms', 'step_ns'), [(0, STEP_NS), (300, STEP_NS), (3000, STILL_STEP_NS)])
def test_what_was_worked_out_is_what_is_seen(moved, since_ms, step_ns):
    setup, world, ahead, _ = moved
    for tick in range(40):
        times = BEGIN + since_ms * MS + tick * 5 * MS + np.arange(5) * MS + 123_456
        told, seen = ahead.read(times, setup), world.read(times, setup)
        np.testing.assert_allclose(told.length, seen.length, atol=2e-8)
        np.testing.assert_allclose(told.spot, seen.spot, atol=2e-8)
        assert ahead._time[1] - ahead._time[0] == step_ns or since_ms < 3000


def test_a_move_ends_what_was_worked_out_for_axes_that_stand(moved):
    setup, world, ahead, go = moved
    start = BEGIN + 3000 * MS
    ahead.read(np.array([start]), setup)
    go(start + 10 * MS, 0.2)
    times = start + np.arange(60) * MS + 500_000
    for time in times:
        told, seen = ahead.read(time[None], setup), world.read(time[None], setup)
        np.testing.assert_allclose(told.length, seen.length, atol=2e-8)
    assert np.ptp(world.read(times, setup).length) > 1e-5


def test_where_an_effect_acts_axes_that_stand_are_looked_at_as_closely_as_those_that_move(moved):
    setup, world, ahead, _ = moved
    world.effects = [object()]
    assert not world.stands_from(BEGIN + 3000 * MS)
    world.effects = []
    assert world.stands_from(BEGIN + 3000 * MS) and not world.stands_from(BEGIN)
