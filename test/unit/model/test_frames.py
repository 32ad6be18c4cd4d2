"""Frames for viewers against the contract's geometry, in all chains and for ways of their own."""

import numpy as np
import pytest

from stepdiag_ros.model.description import Description
from stepdiag_ros.model.frames import BASE, LASER, MIRROR, PSD, Frame, View, axis_frames
from stepdiag_ros.model.machine import GeometricErrors, tool_pose
from stepdiag_ros.model.path import stops
from stepdiag_ros.model.sensor import Misalignment, measure

SETUPS = {'standoff': 0.35, 'psd_offset': [0.02, 0.01], 'beams': [[0.0, 0.0], [0.015, 0.0], [0.0, 0.015]]}


def description(chain='FXYZ'):
    face = {**SETUPS, 'from': [0.8, 0, 0], 'to': [0, 0.6, 0], 'moves': 'XY'}
    return Description.from_dict({
        'schema': 1, 'machine': {'name': 'm', 'chain': chain, 'volume': [0.8, 0.6, 0.5], 'tool': [0.01, -0.02, -0.15]},
        'plan': {'steps': 3}, 'setups': {'ppp': SETUPS, 'nnp': SETUPS, 'lin_z': SETUPS, 'face': face}})


def rotated(q, vector):
    """A vector turned by a quaternion (x, y, z, w), by the product q v q*."""
    u, w = np.array(q[:3]), q[3]
    return vector + 2.0 * np.cross(u, np.cross(u, vector) + w * vector)


def placed(frames, name):
    """Origin and axes (rows) of a frame in the machine frame, by its quaternions."""
    if name == BASE:
        return np.zeros(3), np.eye(3)
    frame = next(f for f in frames if f.name == name)
    origin, axes = placed(frames, frame.parent)
    return (origin + frame.origin @ axes,
            np.array([rotated(frame.quaternion, np.eye(3)[i]) @ axes for i in range(3)]))


@pytest.mark.parametrize('chain', ['FXYZ', 'XFYZ', 'YXFZ', 'ZYXF', 'FZYX'])
@pytest.mark.parametrize('setup', ['ppp', 'nnp', 'lin_z', 'face'])
def test_mirror_stands_where_the_machine_holds_it_and_looks_at_the_laser(chain, setup):
    d = description(chain)
    view = View(d, setup)
    for position in stops(d, setup).positions:
        frames = [*axis_frames(chain, position), *view.fixed_frames()]
        point, _ = tool_pose(GeometricErrors.zero(), position, np.array(d.machine.tool), chain)
        mirror, axes = placed(frames, MIRROR)
        np.testing.assert_allclose(mirror, point[0], atol=1e-15)
        laser, beam = placed(frames, LASER)
        np.testing.assert_allclose(axes[0], -beam[0], atol=1e-15)
        assert np.linalg.det(axes) == pytest.approx(1.0) and np.linalg.det(beam) == pytest.approx(1.0)
        detector, _ = placed(frames, PSD)
        np.testing.assert_allclose(detector, view.psd_start, atol=1e-15)


@pytest.mark.parametrize('setup', ['ppp', 'nnp', 'lin_z', 'face'])
def test_beams_are_as_long_as_the_interferometer_reads_and_meet_the_mirror(setup):
    d = description()
    view, path = View(d, setup), stops(d, setup).positions
    point, attitude = tool_pose(GeometricErrors.zero(), path, np.array(d.machine.tool))
    lengths, spot = measure(d.machine, d.setups[setup], Misalignment(), point, attitude)
    np.testing.assert_allclose(spot, 0.0, atol=1e-15)    # a beam that comes back into itself, as it is drawn
    for row, position in enumerate(path):
        strikes = view.strikes(position)
        np.testing.assert_allclose(np.linalg.norm(strikes[:-1] - view.starts, axis=1), lengths[row], atol=1e-15)
        on_mirror = (strikes - point[row]) @ view.triad[:2].T - view.mirror_centre
        assert (np.abs(on_mirror) <= view.mirror_half).all()


def test_quaternions_of_every_turn():
    rng = np.random.default_rng(1)
    turns = [np.linalg.qr(rng.normal(size=(3, 3)))[0] for _ in range(50)]
    turns = [t * np.linalg.det(t) for t in turns] + [np.eye(3)]
    turns += [np.diag(s) for s in ((1, -1, -1), (-1, 1, -1), (-1, -1, 1))]
    for axes in turns:
        frame = Frame('a', BASE, np.zeros(3), np.asarray(axes, float))
        assert np.linalg.norm(frame.quaternion) == pytest.approx(1.0)
        np.testing.assert_allclose([rotated(frame.quaternion, e) for e in np.eye(3)], axes, atol=1e-12)
