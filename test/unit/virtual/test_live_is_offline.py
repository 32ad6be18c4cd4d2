"""The live cell and the offline log are one machine: same errors, same draws at each arrival."""

import time
from pathlib import Path

import numpy as np

from stepdiag_ros.model.log import DONE, DWELL
from stepdiag_ros.model.path import stops
from stepdiag_ros.virtual.cell import load_cell
from stepdiag_ros.virtual.cell_process import CellProcess
from stepdiag_ros.virtual.offline import simulate_log

from .clients import clients

DEMO = Path(__file__).resolve().parents[3] / 'cells' / 'demo.yaml'
STOPS = 6


def offline_means(cell) -> np.ndarray:
    """(STOPS, 3) [m]: displacement and spot at the first stops of the first run."""
    log = simulate_log(cell, setups=('ppp',), in_motion=False)
    begin = log.steps.time_ns[log.steps.phase == DWELL][:STOPS]
    end = log.steps.time_ns[log.steps.phase == DONE][:STOPS]
    return np.array([np.concatenate([samples.values[(samples.time_ns >= b) & (samples.time_ns < e)].mean(0)
                                     for samples in (log.displacement, log.spot)])
                     for b, e in zip(begin, end, strict=True)])


def test_the_first_stops_agree_to_the_noise(tmp_path):
    cell = load_cell(DEMO)
    with (CellProcess(DEMO, tmp_path / 'runtime') as process,
          clients(process.start(), 'ppp') as (cnc, meter, detector)):
        live = []
        for number, place in enumerate(stops(cell.description, 'ppp').positions[:STOPS]):
            cnc.move(place, cell.motion.feed)
            while not cnc.in_position():
                time.sleep(0.002)
            if number == 0:
                meter.reset()
            spots, lengths = [], []
            while sum(map(len, spots)) < 100 or sum(map(len, lengths)) < 100:
                block = detector.read_block(100, 1e-3)
                spots.append(np.stack([block.x_m, block.y_m], axis=1))
                lengths.append(meter.read_block(100, 1e-3).displacement_m)
            live.append([np.concatenate(lengths).mean(), *np.concatenate(spots).mean(axis=0)])
    difference = np.array(live) - offline_means(cell)
    # The zero is a mean of sixteen readings; each run has its own.
    difference[:, 0] -= difference[:, 0].mean()
    # Far below what the arrivals scatter by: their errors are the same, not only as large.
    assert np.abs(difference[:, 0]).max() < 0.02 * cell.description.noise.position_repeatability
    assert np.abs(difference[:, 1:]).max() < 2e-7
