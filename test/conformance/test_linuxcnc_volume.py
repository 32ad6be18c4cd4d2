"""The volumetric component in a running LinuxCNC: exact both ways, limited, ramped, safe, true to limits."""

import time

import numpy as np
import pytest
from drawn_machine import ORIGIN, TOOL, TRAVEL, drawn_errors
from linuxcnc_machine import Running, configured, need_components, sampled

from stepdiag_ros.devices.base import DeviceError
from stepdiag_ros.linuxcnc import configuration, volume
from stepdiag_ros.model.machine import tool_pose
from stepdiag_ros.nodes.patience import Patience

pytestmark = pytest.mark.linuxcnc
ERRORS = drawn_errors()
#: What is seen in each servo cycle: the share of the correction, what it is, what drives and axes are told [mm].
PINS = ('stepdiagkins.scale', *(f'stepdiagkins.error-{a}' for a in 'xyz'), *(f'joint.{j}.pos-cmd' for j in range(3)),
        *(f'axis.{a}.pos-cmd' for a in 'xyz'))
SLEW_M_S, CYCLE_S = 0.1e-3, 1.0e-3
#: Cycles by which LinuxCNC's joints follow its axes.
INTERPOLATION = 2


def compensation(folder, errors=ERRORS, damage=lambda text: text):
    text = damage(volume.volume_file(errors, 'test', TOOL, TRAVEL, ORIGIN))
    return configuration.compensated((folder / 'machine.ini').read_text(), volume=text)


@pytest.fixture(scope='module')
def running(tmp_path_factory):
    need_components()
    folder = tmp_path_factory.mktemp('volume')
    port = configured(folder)
    configuration.write(folder, compensation(folder))
    configuration.write(folder, sampled((folder / 'machine.ini').read_text(), PINS))
    with Running(folder, port) as machine:
        yield machine


def go(running, place, feed=0.2) -> None:
    running.client.move(np.array(place), feed)
    patience = Patience(60.0)
    while not running.client.in_position():
        assert not patience.over()
        time.sleep(0.005)
    running.cycles(50)   # the trajectory settles a few servo cycles later


def settled(running) -> np.ndarray:
    """Joint positions (3,) [m] once the component has ceased to move them."""
    running.cycles(5)
    patience = Patience(60.0)
    while running.hal('getp', 'stepdiagkins.ramping') == 'TRUE':
        assert not patience.over()
    running.cycles(50)   # the control's status follows a few servo cycles later
    return running.joints()


def test_the_round_trip_of_linuxcncs_own_kinematics_test(running):
    """As LinuxCNC's tests/matrixkins does it: command a place, look at the joints, and at the place from feedback."""
    rng = np.random.default_rng(3)
    for place in [np.zeros(3), np.array(TRAVEL), *rng.uniform(0.0, TRAVEL, (12, 3)).round(9)]:
        go(running, place)
        np.testing.assert_allclose(running.client.position(), place, rtol=0.0, atol=1.1e-9)
        expected = volume.inverse(ERRORS, place, TOOL, TRAVEL)[0]
        np.testing.assert_allclose(running.joints(), expected, rtol=0.0, atol=1.1e-9)
        # The independent way: the tool point of the machine with these errors is where the axes say.
        point, _ = tool_pose(ERRORS, running.joints(), np.array(TOOL))
        np.testing.assert_allclose(point[0] - TOOL, place, rtol=0.0, atol=2e-9)


def test_it_follows_at_the_servos_rate(running):
    """In motion, too, axes and joints belong together, cycle for cycle: forward of what the drives are told is where
    the axes were commanded two cycles before, with the component as without it.

    The two cycles are LinuxCNC's own interpolation of joints, which a machine with trivkins has as well.
    """
    for enable in (0, 1):
        if running.hal('getp', 'stepdiagkins.enable') == 'TRUE':    # as it came up: linked to motion.is-all-homed
            running.hal('unlinkp', 'stepdiagkins.enable')
        running.hal('setp', 'stepdiagkins.enable', str(enable))
        settled(running)
        go(running, [0.0, 0.0, 0.0])
        with running.sampling() as rows:
            go(running, TRAVEL)
        table = np.array(rows)
        scale, joints, axes = table[:, 0], 1e-3 * table[:, 4:7] - ORIGIN, 1e-3 * table[:, 7:] - ORIGIN
        assert np.all(scale == enable)
        assert np.abs(np.diff(axes, axis=0)).max() > 1e-4      # at 0.2 m/s: a cycle off would be 0.2 mm off
        forward = joints + enable * volume.field(ERRORS, joints, TOOL, TRAVEL)
        apart = np.linalg.norm(forward[INTERPOLATION:] - axes[:-INTERPOLATION], axis=1)
        print(f'enable {enable}: at most {1e6 * apart.max():.3f} um')
        assert apart.max() < 0.5e-6


def test_soft_limits_hold_for_axes_and_joints(running):
    go(running, [0.1, 0.08, 0.06])
    with pytest.raises(DeviceError, match='limit'):
        running.client.move(np.array([TRAVEL[0] + 1.1e-3, 0.08, 0.06]), 0.1)
        while not running.client.in_position():
            time.sleep(0.01)
    running.client.connect()
    # At the very limit of the axis the joint that would be farther out is refused as well.
    place = np.array([TRAVEL[0] + 1.0e-3, TRAVEL[1], TRAVEL[2]])
    outside = volume.inverse(ERRORS, place, TOOL, TRAVEL)[0][0] > TRAVEL[0] + 1.0e-3
    if outside:
        with pytest.raises(DeviceError):
            go(running, place)
        running.client.connect()
    else:
        go(running, place)
    assert np.all(running.joints() <= np.array(TRAVEL) + 1.0e-3 + 1e-9)
    go(running, [0.1, 0.08, 0.06])


def test_it_ramps_out_and_in_within_its_slew(running):
    """In servo cycles, as LinuxCNC's own sampler sees them: how fast the computer is does not matter."""
    place = np.array([0.2, 0.16, 0.12])
    go(running, place)
    full = running.joints()
    running.hal('unlinkp', 'stepdiagkins.enable')
    with running.sampling() as out:
        running.hal('setp', 'stepdiagkins.enable', '0')
        without = settled(running)
    with running.sampling() as back:
        running.hal('setp', 'stepdiagkins.enable', '1')
        again = settled(running)
    np.testing.assert_allclose(without, place, atol=1.1e-9)
    np.testing.assert_allclose(again, full, atol=1.1e-9)
    least = volume.largest_error(ERRORS, TOOL, TRAVEL) / (SLEW_M_S * CYCLE_S)
    for rows, ends in ((out, (1.0, 0.0)), (back, (0.0, 1.0))):
        scale, joints = np.array(rows)[:, 0], 1e-3 * np.array(rows)[:, 4:7]
        assert (scale[0], scale[-1]) == ends
        under_way = np.count_nonzero((scale > 0.0) & (scale < 1.0))
        assert least - 2 < under_way < least + 2
        assert np.all(np.diff(scale) * (ends[1] - ends[0]) >= 0.0)
        moved = np.abs(np.diff(joints, axis=0))
        assert 0.0 < moved.max() <= SLEW_M_S * CYCLE_S + 1.1e-9      # the sampler writes whole nanometres
        np.testing.assert_allclose(np.sum(moved, axis=0), np.abs(full - place), rtol=0.0, atol=1e-6)
    assert running.hal('getp', 'stepdiagkins.active') == 'TRUE'


def test_another_tool_another_lever(running):
    go(running, [0.15, 0.1, 0.1])
    before = running.joints()
    for axis, offset in zip('xyz', (0.0, 0.0, 0.2), strict=True):
        running.hal('setp', f'stepdiagkins.tool-{axis}', str(1e3 * offset))
    running.hal('setp', 'stepdiagkins.use-tool', '1')
    expected = volume.inverse(ERRORS, [0.15, 0.1, 0.1], (0.0, 0.0, -0.2), TRAVEL)[0]
    assert np.abs(expected - before).max() > 1e-7
    np.testing.assert_allclose(settled(running), expected, atol=1.1e-9)
    running.hal('setp', 'stepdiagkins.use-tool', '0')
    np.testing.assert_allclose(settled(running), before, atol=1.1e-9)
