"""A machine with drawn errors, its setups, and the sensor as a traced scene."""

import numpy as np
import pytest

from stepdiag_ros.estimate.gauge import to_reference_lines
from stepdiag_ros.estimate.readings import Sight
from stepdiag_ros.model.description import DIAGONALS, LINEAR, Machine, Setup
from stepdiag_ros.model.machine import CURVES, Curve, GeometricErrors
from stepdiag_ros.model.path import start_corner
from stepdiag_ros.virtual.scene import SensorScene

BEAMS = ((0.0, 0.0), (0.03, 0.0), (0.0, 0.03))


@pytest.fixture
def machine():
    """The machine of Dahlem's fig. 5, with a tool."""
    return Machine('fig5', 'FXYZ', (0.8, 0.6, 0.5), (0.01, -0.02, -0.15))


@pytest.fixture
def draw_errors():
    """``draw(machine, steps, seed, angles, framed)``: random curves; ``framed`` ones start and end
    EYX, EZX and EZY at zero, so that no turn of the frame (second order) stands between two answers."""
    def draw(machine, steps, seed=1, angles=True, framed=True):
        rng = np.random.default_rng(seed)
        curves = {}
        for name in CURVES:
            if name[1] in 'ABC' and not angles:
                continue
            position = np.linspace(0.0, machine.volume['XYZ'.index(name[2])], steps + 1)
            value = np.cumsum(rng.normal(0.0, 2e-6, steps + 1))
            value -= value[0]
            if framed and name in ('EYX', 'EZX', 'EZY'):
                value -= value[-1] * position / position[-1]
            curves[name] = Curve(position, value)
        return GeometricErrors(curves, {'EC0Y': 1.1e-5, 'EB0Z': -2.3e-5, 'EA0Z': 1.7e-5})
    return draw


@pytest.fixture
def cell_sights():
    """``make(machine, steps, names)``: the contract's diagonals and two-stop linear setups."""
    def make(machine, steps, names=(*DIAGONALS, *LINEAR), beams=BEAMS):
        from stepdiag_ros.estimate.readings import sight_of
        from stepdiag_ros.model.description import Description, Plan

        setups = {}
        for name in names:
            length = machine.volume['xyz'.index(name[-1])] if name in LINEAR else None
            setups[name] = Setup(name, 0.35, (0.02, 0.01), beams, length, 2 if length else None)
        description = Description(machine, Plan(steps, 'XYZ', 1), setups)
        return [sight_of(description, name) for name in names]
    return make


@pytest.fixture
def traced():
    """The sensor by ray tracing, as a ``Measure``."""
    def measure(sight: Sight, machine, misalignment, point, attitude):
        scene = SensorScene(sight.origin(machine.tool), sight.triad, sight.standoff, sight.beams,
                            sight.psd_offset)
        reading = scene.measure(point, attitude, beam_tilt=misalignment.laser,
                                mirror_tilt=misalignment.mirror)
        return reading.distance, reading.spot
    return measure


@pytest.fixture
def deviation():
    """``worst(solution, truth, kinds)``: largest deviation of the curves whose motion is in ``kinds``."""
    def worst(solution, truth, kinds='XYZABC'):
        true = to_reference_lines(truth)
        found = [np.abs(solution.curve(n)[1] - (true.curves[n](solution.curve(n)[0])
                                                if n in true.curves else 0.0)).max()
                 for n in CURVES if solution.has(n) and n[1] in kinds]
        return max(found)
    return worst


@pytest.fixture
def square_deviation():
    def worst(solution, truth):
        true = to_reference_lines(truth).square
        return max(abs(solution.squareness(n)[0] - true[n]) for n in true if solution.has(n))
    return worst


@pytest.fixture
def diagonal_corners():
    """Start and end of a body diagonal, (2, 3) [m]."""
    def corners(machine, setup):
        start = start_corner(machine, setup)
        end = np.array(machine.volume) - start
        end[2] = machine.volume[2]
        return np.stack([start, end])
    return corners


@pytest.fixture
def plan_of():
    """``make(steps, repeats, beams, chain, names)``: the machine of fig. 5 with a tool, its setups and plan."""
    from stepdiag_ros.model.description import Description, Plan

    def make(steps=4, repeats=2, beams=((0.0, 0.0),), chain='FXYZ', names=(*DIAGONALS, *LINEAR)):
        machine = Machine('planned', chain, (0.8, 0.6, 0.5), (0.01, -0.02, -0.15))
        setups = {}
        for name in names:
            length = machine.volume['xyz'.index(name[-1])] if name in LINEAR else None
            setups[name] = Setup(name, 0.35, (0.02, 0.01), beams, length, 2 if length else None)
        return Description(machine, Plan(steps, 'XYZ', repeats), setups)
    return make


@pytest.fixture
def misaligned():
    """``draw(description, size, seed)``: lasers and mirrors of the diagonals turned; linear setups aligned."""
    from stepdiag_ros.model.sensor import Misalignment

    def draw(description, size, seed=3):
        rng = np.random.default_rng(seed)
        return {name: Misalignment(tuple(rng.uniform(-size, size, 2)), tuple(rng.uniform(-size, size, 2)))
                for name in description.setups if name in DIAGONALS}
    return draw


@pytest.fixture
def silent():
    """``table(table)``: the table of sensors without noise."""
    from dataclasses import replace

    def make(table):
        return replace(table, displacement_scatter=np.zeros_like(table.displacement),
                       spot_scatter=np.zeros_like(table.spot))
    return make
