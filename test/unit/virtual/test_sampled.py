"""The track of a real control's drives, as moves."""

import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.linuxcnc.follow import Track
from stepdiag_ros.virtual import sampled
from stepdiag_ros.virtual.ahead import Ahead
from stepdiag_ros.virtual.cell import load_cell
from stepdiag_ros.virtual.history import now_ns
from stepdiag_ros.virtual.world import World

CELLS = Path(__file__).resolve().parents[3] / 'cells'
MS = 1_000_000


@pytest.fixture
def track(tmp_path):
    """A machine that stood, was given a setup, moved along X for 100 ms, stood, moved along Y."""
    track = Track(str(tmp_path / 'track.bin'))
    begin = now_ns() - 2_000 * MS

    def look(ms, setup, x, y):
        track.look(begin + ms * MS, setup, (x, y, 0.0))
    for ms in range(0, 100, 2):
        look(ms, -1 if ms < 50 else 0, 0.0, 0.0)
    for ms in range(100, 200, 2):
        look(ms, 0, 1e-3 * (ms - 100), 1e-9 * (ms - 100))
    for ms in range(200, 300, 2):
        look(ms, 0, 0.1, 1e-7)
    for ms in range(300, 400, 2):
        look(ms, 0, 0.1, 1e-7 + 1e-3 * (ms - 300))
    return tmp_path / 'track.bin', begin, track


def test_moves_begin_where_the_machine_left_its_rest(track, monkeypatch):
    path, begin, _ = track
    monkeypatch.setattr(sampled, 'PATIENCE_S', 0.01)
    history = sampled.SampledHistory(path)
    assert history.follow() == 4
    starts = (history.records['start_ns'] - begin) / MS
    np.testing.assert_allclose(starts, [0, 50, 100, 300], atol=2.1)
    assert list(history.records['setup']) == [-1, 0, 0, 0]
    # A compensation's micrometre along the other axis is no move of it.
    np.testing.assert_array_equal(np.sign(history.records['direction']), [[0, 0, 0], [0, 0, 0], [1, 0, 0], [0, 1, 0]])


def test_places_are_those_of_the_drives(track, monkeypatch):
    path, begin, _ = track
    monkeypatch.setattr(sampled, 'PATIENCE_S', 0.01)
    history = sampled.SampledHistory(path)
    history.follow()
    times = begin + np.array([-5, 60, 151, 250, 351, 5000]) * MS
    number, place, actual, share = history.locate(times, 0.0)
    np.testing.assert_allclose(place[:, 0], [0.0, 0.0, 0.051, 0.1, 0.1, 0.1], atol=1e-12)
    np.testing.assert_allclose(place[:, 1], [0.0, 0.0, 5.1e-8, 1e-7, 0.0510001, 0.0980001], atol=1e-9)
    assert list(number) == [0, 1, 2, 2, 3, 3] and np.all(share == 1.0) and np.array_equal(place, actual)


def test_what_comes_later_is_taken_in(track, monkeypatch):
    path, begin, writer = track
    monkeypatch.setattr(sampled, 'PATIENCE_S', 0.01)
    history = sampled.SampledHistory(path)
    history.follow()
    for ms in range(400, 500, 2):
        writer.look(begin + ms * MS, 1, (0.1, 0.0980001, 0.0))
    assert history.follow() == 5
    assert history.records['setup'][-1] == 1


WRITER = """
import sys, time
from stepdiag_ros.linuxcnc.follow import Track
track, x, end = Track(sys.argv[1]), 0.0, time.monotonic() + 1.0
while time.monotonic() < end:
    x += 1e-6
    track.look(time.monotonic_ns(), 0, (x, 0.0, 0.0))
"""


def test_whoever_looks_at_any_moment_sees_whole_numbers(tmp_path):
    """Seen half written, the newest look was as old as the clock: sensors took LinuxCNC for dead and lost an answer."""
    path = tmp_path / 'track.bin'
    with subprocess.Popen([sys.executable, '-c', WRITER, str(path)]) as writer:
        end = time.monotonic() + 60.0
        while not path.exists() and time.monotonic() < end:
            time.sleep(0.01)
        header, seen = np.memmap(path, '<i8', 'r', 0, 2), []
        while writer.poll() is None:
            seen.append((int(header[0]), int(header[1])))
    seen = np.array(seen)
    assert writer.returncode == 0 and len(np.unique(seen[:, 0])) > 10
    assert np.all(np.diff(seen, axis=0) >= 0)


def test_a_track_that_nobody_writes_any_more_is_said(track, monkeypatch):
    path, _, _ = track
    monkeypatch.setattr(sampled, 'PATIENCE_S', 0.01)
    monkeypatch.setattr(sampled, 'DEAD_S', 0.5)
    with pytest.raises(StepdiagError, match='nobody has looked'):
        sampled.SampledHistory(path).follow()


@pytest.mark.parametrize('looks_at', [90, 130, 400])
def test_a_late_look_keeps_no_machine_moving_that_stands(tmp_path, monkeypatch, looks_at):
    """A machine that brakes for 50 ms, begins to at 50 ms, stands from 100 ms on; nobody looks from 70 ms to the end of
    a gap, which may be long after its dwell has begun."""
    monkeypatch.setattr(sampled, 'PATIENCE_S', 0.01)
    track, begin = Track(str(tmp_path / 'track.bin')), now_ns() - 2_000 * MS

    def place(ms):
        braking = min(max(ms - 50, 0), 50)
        return 1e-3 * (min(max(ms, 0), 50) + braking - braking**2 / 100.0), 0.0, 0.0
    for ms in [*range(-40, 71, 2), *range(looks_at, 450, 2)]:
        track.look(begin + ms * MS, 0, place(ms))
    for ms in range(450, 500, 2):
        track.look(begin + ms * MS, 0, (place(ms)[0], 1e-3 * (ms - 450), 0.0))
    history = sampled.SampledHistory(tmp_path / 'track.bin')
    assert history.follow() == 3
    times = np.arange(104, 450, 3)
    _, seen, _, _ = history.locate(begin + times * MS, 0.0)
    np.testing.assert_allclose(seen[:, 0], place(200)[0], rtol=0.0, atol=0.0 if looks_at > 100 else 1e-12)
    # While it moves, straight lines between looks are all that is known: the track never runs backwards.
    _, under_way, _, _ = history.locate(begin + np.arange(-40, 104, 1) * MS, 0.0)
    assert np.all(np.diff(under_way[:, 0]) >= 0.0)


def test_a_sensor_sees_no_further_than_the_newest_look(tmp_path, monkeypatch):
    """What will be seen is worked out ahead only of a control that says what it will do: a watched one was shown
    standing meanwhile, and by microns beside the place where it had long said that it stood."""
    cell = load_cell(CELLS / 'demo.yaml')
    setup = next(iter(cell.description.setups))
    track, begin, clock = Track(str(tmp_path / 'track.bin')), now_ns(), [0]
    monkeypatch.setattr(sampled, 'now_ns', lambda: clock[0])
    for ms in range(0, 50, 2):
        track.look(begin + ms * MS, 0, (0.0, 0.0, 0.0))
    clock[0] = begin + 48 * MS
    history = sampled.SampledHistory(tmp_path / 'track.bin')
    history.follow()
    world = World(cell, history, begin, [])
    ahead, times, seen = Ahead(world, 0), [], []
    for ms in range(50, 150):
        braking = min(ms - 50, 60)
        track.look(begin + ms * MS, 0, (1e-3 * (braking - braking**2 / 120.0), 0.0, 0.0))
        clock[0] = begin + ms * MS
        if ms % 5 == 0:
            times.append(clock[0])
            seen.append(ahead.read(np.array([clock[0]]), setup).length[0])
    whole = world.read(np.array(times), setup).length
    assert np.ptp(whole) > 0.01
    np.testing.assert_allclose(seen, whole, rtol=0.0, atol=1e-6)    # but for the error of an arrival
