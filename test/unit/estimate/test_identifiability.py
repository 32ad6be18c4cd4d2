"""What a plan leaves open is named; what it determines is not."""

import numpy as np
import pytest

from stepdiag_ros.estimate.enhanced import fit
from stepdiag_ros.estimate.evaluate import solution_of
from stepdiag_ros.estimate.identifiability import _echelon
from stepdiag_ros.estimate.noise import NoiseModel
from stepdiag_ros.estimate.planned import filled, observe, planned_table
from stepdiag_ros.model.description import DIAGONALS, LINEAR


@pytest.fixture
def opened(plan_of, draw_errors, misaligned):
    def opened(*names):
        description = plan_of(3, 2, names=names)
        table = planned_table(description)
        readings = observe(description, table, draw_errors(description.machine, 3), misaligned(description, 3e-4))
        noise = NoiseModel(3e-7, 2e-7, np.full(readings.shape, 1e-8), 'given')
        return solution_of(fit(description, filled(table, readings), noise), table)
    return opened


def names_of(solution):
    return {name for entry in solution.unidentifiable for name in entry.names}


def test_the_full_plan_leaves_only_second_order_beams(opened):
    """Every error is found; only the lasers of the linear setups, cosine errors, are not."""
    found = opened(*DIAGONALS, *LINEAR)
    assert all(name.startswith('lin_') and 'laser' in name for name in names_of(found))
    assert all('cosine' in entry.why for entry in found.unidentifiable)


def test_without_linear_setups_slopes_trade_with_lasers(opened):
    """The detector sees the mirror against the beam; where the beam points, only lines of known length say."""
    found = opened(*DIAGONALS)
    names = names_of(found)
    assert {'EXX slope', 'EYY slope', 'EZZ slope'} <= names
    assert any(' laser ' in name for name in names)
    assert found.curve('EXX')[2][-1] > 1e-4
    assert found.curve('EAX')[2][-1] < 1e-6
    assert any('linear setup' in entry.why for entry in found.unidentifiable)
    assert not {'EAX', 'EBX', 'ECY'} & names     # shapes of the angles are seen by the tilts all the same


def test_one_diagonal_cannot_tell_axes_of_motion_apart(opened):
    found = opened('ppp')
    names = names_of(found)
    # One reading along d a stop: three translations of each axis trade against each other.
    assert {'EXX', 'EYX', 'EZX'} & names
    assert {'EC0Y', 'EB0Z', 'EA0Z'} & names
    # A sigma that knows: what is open is as wide as the prior leaves it.
    _, _, sigma = found.curve('EYX')
    assert sigma.max() > 1e-5


def test_a_line_alone_sees_its_own_axis(opened):
    found = opened('lin_x')
    blind = {entry.names[0] for entry in found.unidentifiable if 'no reading' in entry.why}
    assert {'EYY', 'EZZ'} & {name.removesuffix(' slope') for name in blind}
    assert 'EXX slope' not in blind
    assert found.curve('EXX')[2][-1] < 1e-6


def test_each_further_setup_opens_nothing(opened):
    counts = [len(opened(*names).unidentifiable)
              for names in (('ppp', 'npp'), ('ppp', 'npp', 'pnp', *LINEAR), (*DIAGONALS, *LINEAR))]
    assert counts[0] > counts[-1]
    assert counts[1] >= counts[-1]


def test_echelon_spans_the_same_space():
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(3, 7))
    reduced = _echelon(rows)
    assert np.linalg.matrix_rank(np.vstack([rows, reduced])) == 3
    pivots = [int(np.flatnonzero(np.abs(reduced - 1.0)[i] < 1e-12)[0]) for i in range(3)]
    assert len(set(pivots)) == 3
