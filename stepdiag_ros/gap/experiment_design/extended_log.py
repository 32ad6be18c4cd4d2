"""A log with one more setup at its end: what is known of it before it is measured.

Given the log, each set of effects predicts the new readings from its own sizes, the machine, all misalignments and
resets, none of them better known than the log tells, and the noise.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from stepdiag_ros.effects.base import Effect, Form, StopView
from stepdiag_ros.estimate.enhanced import prior_precision
from stepdiag_ros.estimate.forward import ForwardModel
from stepdiag_ros.estimate.noise import whiteners
from stepdiag_ros.estimate.parameters import STATION, parameters_of
from stepdiag_ros.estimate.planned import planned_table
from stepdiag_ros.estimate.reduce import PIECES, StopTable
from stepdiag_ros.gap.constants import PRIOR_RESET_M
from stepdiag_ros.gap.experiment_design.discrimination import Forecast, Mixture, predicted
from stepdiag_ros.gap.inference.evidence import SIZES
from stepdiag_ros.gap.inference.joint import Joint
from stepdiag_ros.gap.preprocess.observe import view_of
from stepdiag_ros.model.description import Description, Setup, path_of
from stepdiag_ros.model.log import STOOD

Member = tuple[Effect, Form]
Ways = Sequence[tuple[float, Sequence[Member]]]
"""A set of effects in the forms that it may take, with the share of probability of each."""


@dataclass(frozen=True)
class Run:
    """A further run: a setup, ``how`` it differs from that of the log, in words; ``known``: whether the log holds it.

    ``as_mounted``: the setup of the log that a mounting by code may bring back as it was, '': none;
    ``wait`` [s]: left alone so long before mounting; ``mirror_turn_rad``: how its mirror is turned; ``light`` in the
    beam against that of the log; ``watch`` [s]: length of the first stop's dwell, 0: as usual; ``again_after`` [s]:
    left standing so long and measured as often again, None: not.
    """

    setup: Setup
    how: str = ''
    known: bool = True
    mirror_turn_rad: tuple[float, float] = (0.0, 0.0)
    light: float = 1.0
    wait: float = 0.0
    watch: float = 0.0
    again_after: float | None = None
    as_mounted: str = ''

    @property
    def text(self) -> str:
        """What is to be done."""
        label = f'{"line" if self.setup.is_line else "diagonal"} {path_of(self.setup.name)}'
        said = '' if not self.wait else \
            f'Leave the cell as it is for {self.wait / 60.0:.0f} min, the laser on and the control under power. '
        if self.light != 1.0:
            said += f'Put a grey filter that leaves {self.light:.0%} of the light into the beam. '
        said += f'Mount and align the {label}'
        said += ' once more and measure it again' if self.known else ', which this log does not hold, and measure it'
        said += f' at {self.setup.stops} stops' if self.setup.is_linear and not self.known else ''
        said += f', {self.how}.' if self.how else '.'
        if self.watch:
            said += f' Before it moves, let it stand at its first stop for {self.watch / 60.0:.0f} min while the ' \
                    'sensors record.'
        if self.again_after is not None:
            later = f'after {self.again_after / 60.0:.0f} min' if self.again_after else 'at once'
            said += f' Then leave mirror and base unit as they are and measure it as often again {later}.'
        return said


def kind(form: Form) -> str:
    """A form's label without its numbers."""
    return ''.join(c for c in form.label if not c.isdigit() and c != '.')


def _in_order(forms: Sequence[Form]) -> list[tuple[str, int]]:
    """Kind of each form and its number among those of its kind."""
    seen: Counter[str] = Counter()
    result = []
    for form in forms:
        result.append((kind(form), seen[kind(form)]))
        seen[kind(form)] += 1
    return result


class Known:
    """What is known of the log whatever comes after it: places of an effect's forms by label, and the size at
    which a set in some forms suits it best."""

    def __init__(self, joint: Joint):
        self._view = joint.observation.view
        self.sizes: dict[tuple[tuple[str, str], ...], Sequence[float]] = {}
        self._places: dict[str, dict[str, tuple[str, int]]] = {}

    def places(self, effect: Effect) -> dict[str, tuple[str, int]]:
        if effect.name not in self._places:
            forms = effect.appearance(self._view)
            self._places[effect.name] = {form.label: at for form, at in zip(forms, _in_order(forms), strict=True)}
        return self._places[effect.name]


class ExtendedLog:
    """The log with one more setup: what is known of it before it is measured."""

    def __init__(self, joint: Joint, run: Run, known: Known):
        observation, old, setup = joint.observation, joint.fit, run.setup
        log = replace(observation.log, description=replace(
            observation.log.description, setups={**observation.log.description.setups, setup.name: setup}))
        whole = int(np.argmax(old.present.all(axis=1)))
        table, rows = with_run(observation.table, run, log.description, whole)
        # A longer look has more samples, against less light the detector's own noise is larger.
        longer = np.sqrt(_length_ns(table)[len(observation.table):] / _length_ns(observation.table)[rows])
        new_noise = joint.noise.sensor[rows] / longer[:, None]
        new_noise[:, -2:] /= run.light
        spread = joint.noise.spread
        if spread is not None:
            spread = np.concatenate([spread, np.ones((len(spread), len(new_noise)))], axis=1)
        noise = replace(joint.noise, sensor=np.concatenate([joint.noise.sensor, new_noise]), spread=spread)
        parameters = parameters_of(log.description, table)
        first, new = old.parameters.offset_first, len(table.run_ids) - old.parameters.runs
        mounted = [] if run.as_mounted else [0.0] * len(STATION) if setup.follows else [0.0, 0.0, *run.mirror_turn_rad]
        theta = np.concatenate([old.theta[:first], mounted, old.theta[first:],
                                np.zeros(new * old.parameters.beams)])
        model = ForwardModel(log.description, table, parameters)
        predicted, jacobian, arrival = model.jacobian(theta)
        start, beams = len(observation.table), model.beams
        table = replace(
            table, displacement=np.concatenate([table.displacement[:start], predicted[start:, :beams]]),
            spot=np.concatenate([table.spot[:start], predicted[start:, beams:]]))
        present = np.concatenate([old.present, old.present[rows]])
        bins = observation.view.bin_time
        self.view: StopView = view_of(log, table, replace(old, model=model, theta=theta), np.concatenate(
            [bins, bins[rows]]))
        self._forms: dict[str, dict[tuple[str, int], Form]] = {}
        self._log = known
        self._white = whiteners(table, noise, arrival, present)
        self._new = np.concatenate([w.rows for w in self._white]) >= start * present.shape[1]
        self._nominal = self._whitened(jacobian.toarray())
        self._precision = prior_precision(parameters)
        offsets = np.arange(parameters.offset_first, parameters.size)
        self._precision[offsets, offsets] = PRIOR_RESET_M**-2.0
        residual = np.zeros(present.shape)
        residual[:start] = observation.view.reading - predicted[:start]
        self._data = self._whitened(np.where(present, residual, 0.0).ravel())[~self._new]

    def forecasts(self, ways: Ways) -> Mixture:
        """The new readings in each of the ways that have their like in the extended log."""
        found = [(share, self.forecast(members)) for share, members in ways]
        found = [(share, forecast) for share, forecast in found if forecast is not None]
        total = sum(share for share, _ in found)
        return [(share / total, forecast) for share, forecast in found]

    def forecast(self, members: Sequence[Member]) -> Forecast | None:
        """The new readings if ``members`` act; None where one of them has no like, or no bound, in the extended log."""
        forms = [self._laid(effect, form) for effect, form in members]
        if None in forms:
            return None
        none = np.zeros((0, *self.view.reading.shape))
        columns = np.concatenate([none, *(form.columns * form.scale[:, None, None] for form in forms)])
        effects = self._whitened(columns.reshape(len(columns), self.view.reading.size).T)
        if not np.isfinite(effects).all():
            return None
        design = np.concatenate([self._nominal, effects], axis=1)
        known, new = design[~self._new], design[self._new]
        normal, along = known.T @ known, known.T @ self._data
        best, way = None, tuple((effect.name, form.label) for effect, form in members)
        for size in self._log.sizes.get(way, SIZES):
            # The size that suits the log best: a wider one would let the effect do more than it ever did.
            precision = linalg.block_diag(self._precision, np.eye(len(columns)) / size**2)
            scale = 1.0 / np.sqrt(np.diag(normal + precision))
            factor = linalg.cholesky((normal + precision) * np.outer(scale, scale), lower=True)
            half = linalg.solve_triangular(factor, scale * along, lower=True)
            fits = 0.5 * half @ half - np.sum(np.log(np.diag(factor) / scale)) - len(columns) * np.log(size)
            if best is None or fits > best[0]:
                best = fits, factor, scale, half, size
        _, factor, scale, half, self._log.sizes[way] = *best[:-1], best[-1:]
        spread = linalg.solve_triangular(factor, (new * scale).T, lower=True).T
        return predicted(spread @ half, spread)

    def _laid(self, effect: Effect, form: Form) -> Form | None:
        """The form at the extended log, its shape kept: time constants in a label follow the log's length, the
        order of an effect's forms of one kind does not."""
        if effect.name not in self._forms:
            forms = effect.appearance(self.view)
            self._forms[effect.name] = dict(zip(_in_order(forms), forms, strict=True))
        place = self._log.places(effect).get(form.tuned_from or form.label)
        laid = self._forms[effect.name].get(place) if place else None
        if laid is None or set(laid.shape) != set(form.shape):
            return None
        return laid if laid.retune is None else laid.at(form.shape)

    def _whitened(self, values: np.ndarray) -> np.ndarray:
        return np.concatenate([w(values) for w in self._white])


def _length_ns(table: StopTable) -> np.ndarray:
    return np.maximum(table.done_ns - table.dwell_ns, 1)


def seconds_of(joint: Joint, run: Run) -> float:
    """How long a run takes [s], with what goes before it, at the log's own pace."""
    table, description = joint.observation.table, joint.observation.log.description
    longer, _ = with_run(table, run, replace(description, setups={**description.setups, run.setup.name: run.setup}), 0)
    return float(longer.done_ns.max() - table.done_ns.max()) * 1e-9


def with_run(table: StopTable, run: Run, description: Description, usual: int) -> tuple[StopTable, np.ndarray]:
    """The table with the setup of ``run`` measured at its end, once or twice; and for each of the new stops the old
    one that it is like: that of the same diagonal or line or, where there was none, ``usual``."""
    part, like, passes = _as_planned(table, run.setup, description, usual)
    starts = [table.dwell_ns[table.setup == s].min() for s in np.unique(table.setup)]
    ends = [table.done_ns[table.setup == s].max() for s in np.unique(table.setup)]
    pause = int(np.median(np.array(starts)[1:] - np.array(ends)[:-1])) if len(starts) > 1 else 0
    first, longer, watched = int(part['dwell_ns'].min()), int(run.watch * 1e9), PIECES if run.watch else 0
    shifts = [int(table.done_ns.max()) + max(pause, 0) + int(run.wait * 1e9) - first]
    if run.again_after is not None:
        shifts.append(shifts[0] + longer + int(part['done_ns'].max()) - first + int(run.again_after * 1e9))
    names = table.setup_names if run.as_mounted else (*table.setup_names, run.setup.name)
    setup = names.index(run.as_mounted or run.setup.name)
    held = int(table.repeat[table.setup == setup].max()) + 1 if run.as_mounted else 0
    parts, ids, rows = [], [], []
    for visit, shift in enumerate(shifts):
        # What is watched comes before the first stop as it usually is, cut as in a log.
        before = 0 if visit else watched
        own = np.concatenate([np.zeros(before, int), np.arange(len(like))])
        new = {name: values[own] for name, values in part.items()}
        for name in ('move_ns', 'dwell_ns', 'done_ns'):
            new[name] += shift + (longer if before else 0)
        if before:
            new['axis'][1:before + 1] = STOOD
            for name, end in (('dwell_ns', 0), ('done_ns', 1)):
                new[name][:before] = first + shift + longer * (np.arange(before) + end) // before
        parts.append(new | {
            'run': new['run'] + len(table.run_ids) + len(ids), 'setup': np.full(len(own), setup),
            'repeat': new['repeat'] + held + visit * (int(part['repeat'].max()) + 1),
            'intensity': new['intensity'] * run.light})
        ids += [f'{run.setup.name}/{visit}/{one}' for one in passes]
        rows.append(like[own])
    return replace(table, run_ids=(*table.run_ids, *ids), setup_names=names,
                   **{name: np.concatenate([getattr(table, name), *(part[name] for part in parts)])
                      for name in parts[0]}), np.concatenate(rows)


def _as_planned(table: StopTable, setup: Setup, description: Description,
                usual: int) -> tuple[dict[str, np.ndarray], np.ndarray, list[str]]:
    """Columns of the stops that a setup will have, at the times of the one that they are like; these; ids of the
    passes that 'run' numbers."""
    columns = [name for name, values in vars(table).items()
               if isinstance(values, np.ndarray) and len(values) == len(table) and name != 'setup']
    same = [i for i, name in enumerate(table.setup_names) if path_of(name) == path_of(setup.name)]
    if same:
        like = np.flatnonzero((table.setup == same[0]) & (table.axis != STOOD))
        part = {name: getattr(table, name)[like] for name in columns}
        runs, part['run'] = np.unique(part['run'], return_inverse=True)
        return part, like, [table.run_ids[run].partition('/')[2] for run in runs]
    plan = planned_table(description, (setup.name,))
    like = np.full(len(plan), usual)
    part = {name: getattr(table, name)[like] for name in columns}
    pace = int(np.median(np.diff(table.dwell_ns)))
    for name in ('move_ns', 'dwell_ns', 'done_ns'):
        part[name] += pace * np.arange(len(like))
    part |= {name: getattr(plan, name) for name in ('run', 'repeat', 'direction', 'index', 'axis', 'commanded')}
    return part, like, [run.partition('/')[2] for run in plan.run_ids]
