"""What a live run and its bag hold to be looked at: means for plots, frames, markers, errors so far."""

import importlib

import numpy as np
import pytest
from mcap.reader import make_reader
from rclpy.serialization import deserialize_message

from stepdiag_ros.bag.reader import read_log
from stepdiag_ros.bag.shown import (
    DISPLACEMENT_MEAN,
    ERRORS,
    ERRORS_SO_FAR,
    FIXED_FRAMES,
    FRAMES,
    SCENE,
    SHOWN,
    SPOT_MEAN,
)
from stepdiag_ros.model.log import DWELL
from stepdiag_ros.model.path import local_triad
from stepdiag_ros.nodes.stamps import ns_of


@pytest.fixture(scope='module')
def bag(cell, tmp_path_factory):
    """The bag of one calibration, and its messages of :data:`SHOWN` by topic."""
    operator, path = cell.operator, cell.runtime.parent / 'shown'
    operator.set_parameters('gap_monitor', {'period': 0.5})
    operator.new_log(str(path))
    assert operator.calibrate(repeats=2).succeeded
    operator.evaluate()
    operator.bring('recorder', 'inactive')
    messages: dict[str, list] = {topic: [] for topic in SHOWN}
    with open(next(path.glob('*.mcap')), 'rb') as stream:
        for schema, channel, message in make_reader(stream).iter_messages():
            topic = channel.topic.removeprefix('/tiny/')
            if topic in SHOWN:
                package, _, name = SHOWN[topic].split('/')
                kind = getattr(importlib.import_module(f'{package}.msg'), name)
                assert schema.name == SHOWN[topic]
                messages[topic].append((message.publish_time, deserialize_message(message.data, kind)))
    return path, messages


def test_means_are_those_of_the_blocks_and_about_twenty_a_second(bag):
    path, messages = bag
    log = read_log(path)
    for topic, samples, field in ((DISPLACEMENT_MEAN, log.displacement, 'displacement'), (SPOT_MEAN, log.spot, 'x')):
        shown = [message for _, message in messages[topic]]
        times = np.array([ns_of(message.header.stamp) for message in shown])
        rate = (len(times) - 1) / (1e-9 * np.ptp(times))
        assert 10.0 < rate < 22.0, rate
        compared = 0
        for message, time in zip(shown, times, strict=True):
            near = samples.values[np.abs(samples.time_ns - time) < 60_000_000, 0]
            # At rest a sample more or less makes no difference.
            if len(near) >= message.samples and np.ptp(near) < 1e-6 and np.isfinite(getattr(message, field)):
                assert getattr(message, field) == pytest.approx(near.mean(), abs=1e-6)
                compared += 1
        assert compared > 5


def chain(transforms, frame):
    """Origin and axes of a frame in its tree's root, by hand: 4x4."""
    whole = np.eye(4)
    while frame in transforms:
        parent, t = transforms[frame]
        x, y, z, w = t.rotation.x, t.rotation.y, t.rotation.z, t.rotation.w
        turn = np.array([[1 - 2 * (y*y + z*z), 2 * (x*y - z*w), 2 * (x*z + y*w)],
                         [2 * (x*y + z*w), 1 - 2 * (x*x + z*z), 2 * (y*z - x*w)],
                         [2 * (x*z - y*w), 2 * (y*z + x*w), 1 - 2 * (x*x + y*y)]])
        step = np.eye(4)
        step[:3, :3], step[:3, 3] = turn, (t.translation.x, t.translation.y, t.translation.z)
        whole, frame = step @ whole, parent
    return frame, whole


def test_frames_lead_from_the_machine_to_mirror_and_laser(bag):
    path, messages = bag
    log = read_log(path)
    machine, steps = log.description.machine, log.steps
    dwells = steps.phase == DWELL
    at = dict(zip(steps.time_ns[dwells].tolist(), steps.commanded[dwells], strict=True))
    fixed = sorted((ns_of(m.transforms[0].header.stamp), m) for _, m in messages[FIXED_FRAMES])
    looked = 0
    for _, moving in messages[FRAMES]:
        time = ns_of(moving.transforms[0].header.stamp)
        if time not in at:
            continue
        still = [m for since, m in fixed if since <= time][-1]
        transforms = {t.child_frame_id: (t.header.frame_id, t.transform)
                      for t in (*still.transforms, *moving.transforms)}
        root, mirror = chain(transforms, 'tiny/mirror')
        assert root == 'tiny/base_link'
        # The contract: p = commanded + tool, mirror's normal -d; the laser looks along d from S + tool - standoff d.
        np.testing.assert_allclose(mirror[:3, 3], at[time] + machine.tool, atol=1e-12)
        _, laser = chain(transforms, 'tiny/laser')
        d = laser[:3, 0]
        np.testing.assert_allclose(mirror[:3, 0], -d, atol=1e-12)
        np.testing.assert_allclose(laser[:3, :3].T, local_triad(d)[[2, 0, 1]], atol=1e-12)
        np.testing.assert_allclose(laser[:3, 3], np.array(machine.tool) - 0.20 * d, atol=1e-12)
        looked += 1
    assert looked == np.count_nonzero(dwells)
    directions = {tuple(np.round(chain({t.child_frame_id: (t.header.frame_id, t.transform) for t in m.transforms},
                                       'tiny/laser')[1][:3, 0], 6)) for _, m in fixed}
    want = np.array(machine.volume) / np.linalg.norm(machine.volume)
    assert directions == {tuple(np.round(want, 6)), (1.0, 0.0, 0.0)}


def test_markers_show_volume_mirror_and_a_beam_that_ends_at_the_mirror(bag):
    path, messages = bag
    log = read_log(path)
    steps = log.steps
    dwells = np.flatnonzero(steps.phase == DWELL)
    assert len(messages[SCENE]) == len(dwells)    # one a stop
    for row, (_, array) in zip(dwells, messages[SCENE], strict=True):
        named = {marker.ns: marker for marker in array.markers}
        assert {'volume', 'path', 'laser', 'mirror', 'beam', 'psd_beam', 'run'} == named.keys()
        assert named['run'].text == steps.run_ids[steps.run[row]]
        start, end = (np.array([p.x, p.y, p.z]) for p in named['beam'].points)
        d = (end - start) / np.linalg.norm(end - start)
        point = steps.commanded[row] + log.description.machine.tool
        assert (point - end) @ d == pytest.approx(0.0, abs=1e-12)    # in the mirror's plane, which is normal to d
        off = point - end
        assert np.abs(off).max() < max(named['mirror'].scale.y, named['mirror'].scale.z)
        assert len(named['volume'].points) == 24 and named['mirror'].header.frame_id == 'tiny/mirror'


def test_errors_build_as_they_are_measured(bag):
    _, messages = bag
    so_far = [message for _, message in messages[ERRORS_SO_FAR]]
    assert so_far and not any(message.complete for message in so_far)
    last = messages[ERRORS][-1][1]
    assert last.complete and last.dof >= max(message.dof for message in so_far)
    names = [curve.name for curve in last.curves]
    assert names[:3] == ['EXX', 'EYX', 'EZX'] and len(names) == 18
    for curve in last.curves:
        assert len(curve.position) == len(curve.value) == len(curve.sigma) == len(curve.sigma_repeatability)
        assert curve.unit == ('m' if curve.name[1] in 'XYZ' else 'rad')


def test_what_is_shown_weighs_little(bag):
    """Of a bag that samples at 200 Hz; at 1 kHz a fifth of this."""
    path, _ = bag
    sizes: dict[bool, int] = {True: 0, False: 0}
    with open(next(path.glob('*.mcap')), 'rb') as stream:
        for _, channel, message in make_reader(stream).iter_messages():
            sizes[channel.topic.removeprefix('/tiny/') in SHOWN] += len(message.data)
    assert sizes[True] < 3.0 * sizes[False], sizes
