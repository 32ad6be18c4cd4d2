"""Angles of laser and mirror: with U where a log finds them, not listed where it does not."""

import numpy as np

from stepdiag_ros.estimate.evaluate import evaluate
from stepdiag_ros.report.evaluation_page import evaluation_page

from .vacuum import cell, log_of

LINES = ('lin_x', 'lin_y', 'lin_z')


def test_angles_come_with_a_u_that_holds_and_lines_find_none():
    pulls = []
    for seed in range(20, 24):
        of = cell(seed=seed)
        log = log_of(of)
        solution = evaluate(log)
        listed = solution.to_json_dict()['misalignments']
        for name, angles in listed.items():
            assert angles['found'] is (name not in LINES)
            if name in LINES:
                assert set(angles.values()) == {False, None}
                continue
            true = of.misalignments[name]
            for what in ('laser', 'mirror'):
                off = np.subtract(angles[f'{what}_rad'], getattr(true, what))
                assert min(angles[f'{what}_sigma_rad']) > 1e-6
                pulls += list(off / angles[f'{what}_sigma_rad'])
    assert np.mean(np.abs(pulls) < 2.0) > 0.9
    page = evaluation_page(solution, log.description, 'log')
    aligned = page[page.index('How laser and mirror'):page.index('<h2>Residuals')]
    assert aligned.count('not found') == 4 * len(LINES)
    assert aligned.count('±') >= 4 * 4
    squareness = page[page.index('<h2>Squareness'):page.index('<h2>How laser')]
    assert squareness.count('±') >= 3 and 'k = 2' in squareness


def test_what_positioning_is_counted_from_is_stated():
    solution = evaluate(log_of(cell()))
    for words in ('EXX, EYY, EZZ', 'lower corner of the volume', 'without tool'):
        assert words in solution.gauge
        assert words in solution.to_json_dict()['gauge']
