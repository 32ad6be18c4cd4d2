"""That no form is right to the last part: what it costs a set, whatever the order in which its members were found."""

from dataclasses import replace

import numpy as np
import pytest

from stepdiag_ros.effects.base import Form
from stepdiag_ros.gap.inference.candidates import Candidate, Screen
from stepdiag_ros.gap.inference.search import EffectSet, joined, search
from test.unit.gap.inference.white_space import white_space

N = 400
NONE = EffectSet((), 0.0)


def screen_of(data: np.ndarray, columns: dict[str, np.ndarray]) -> Screen:
    """One form of one column (n,) for each name, with twenty slow waves as what its discrepancy may follow."""
    waves = np.cos(np.pi * np.arange(1, 21)[:, None] * np.linspace(0.0, 1.0, N)) * np.sqrt(2.0 / 20.0)
    forms = [Candidate(name, '', Form(name, column[None, :, None], ('size',), np.ones(1)))
             for name, column in columns.items()]
    return Screen(white_space(data), forms, 1e9, modulations=waves)


@pytest.fixture
def cause_and_parts() -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """One cause of 400 σ, and two forms that have a part of it each and are alike in part."""
    rng = np.random.default_rng(3)
    one, two = np.linalg.qr(rng.normal(size=(N, 2)))[0].T
    parts = {'left': one, 'right': (one + two) / np.sqrt(2.0)}
    cause = parts['left'] - parts['right']
    cause /= np.linalg.norm(cause)
    return 400.0 * cause + rng.normal(size=N), parts


def test_the_order_in_which_members_were_found_does_not_matter(cause_and_parts):
    data, columns = cause_and_parts
    screen = screen_of(data, columns)
    alone = screen.by_cause()
    evidence = {}
    for first, second in (('left', 'right'), ('right', 'left')):
        found = joined(screen, joined(screen, NONE, alone[first]), screen.by_cause([alone[first]])[second])
        placed = screen.in_place(found.members)
        evidence[first] = found.log_bayes, sum(m.log_bayes for m in placed)
    assert abs(evidence['left'][1] - evidence['right'][1]) < 1.0
    # Beside the other each does a good deal more than alone, and may err by a share of that.
    assert all(placed < as_found - 5.0 for as_found, placed in evidence.values())


def test_sets_are_compared_with_their_discrepancies_in_place(cause_and_parts):
    data, columns = cause_and_parts
    screen = screen_of(data, columns)
    both = next(found for found in search(screen) if found.names == ('left', 'right'))
    bare = [replace(m, at=()) for m in both.members]
    assert both.log_bayes == pytest.approx(sum(m.log_bayes for m in both.members))
    assert [m.at for m in both.members] == [m.at for m in screen.in_place(bare)]


def test_what_brings_nothing_leaves_the_others_where_they_are(cause_and_parts, monkeypatch):
    """Any effect beside the right ones makes a set of its own; put in place each anew, they took half of a search."""
    data, columns = cause_and_parts
    rng = np.random.default_rng(5)
    idle = {f'idle {k}': column / np.linalg.norm(column) for k, column in enumerate(rng.normal(size=(6, N)))}
    placed = []
    in_place = Screen.in_place
    monkeypatch.setattr(Screen, 'in_place', lambda self, members: placed.append(members) or in_place(self, members))
    found = search(screen_of(data, columns | idle))
    assert placed and not any(member.effect in idle for members in placed for member in members)
    assert len(placed) == len(set(placed))
    both = next(s for s in found if s.names == ('left', 'right'))
    beside = [s for s in found if len(s.members) == 3]
    assert beside
    for more in beside:
        # … so that what the third brings is counted from the same place.
        assert more.members[:2] == both.members
        assert more.log_bayes - both.log_bayes == pytest.approx(more.members[2].log_bayes)
        assert more.refused
