"""Scatter that the noise of the log does not explain: a cause without a pattern.

Something may shake a reading now and then or make one channel, axis or stretch of the log noisier than
the repeats predict, without any form to fit.  What the diagnosis leaves is compared with its noise, group
by group, and its tails with those of the normal distribution.
"""

from collections.abc import Iterator

import numpy as np
from scipy import sparse, special

from stepdiag_ros.effects.base import Form
from stepdiag_ros.estimate.eigen import eigen
from stepdiag_ros.gap.constants import SUSPICION
from stepdiag_ros.gap.inference.evidence import judge, log_mean
from stepdiag_ros.gap.inference.joint import Joint, unexplained
from stepdiag_ros.gap.inference.parity import Parity

TAIL = 4.5
"""Standard deviations beyond which a white residual is counted as an outlier."""
LEAST = 24
"""Fewest residuals of a group that is judged."""
ABSORBED = 1e-3
"""Share of a pattern that must be left by the fit: less is along the fit's own unknowns, and rounding."""
HELD = 4.0
"""Standard deviations to which what single dwells show inside is held."""
OUTLIER_SIZE = 3.0
"""Typical outlier, in standard deviations of an arrival: a smaller one is no more than noise."""
MOST_OUTLIERS = 60
PATIENCE = 8.0
"""Log evidence by which more outliers may fall behind before no more are picked."""

SHARES = np.array([0.02, 0.05, 0.1, 0.2, 0.4, 1.0])
"""Shares of arrivals that may be off, all others being as good as the noise says …"""
SPREADS = np.logspace(-0.3, 3.0, 16)
"""… and sizes, in standard deviations of an arrival, of what is off."""
LEVELS = np.geomspace(0.3, 1.2, 12)
"""What of the noise the other arrivals may have: repeats that are off now and then have raised it."""


def scattered_arrivals(joint: Joint, rest: np.ndarray | None = None) -> tuple[float, str]:
    """Log evidence that an axis's arrivals are off by a random amount until the next move, and the axis in words.

    Noise of an arrival stays until its axis moves again; what a next move of another axis shakes loose
    does not, and has no pattern: each stop of the axis is one more unknown.  Their scores, made white in
    parity space, are standard normal, or for a share q of the stops s times as wide, to both sides or to
    one; that mixture is weighed against noise alone, averaged over q and s.  White they are made run by run: arrivals
    of different runs share no more than what the fit takes from all alike.
    ``rest`` (N,): white residuals to judge, else what the active effects leave.
    """
    space, view = joint.parity, joint.observation.view
    rest = unexplained(space, joint.active) if rest is None else rest
    data = rest[:space.stops]
    found: dict[str, dict[str, float]] = {'off': {}, 'short': {}, 'too far': {}}
    for axis, letter in enumerate('XYZ'):
        mine = np.flatnonzero((view.axis == axis) & (view.approach[:, axis] != 0))
        if len(mine) < LEAST:
            continue
        run = space.run_of_stop[mine]   # at a stop where nothing was read no arrival shows
        score = np.concatenate([np.zeros(0), *(_scores(joint, axis, mine[run == number], number, data)
                                               for number in np.unique(run) if number >= 0)])
        for side, words in ((0.0, 'off'), (-1.0, 'short'), (1.0, 'too far')):
            found[words][letter] = _mixture(score, side)
    worst = (0.0, '')
    for words, axes in found.items():
        groups = {**axes, 'all axes': sum(axes.values())}
        for which, evidence in groups.items():
            worst = max(worst, (evidence - np.log(3.0 * len(groups)),
                                f'arrivals of {which} are {words} by a random amount until the next move'))
    return worst


def _scores(joint: Joint, axis: int, stops: np.ndarray, number: int, data: np.ndarray) -> np.ndarray:
    """Scores (m,) of the arrivals of an ``axis`` at some ``stops`` of the run ``number``, white among each other."""
    space, view = joint.parity, joint.observation.view
    columns = np.zeros((len(stops), *view.reading.shape))
    columns[np.arange(len(stops)), stops] = view.by_shift[axis][stops] * view.approach[stops, axis, None]
    rows, _, whole = space.white_run(columns, number, resets=True)
    white = space.projection.white[number].without(whole) / np.linalg.norm(whole, axis=0)
    lost = space.projection.absorbed(white, number)
    value, vector = eigen(white.T @ white - lost.T @ lost)
    # What the fit takes whole is rounding; patterns of many steps in a row are much alike, but none of them is lost.
    kept = value > ABSORBED
    # Neighbours share a part of their patterns; the symmetric root keeps each score at its stop.
    root = vector[:, kept] / np.sqrt(value[kept])
    return root @ (vector[:, kept].T @ (white.T @ data[rows]))


def _mixture(score: np.ndarray, side: float) -> float:
    """Log evidence of a wide part in normal scores, two-sided (0) or of one sign."""
    wide = SPREADS**2
    logs, plain = [], []
    for level in LEVELS:
        z = score / level
        alone = -0.5 * z**2 - np.log(level)
        ratio = -0.5 * np.log1p(wide)[:, None] + 0.5 * (wide / (1.0 + wide))[:, None] * z**2
        if side:
            ratio = ratio + np.log(2.0) + special.log_ndtr(
                side * z * np.sqrt(wide / (1.0 + wide))[:, None])
        quiet = np.log(np.maximum(1.0 - SHARES, 1e-300))[:, None, None]
        mixed = np.logaddexp(quiet, np.log(SHARES)[:, None, None] + ratio)
        logs.append(log_mean((alone + mixed).sum(axis=2).ravel()))
        plain.append(float(np.sum(alone)))
    # Less noise than the repeats say is no sign of outliers: noise alone may have any level too.
    return log_mean(logs) - log_mean(plain)


def outliers(joint: Joint) -> tuple[Form, float] | None:
    """Single arrivals that are off until the next move, as one form, and the log of the ways to pick them; None
    where noise explains as much.

    Stops are picked one by one, each the one that explains most of what those before leave, as long as the
    evidence grows.  To pick k of m stops at a rate that is not known costs ln (m + 1) + ln C(m, k); where all
    are short (or all too far) each sign saves ln 2.  So it competes on equal terms with slips, that two or three
    steps make of few large outliers.
    """
    space, view = joint.parity, joint.observation.view
    stops = np.flatnonzero(view.axis < 3)
    sign = view.approach[stops, view.axis[stops]]
    stops, sign = stops[sign != 0], sign[sign != 0]
    if len(stops) < LEAST:
        return None
    scale = OUTLIER_SIZE * joint.noise.position
    values = sign[:, None] * view.by_shift[view.axis[stops], stops]
    white, data = space.white_at(stops, scale * values), space.data
    power, run = white.power(2).sum(axis=0), space.run_of_stop[stops]
    for number, rows in enumerate(space.projection.runs):
        mine = np.flatnonzero(run == number)
        power[mine] -= np.sum(space.projection.absorbed(white[rows][:, mine].toarray(), number)**2, axis=0)
    best: tuple[float, float, list[int], str] | None = None
    for side, words in ((0.0, 'off'), (-1.0, 'short'), (1.0, 'too far')):
        picked: list[int] = []
        some, most = np.zeros((space.stops, 0)), -np.inf
        for k, seen in _picks(space, white, power, side):
            picked, some = [*picked, k], np.column_stack([some, seen])
            count = len(picked)
            judged = judge((some.T @ some)[None], (some.T @ data[:space.stops])[None], float(data @ data),
                           sum(space.dof), float(sum(joint.noise.dof)))[0].log_bayes
            ways = -float(special.betaln(count + 1, len(stops) - count + 1))
            if side:
                ways -= (count - 1) * float(np.log(2.0))
            most = max(most, judged - ways)
            if best is None or judged - ways > best[0]:
                best = judged - ways, ways, picked, words
            elif judged - ways < most - PATIENCE:
                break
    if best is None or best[0] < SUSPICION:
        return None
    _, ways, picked, words = best
    columns = view.zeros(len(picked))
    columns[np.arange(len(picked)), stops[picked]] = values[picked]
    return Form(f'arrivals are {words} by a random amount until the next move, at {len(picked)} stops',
                columns, tuple(str(i) for i in range(len(picked))),
                np.full(len(picked), scale)), ways


def _picks(space: Parity, white: sparse.csc_array, power: np.ndarray,
           side: float) -> Iterator[tuple[int, np.ndarray]]:
    """Numbers and projected values (stops,) of ``white`` columns (stops, m), of ``power`` (m,) once projected, the next
    always the one that takes most off the stops' data given those before; with a ``side`` only those whose coefficient
    has its sign.

    What products are taken with is projected, so that the columns need not be.
    """
    least, left, rest = 0.1 * power, power.copy(), space.data[:space.stops]
    basis = np.zeros((space.stops, 0))
    for _ in range(MOST_OUTLIERS):
        along = white.T @ rest
        fall = np.where((left > least) & (along * side >= 0.0), along**2 / np.maximum(left, 1e-300), 0.0)
        k = int(np.argmax(fall))
        if fall[k] <= 0.0:
            return
        column = white[:, [k]].toarray()
        seen = space.projection.projected(column)[:, 0]
        yield k, seen
        new = seen - basis @ (basis.T @ seen)
        new = new / np.linalg.norm(new)
        basis = np.column_stack([basis, new])
        rest = rest - new * float(new @ rest)
        left = left - (white.T @ new) ** 2
        left[k] = 0.0


def excess_scatter(joint: Joint, rest: np.ndarray | None = None) -> tuple[float, str]:
    """Log evidence for more scatter than noise in the worst group, and that group in words; ``rest`` (N,): white
    residuals, those of the joint fit unless given."""
    space, table = joint.parity, joint.observation.table
    rest = unexplained(space, joint.active) if rest is None else rest
    beams, repeats = joint.fit.model.beams, max(float(sum(joint.noise.dof)), 1.0)
    worst: list[tuple[float, str]] = [(0.0, ''), scattered_arrivals(joint, rest)]
    for part, what, dof in ((slice(0, space.stops), 'the stops', space.dof[0]),
                            (slice(space.stops, None), 'the samples inside the dwells', space.dof[1])):
        values, channel, row = rest[part], space.channel[part], space.row[part]
        if what != 'the stops':
            # Tails of the samples are noise; so is a channel's own level, which the parity space has taken.
            values = np.clip(values, -HELD, HELD)
        if len(values) < LEAST:
            continue
        free = dof / max(int(np.sum(channel >= 0)), 1)
        groups = {}
        for c in range(beams + 2):
            name = 'displacement' if c < beams else ('spot_x', 'spot_y')[c - beams]
            mine = channel == c
            groups[f'{name} at {what}'] = mine
            for setup, label in enumerate(table.setup_names):
                groups[f'{name} at {what} of {label}'] = mine & (table.setup[row] == setup)
            for axis, label in enumerate('XYZ'):
                groups[f'{name} at {what} after moves of {label}'] = mine & (table.axis[row] == axis)
            for direction, label in ((1, 'forward'), (-1, 'backward')):
                groups[f'{name} at {what} going {label}'] = mine & (table.direction[row] == direction)
        price = np.log(len(groups))
        for label, mine in groups.items():
            count = float(mine.sum())
            if count < LEAST:
                continue
            square = float(np.sum(values[mine] ** 2))
            ratio = square / (count * min(free, 1.0))
            # The stops' noise is known no better than the repeats tell it.
            known = 1.0 / (1.0 / (count * free) + (1.0 / repeats if what == 'the stops' else 0.0))
            gain = 0.5 * known * (ratio - 1.0 - np.log(ratio)) if ratio > 1.0 else 0.0
            worst.append((gain - price, f'{label} scatter {np.sqrt(ratio):.2f} times as much as noise'))
            outliers = float(np.sum(np.abs(values[mine]) > TAIL))
            expected = max(2.0 * float(special.ndtr(-TAIL)) * count, 0.05)
            if outliers > expected:
                worst.append((outliers * np.log(outliers / expected) - (outliers - expected) - price,
                              f'{label}: {int(outliers)} of {int(count)} lie beyond {TAIL} σ'))
    return max(worst)
