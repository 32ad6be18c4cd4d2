"""One sealed log: a cell, its hidden effects, their sizes, the log and the truth about it.

Everything follows from (purpose, seed, number).  The purpose is part of the seed, so that what
thresholds were tuned on can never be what they are judged on.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from stepdiag_ros.blind.cells import Conditions, draw_cell, untidy_law, without_sensor_noise, without_weather
from stepdiag_ros.blind.hidden import Hidden
from stepdiag_ros.blind.logs import measure, stage_of
from stepdiag_ros.blind.outsiders import OUTSIDERS
from stepdiag_ros.blind.visibility import Visibility, Yardstick
from stepdiag_ros.blind.vocabulary import VOCABULARY
from stepdiag_ros.model.log import CalibrationLog
from stepdiag_ros.virtual.cell import Cell
from stepdiag_ros.virtual.noise import NoiseLaws
from stepdiag_ros.virtual.truth import truth

PURPOSES = {'develop': 1, 'sealed': 2}
CATEGORIES = ('null', 'single', 'pair', 'outside')
LEAST, MOST, LARGE, LARGEST = 3.0, 40.0, 1000.0, 4000.0
"""Visibilities that are drawn lie between the first two; a few go up to the third, in wide worlds to the last."""
CLOSE = 1.1
"""A size is found when the visibility is right within this factor."""
ATTEMPTS = 10


@dataclass(frozen=True)
class Order:
    """What one log is to be: its number, what acts, in which kind of world.

    ``untidy``: probability of noise as instruments have it; ``live``: measured through the running graph,
    ``loaded``: while all cores are busy; ``wide``: effects of more kinds, of larger sizes, with time profiles that
    begin with anything.
    """

    purpose: str
    seed: int
    number: int
    category: str
    kinds: tuple[str, ...] = ()
    world: str = 'varied'
    small: bool = False
    untidy: float = 0.0
    live: bool = False
    loaded: bool = False
    wide: bool = False


@dataclass(frozen=True)
class SealedWorld:
    """A log and the truth about it; ``yardstick`` where effects act; ``cell`` and ``conditions`` to measure on;
    ``smooth``: the log as it were under normal noise, in which effects are measured."""

    log: CalibrationLog
    truth: dict[str, Any]
    effects: tuple[Hidden, ...]
    yardstick: Yardstick | None
    cell: Cell
    conditions: Conditions
    smooth: CalibrationLog

    @property
    def undisturbed(self) -> CalibrationLog:
        """The same log without its effects."""
        return measure(self.cell, self.conditions)


def kind_of(name: str) -> type[Hidden]:
    """The class of a hidden effect."""
    return next(kind for kind in (*VOCABULARY, *OUTSIDERS) if kind.name == name)


def draw_target(rng: np.random.Generator, pair: bool, wide: bool = False) -> float:
    """A visibility: many near the threshold of 8 and above, some below, some far above, a few large; in wide worlds
    four in ten large."""
    low, high = ((8.0, 20.0), (LEAST, 8.0), (20.0, MOST), (MOST, LARGEST if wide else LARGE))[
        rng.choice(4, p=[0.35, 0.1, 0.15, 0.4] if wide else [0.55, 0.2, 0.15, 0.1])]
    if pair:
        low, high = (8.0, 10.0 * MOST if wide else MOST)
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def make(order: Order) -> SealedWorld:
    """Draw, size and measure; another cell is drawn where an effect cannot be seen at all."""
    for attempt in range(ATTEMPTS):
        sequence = np.random.SeedSequence([PURPOSES[order.purpose], order.seed, order.number, attempt])
        made = _attempt(order, np.random.default_rng(sequence), last=attempt == ATTEMPTS - 1)
        if made is not None:
            return made
    raise AssertionError('the last attempt always gives a log')


def _attempt(order: Order, rng: np.random.Generator, last: bool) -> SealedWorld | None:
    cell, conditions = draw_cell(rng, order.world, order.small)
    cell = _untidy(order, cell)
    kinds = [kind_of(name) for name in order.kinds]
    if any(kind.name == 'air_refraction_drift' for kind in kinds):
        cell = without_weather(cell)
    if any(kind.name == 'clock_skew' for kind in kinds) and not cell.sampling.in_motion:
        return None if not last else _finish(order, cell, conditions, None, (), ())
    if not kinds:
        return _finish(order, cell, conditions, None, (), ())
    tidy = _tidy(cell)
    bare = measure(tidy, conditions)
    stamps = any(kind.inside == 'stamps' for kind in kinds)
    yardstick = Yardstick(tidy, bare, measure(without_sensor_noise(tidy), conditions) if stamps else None)
    stage = stage_of(cell, bare, conditions.start_ns, order.wide)
    effects, seen = [], []
    for kind in kinds:
        effect = kind(stage, rng)
        def see(effect: Hidden) -> Visibility:
            return _visible(yardstick, measure(_as_seen(tidy, [effect]), conditions, [effect]), [effect])
        target = draw_target(rng, order.category == 'pair', order.wide)
        if effect.drawn is not None:
            effect.size = float(np.exp(rng.uniform(*np.log(effect.drawn))))
            visible = see(effect)
        else:
            visible = _size(effect, target, see)
        if visible.total < LEAST and not last:
            return None
        effects.append(effect)
        seen.append(visible)
    return _finish(order, cell, conditions, yardstick, tuple(effects), tuple(seen))


def _untidy(order: Order, cell: Cell) -> Cell:
    """The cell with untidy noise, if it falls so; draws of its own, so that all else is as without."""
    rng = np.random.default_rng(np.random.SeedSequence([PURPOSES[order.purpose], order.seed, order.number, 1, 1]))
    if rng.random() >= order.untidy:
        return cell
    return replace(cell, noise_law=untidy_law(rng, cell.description.noise))


def _tidy(cell: Cell) -> Cell:
    """The cell in which the yardstick measures: its noise is gone from the difference of two logs, with an effect and
    without.  Of readings in steps what is rounded off stays in it, and an effect that does nothing would be seen."""
    return replace(cell, noise_law=NoiseLaws())


def _acts_inside(effects: Sequence[Hidden]) -> str | None:
    """How the first of the effects that acts inside the dwells does so."""
    return next((e.inside for e in effects if e.inside), None)


def _as_seen(cell: Cell, effects: Sequence[Hidden]) -> Cell:
    """The cell in whose log the effects are measured by the yardstick: wrong stamps are separated from an exchange of
    noise by doing without noise."""
    return without_sensor_noise(cell) if _acts_inside(effects) == 'stamps' else cell


def _visible(yardstick: Yardstick, log: CalibrationLog, effects: Sequence[Hidden]) -> Visibility:
    """Of the effects in ``log``, that of the cell as seen."""
    return yardstick.visibility(log, all(e.random for e in effects), _acts_inside(effects))


def _size(effect: Hidden, target: float, see: Callable[[Hidden], Visibility]) -> Visibility:
    """Set the effect's size so that it is seen as ``target`` says, within its plausible range."""
    power = 2.0 if effect.random else 1.0
    sizes, values = [], []
    size = effect.typical
    for _ in range(6):
        effect.size = size
        visible = see(effect)
        sizes.append(size)
        values.append(max(visible.total, 1e-3))
        if 1.0 / CLOSE < values[-1] / target < CLOSE:
            break
        if len(sizes) > 1 and abs(np.log(sizes[-1] / sizes[-2])) > 1e-3:
            slope = np.log(values[-1] / values[-2]) / np.log(sizes[-1] / sizes[-2])
            power = float(np.clip(slope, 0.4, 4.0))
        wanted = size * np.clip((target / values[-1]) ** (1.0 / power), 1e-3, 1e3)
        wanted = float(np.clip(wanted, effect.typical * 1e-4, effect.largest))
        if wanted == size:
            break
        size = wanted
    return visible


def _finish(order: Order, cell, conditions, yardstick, effects, seen) -> SealedWorld:
    log = measure(cell, conditions, effects)
    entry: dict[str, Any] = {
        'category': order.category if effects or order.category == 'null' else 'null',
        'world': order.world, 'small': order.small, 'number': order.number, 'wide': order.wide,
        'effects': [{'name': e.name, 'outside': e.outside, **e.describe(),
                     'visibility': {'stops': v.stops, 'inside': v.inside, 'total': v.total}}
                    for e, v in zip(effects, seen, strict=True)],
        'untidy': order.untidy, 'noise_law': None if cell.noise_law == NoiseLaws() else asdict(cell.noise_law),
        'noise': vars(cell.description.noise), 'errors': truth(cell)['errors'],
        'misalignments': truth(cell)['misalignments']}
    smooth = log
    if effects:
        tidy = _tidy(cell)
        smooth = log if tidy == cell else measure(tidy, conditions, effects)
        seen_in = _as_seen(tidy, effects)
        entry['visibility'] = _visible(
            yardstick, smooth if seen_in is tidy else measure(seen_in, conditions, effects), effects).total
        entry['shares'] = yardstick.shares(yardstick.change(smooth))
    return SealedWorld(log, entry, effects, yardstick, cell, conditions, smooth)
