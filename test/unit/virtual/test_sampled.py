"""The track of a real control's drives, as moves."""

import numpy as np
import pytest

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.linuxcnc.follow import Track
from stepdiag_ros.virtual import sampled
from stepdiag_ros.virtual.history import now_ns

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


def test_a_track_that_nobody_writes_any_more_is_said(track, monkeypatch):
    path, _, _ = track
    monkeypatch.setattr(sampled, 'PATIENCE_S', 0.01)
    monkeypatch.setattr(sampled, 'DEAD_S', 0.5)
    with pytest.raises(StepdiagError, match='nobody has looked'):
        sampled.SampledHistory(path).follow()
