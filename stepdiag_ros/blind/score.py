"""Score answers against the truth: pure functions on the two JSON trees.

Effects count from a visibility of 8 standard deviations, a pair when each of its two does.
Every proportion comes with Wilson's interval (E. B. Wilson, *Probable inference*, JASA 22, 1927).
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from stepdiag_ros.estimate.gauge import to_reference_lines
from stepdiag_ros.gap.alternatives.unmodelled import NAME as UNKNOWN
from stepdiag_ros.gap.inference.search import NOTHING
from stepdiag_ros.model.machine import CURVES, SQUARENESS, Curve, GeometricErrors

COUNTS_FROM = 8.0
CURVE_EDGES = (3.0, 4.0, 5.5, 8.0, 11.0, 15.0, 20.0, 40.0, 200.0, 1000.0, 4000.0)
LARGE = 200.0
"""Visibility from which effects are large: their calibration stands apart too."""
NAMED_FROM, SURE = 0.5, 0.85
"""An effect is named when it gets at least the first probability, and surely with the second."""
COVER = 0.9
"""Where: the smallest set of cells that holds this share of the excess."""
CHANNELS = ('displacement', 'spot_x', 'spot_y')
SEPARABLE = 5.0
"""A log's effect is separable when every competing effect, at its best, leaves this many σ of it."""


def total_visibility(effect: Mapping[str, Any]) -> float:
    """By how many σ an effect of the sealed truth is seen; 0, not counted, where the truth does not tell."""
    total = effect['visibility']['total']
    return 0.0 if total is None else float(total)


@dataclass(frozen=True)
class Case:
    """One log: its truth, the contract's answer and the extra of it."""

    name: str
    truth: Mapping[str, Any]
    gap: Mapping[str, Any]
    extra: Mapping[str, Any]

    @property
    def category(self) -> str:
        return self.truth['category']

    @property
    def true_names(self) -> list[str]:
        return [e['name'] for e in self.truth['effects']]

    @property
    def weakest(self) -> float:
        """Visibility of the effect that is seen least."""
        return min(map(total_visibility, self.truth['effects']), default=0.0)

    @property
    def named(self) -> list[str]:
        return [e['name'] for e in self.gap['effects'] if e['probability'] >= NAMED_FROM]

    @property
    def alarmed(self) -> bool:
        return self.gap['verdict'] != 'no_gap'

    @property
    def unknown(self) -> bool:
        return self.gap['verdict'] in ('unexplained', 'partly_explained')

    @property
    def in_means(self) -> bool:
        """Whether the stops' means show the effects, so that it makes sense to ask where they lie."""
        return all(e['visibility'].get('stops', np.inf) >= 0.5 * total_visibility(e)
                   for e in self.truth['effects'])

    @property
    def floor(self) -> float:
        """Reduced χ² of what is held out that the realised noise leaves without any effect; 1 where not judged."""
        return self.truth.get('noise_chi2', 1.0)

    @property
    def separable(self) -> bool:
        """Whether the sealed truth says that no (other) effect of the vocabulary could stand for the one that acts."""
        return self.truth.get('least_apart', np.inf) >= SEPARABLE


def wilson(hits: int, count: int, z: float = 1.96) -> tuple[float, float]:
    """95 % interval of a proportion."""
    if count == 0:
        return 0.0, 1.0
    share, square = hits / count, z * z
    middle = (share + square / (2.0 * count)) / (1.0 + square / count)
    half = z / (1.0 + square / count) * np.sqrt(share * (1.0 - share) / count
                                                 + square / (4.0 * count * count))
    return float(max(0.0, middle - half)), float(min(1.0, middle + half))


def score(cases: Sequence[Case]) -> dict[str, Any]:
    """All figures of the table."""
    nulls = [c for c in cases if c.category == 'null']
    live = [c for c in nulls if c.truth.get('live')]
    null = [c for c in nulls if not c.truth.get('live') and not c.truth.get('noise_law')]
    untidy = [c for c in nulls if c.truth.get('noise_law')]
    known = [c for c in cases if c.category in ('single', 'pair') and c.weakest >= COUNTS_FROM]
    single = [c for c in known if c.category == 'single']
    pair = [c for c in known if c.category == 'pair']
    outside = [c for c in cases if c.category == 'outside' and c.weakest >= COUNTS_FROM]
    separable = [c for c in single if c.separable]
    figures: dict[str, Any] = {
        'false_alarms': share(null, lambda c: c.alarmed),
        'false_alarms_untidy': share(untidy, lambda c: c.alarmed),
        'false_alarms_live': share([c for c in live if not c.truth['loaded']], lambda c: c.alarmed),
        'false_alarms_loaded': share([c for c in live if c.truth['loaded']], lambda c: c.alarmed),
        'detection': share(known + outside, lambda c: c.alarmed),
        'first_right': share(separable, first_right),
        'first_right_all': share(single, first_right),
        'mean_probability': mean(truth_probability(c) for c in single),
        'set_coverage': share(single, lambda c: c.true_names[0] in credible_set(c)),
        'set_size': mean(len(credible_set(c)) for c in single),
        'outside_unknown': share(outside, lambda c: c.unknown and not c.named),
        'outside_misnamed': share(outside, lambda c: bool(c.named)),
        'outside_sure': share(outside, lambda c: any(e['probability'] >= SURE for e in c.gap['effects'])),
        'outside_unknown_separable': share([c for c in outside if c.separable], lambda c: c.unknown and not c.named),
        'outside_sure_separable': share([c for c in outside if c.separable],
                                        lambda c: any(e['probability'] >= SURE for e in c.gap['effects'])),
        'pair_exact': share(pair, lambda c: set(c.named) == set(c.true_names)),
        'where_f1': mean(where_f1(c) for c in known if c.alarmed and c.in_means),
        'gap_closed': mean(closed(c) for c in known if c.alarmed and np.isfinite(closed(c))),
        'gap_closed_together': closed_together([c for c in known if c.alarmed]),
        'held_out_chi2': median(c.extra['closing']['after'] for c in known if c.alarmed),
        'held_out_chi2_at_most_1.05': share([c for c in known if c.alarmed],
                                             lambda c: c.extra['closing']['after'] <= 1.05),
        'bias_removed': bias_removed(known),
        'bias_removed_median': median(v for c in known if np.isfinite(v := bias_removed_of(c))),
        'en_at_most_1': en_within(known),
        'calibration_error': calibration(cases)['error'],
        'calibration_error_large': calibration([c for c in cases if c.weakest >= LARGE])['error'],
        'seconds': median(c.extra['seconds'] for c in cases)}
    return {'figures': figures, 'curve': curve(cases), 'calibration': calibration(cases),
            'by_effect': by_effect(cases), 'seconds_at_most': float(
                max((c.extra['seconds'] for c in cases), default=0.0))}


# ---- single figures -------------------------------------------------------------------------------

def first_right(case: Case) -> bool:
    """The effect with the greatest probability is the true one."""
    effects = case.gap['effects']
    return bool(effects) and effects[0]['name'] == case.true_names[0]


def truth_probability(case: Case) -> float:
    """Probability that the answer gives to the only true effect."""
    return float(case.extra['ranking'].get(case.true_names[0], 0.0))


def credible_set(case: Case) -> set[str]:
    """Causes of which one leads, with 95 %: the answer's first effect and those that may stand for it.

    The sets of effects thought of are gone through by probability.  One that holds the first effect
    speaks for it, whatever else it holds; any other speaks for its own members, or for nothing.
    """
    leader = case.gap['effects'][0]['name'] if case.gap['effects'] else None
    if leader is not None and not any(leader in names for names, _ in case.extra['sets']):
        # Found outside the sets, in the dwells' spectra or the stamps: nothing competes.
        return {leader}
    total, causes = 0.0, set()
    for names, probability in case.extra['sets']:
        causes |= {leader} if leader in names else set(names) or {NOTHING}
        total += probability
        if total >= 0.95:
            break
    return causes


def cells(shares: Iterable[Mapping[str, Any]], setups: Sequence[str]) -> dict[tuple[str, str], float]:
    """Shares by (channel, setup); an entry without one of the two is spread over all of them."""
    total: dict[tuple[str, str], float] = {}
    for entry in shares:
        keys = [(channel, setup)
                for channel in ([entry['channel']] if entry.get('channel') else CHANNELS)
                for setup in ([entry['setup']] if entry.get('setup') else setups)]
        for key in keys:
            total[key] = total.get(key, 0.0) + entry['share'] / len(keys)
    return total


def covering(shares: Mapping[tuple[str, str], float]) -> set[tuple[str, str]]:
    """The smallest set of cells that holds 90 % of the whole."""
    whole, kept, total = sum(shares.values()), set(), 0.0
    for key, share in sorted(shares.items(), key=lambda item: -item[1]):
        if total >= COVER * whole:
            break
        kept.add(key)
        total += share
    return kept


def where_f1(case: Case) -> float:
    """F1 of the cells that the answer names against those that hold the excess."""
    setups = sorted({entry['setup'] for entry in case.truth['shares']})
    true = covering(cells(case.truth['shares'], setups))
    said = covering(cells(case.gap['where'], setups))
    if not said:
        return 0.0
    return 2.0 * len(true & said) / (len(true) + len(said))


def closed(case: Case) -> float:
    """Share of the gap's variance above the realised noise that is gone on held-out data; NaN: no gap there."""
    before, after = (case.extra['closing'][when] - case.floor for when in ('before', 'after'))
    # Below three standard deviations of a reduced χ² the held-out part shows no gap to close.
    if before < 3.0 * np.sqrt(2.0 / max(case.extra['closing']['count'], 1)):
        return float('nan')
    return float(np.clip(1.0 - max(after, 0.0) / before, 0.0, 1.0))


def closed_together(cases: Sequence[Case]) -> dict[str, Any]:
    """Share of all logs' gaps that is gone, summed before it is divided.

    Clipped log by log what is not known of the realised noise only ever takes away from what was closed, summed it
    cancels.
    """
    before, after = (sum(c.extra['closing'][when] - c.floor for c in cases) for when in ('before', 'after'))
    return {'value': float(1.0 - after / before) if before > 0.0 else None, 'count': len(cases)}


def _machine(errors: Mapping[str, Any]) -> GeometricErrors:
    curves = {name: Curve(np.array(errors[name]['position_m']), np.array(errors[name]['value']))
              for name in CURVES if name in errors}
    return to_reference_lines(GeometricErrors(
        curves, {name: errors[name]['value'] for name in SQUARENESS if name in errors}))


def normalised_errors(case: Case, when: str) -> np.ndarray:
    """(estimate − truth)/σ of all errors that have a σ, truth in the estimate's gauge."""
    estimate, true = case.extra['errors'][when], _machine(case.truth['errors'])
    parts = []
    for name, entry in estimate.items():
        sigma = np.atleast_1d(entry['sigma'])
        if name in SQUARENESS:
            value, truth = np.atleast_1d(entry['value']), np.atleast_1d(true.square[name])
        else:
            value, truth = np.array(entry['value']), true.curves[name](np.array(entry['position_m']))
        good = sigma > 1e-12
        parts.append((value - truth)[good] / sigma[good])
    return np.concatenate(parts) if parts else np.zeros(0)


def bias_removed(cases: Sequence[Case]) -> dict[str, Any]:
    """Share of the errors' bias, in squares above their own noise, that the added effects take away."""
    excess = {when: sum(float(np.sum(normalised_errors(c, when) ** 2 - 1.0)) for c in cases)
              for when in ('before', 'after')}
    if excess['before'] <= 0.0:
        return {'value': None, 'count': len(cases)}
    return {'value': float(1.0 - max(excess['after'], 0.0) / excess['before']), 'count': len(cases)}


def bias_removed_of(case: Case) -> float:
    """The same of one log; NaN: none of its errors is biased beyond three standard deviations of its own noise.

    The sum over all logs is that of the few with the largest effects; their median says what one log may expect.
    """
    squares = normalised_errors(case, 'before') ** 2
    if np.sum(squares - 1.0) < 3.0 * np.sqrt(2.0 * len(squares)):
        return float('nan')
    return float(bias_removed([case])['value'])


def en_within(cases: Sequence[Case]) -> dict[str, Any]:
    """Share of the 21 errors' values with |En| ≤ 1 (k = 2) after the effects were added."""
    numbers = [normalised_errors(c, 'after') for c in cases]
    all_of = np.concatenate(numbers) if numbers else np.zeros(0)
    return proportion(int(np.sum(np.abs(all_of) <= 2.0)), len(all_of))


def calibration(cases: Sequence[Case], bins: int = 10) -> dict[str, Any]:
    """Expected calibration error of what the answers say of causes: effects, something else, nothing.

    Every statement with a probability above 1 % counts, weighted alike.
    """
    said, true = [], []
    for case in cases:
        if case.category != 'null' and case.weakest < 3.0:
            continue
        right = {NOTHING} if case.category == 'null' else \
            {UNKNOWN} if case.category == 'outside' else set(case.true_names)
        for name, probability in case.extra['ranking'].items():
            if probability > 0.01:
                said.append(probability)
                true.append(name in right)
    said, true = np.array(said), np.array(true, bool)
    edges = np.linspace(0.0, 1.0, bins + 1)
    rows, error = [], 0.0
    for low, high in zip(edges[:-1], edges[1:], strict=True):
        inside = (said > low) & (said <= high)
        if inside.any():
            rows.append({'said': float(said[inside].mean()), 'true': float(true[inside].mean()),
                         'count': int(inside.sum())})
            error += inside.sum() / len(said) * abs(rows[-1]['said'] - rows[-1]['true'])
    return {'error': {'value': float(error), 'count': len(said)}, 'bins': rows}


def curve(cases: Sequence[Case]) -> list[dict[str, Any]]:
    """Detection, right effect and what outside effects are called, by visibility."""
    rows = []
    for low, high in zip(CURVE_EDGES[:-1], CURVE_EDGES[1:], strict=True):
        inside = [c for c in cases if c.category != 'null' and low <= c.weakest < high]
        single = [c for c in inside if c.category == 'single']
        outside = [c for c in inside if c.category == 'outside']
        rows.append({'from': low, 'to': high, 'detection': share(inside, lambda c: c.alarmed),
                     'first_right': share(single, first_right),
                     'outside_unknown': share(outside, lambda c: c.unknown and not c.named)})
    return rows


def by_effect(cases: Sequence[Case]) -> dict[str, dict[str, Any]]:
    """For each effect: found how often, first how often, and what was named instead."""
    rows: dict[str, dict[str, Any]] = {}
    for case in cases:
        if case.category not in ('single', 'outside') or case.weakest < COUNTS_FROM:
            continue
        row = rows.setdefault(case.true_names[0], {'count': 0, 'detected': 0, 'first': 0, 'instead': {}})
        row['count'] += 1
        row['detected'] += case.alarmed
        first = case.gap['effects'][0]['name'] if case.gap['effects'] else None
        if case.category == 'single':
            row['first'] += first == case.true_names[0]
        if first != case.true_names[0]:
            label = first or ('something else' if case.unknown else NOTHING)
            row['instead'][label] = row['instead'].get(label, 0) + 1
    return rows


# ---- helpers --------------------------------------------------------------------------------------

def proportion(hits: int, count: int) -> dict[str, Any]:
    return {'value': hits / count if count else None, 'hits': hits, 'count': count,
            'interval': list(wilson(hits, count))}


def share(cases: Sequence[Case], test: Callable[[Case], bool]) -> dict[str, Any]:
    return proportion(sum(bool(test(c)) for c in cases), len(cases))


def mean(values: Iterable[float]) -> dict[str, Any]:
    numbers = np.array(list(values), float)
    return {'value': float(numbers.mean()) if len(numbers) else None, 'count': len(numbers)}


def median(values: Iterable[float]) -> dict[str, Any]:
    numbers = np.array(list(values), float)
    return {'value': float(np.median(numbers)) if len(numbers) else None, 'count': len(numbers)}
