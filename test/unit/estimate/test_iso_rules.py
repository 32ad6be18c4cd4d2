"""How many targets and cycles the standards want."""

import numpy as np
import pytest

from stepdiag_ros.estimate.iso_rules import least_cycles, least_targets, shortfalls


@pytest.mark.parametrize(('length', 'targets'), [(0.2, 5), (1.0, 5), (1.01, 6), (1.6, 8), (2.0, 10), (2.01, 9),
                                                 (4.0, 16)])
def test_targets_of_a_travel(length, targets):
    assert least_targets(length) == targets


def test_cycles():
    assert (least_cycles(2.0), least_cycles(2.5), least_cycles(2.5, diagonal=True)) == (5, 1, 5)


def test_a_full_test_with_uneven_targets_falls_short_of_nothing():
    assert shortfalls('lin_x', np.array([0.0, 0.11, 0.19, 0.32, 0.4]), 5) == []
    assert shortfalls('ppp', np.linspace(0.0, 0.5, 5), 5, diagonal=True) == []


def test_each_shortfall_is_a_sentence_with_what_is_wanted():
    said = shortfalls('lin_x', np.array([0.0, 0.9]), 1)
    assert said[0] == 'lin_x: 2 targets over 900 mm; ISO 230-2 wants at least 5.'
    assert said[1].startswith('lin_x: 1 cycle; ISO 230-2 wants 5.') and 'R and A are not given' in said[1]
    assert 'evenly spaced' in shortfalls('lin_x', np.linspace(0.0, 0.4, 5), 5)[0]
    assert shortfalls('npp', np.linspace(0.0, 1.0, 11), 2, diagonal=True) == ['npp: 2 cycles; ISO 230-6 wants 5.']
