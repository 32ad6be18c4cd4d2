"""The further run that settles which of two sets of effects acts: computed, not guessed.

A run is one more setup at the end of the log: a diagonal or line that the plan holds already, mounted and
aligned anew, perhaps from another distance, with the detector's beam elsewhere or the mirror turned.  Given
the log, each set of effects foretells the new readings as a normal distribution N(m, V): from its own
sizes, the machine, all misalignments and resets, none of them better known than the log tells, and the noise.
If set A acts, the run is expected to bring the log evidence

    KL(A‖B) = ½ [tr(V_B⁻¹V_A) − n + ln |V_B|/|V_A| + (m_A − m_B)ᵀ V_B⁻¹ (m_A − m_B)]

against B; the least over both directions and all pairs is what the run is worth.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from stepdiag_ros.effects.base import Effect, Form, StopView
from stepdiag_ros.effects.tuning import same_form
from stepdiag_ros.estimate.enhanced import prior_precision
from stepdiag_ros.estimate.forward import ForwardModel
from stepdiag_ros.estimate.noise import whiteners
from stepdiag_ros.estimate.parameters import parameters_of
from stepdiag_ros.estimate.reduce import StopTable
from stepdiag_ros.gap.closing import RESET_WIDTH_M
from stepdiag_ros.gap.evidence import SIZES
from stepdiag_ros.gap.joint import Joint
from stepdiag_ros.gap.observe import view_of
from stepdiag_ros.model.description import Setup, path_of

WALK_M = 2e-3
"""Spot at the far end when the mirror is turned on purpose: well on any detector."""
FARTHER_M = 1.0
"""How much farther away the base unit is set up."""
ASIDE_M = 0.02
"""How far the detector's beam is set aside."""

FRESH = 'mirror_mount_creep'
SOON = 'Begin right after mounting the mirror: a mount that relaxes moves most then, nothing else does.'
"""An effect that a fresh mounting shows best, whatever its forms foretell."""

Member = tuple[Effect, Form]
Run = tuple[Setup, tuple[float, float], str]


@dataclass(frozen=True)
class NextRun:
    """A setup to add at the end of the log: ``setup`` with its ``mirror_turn_rad`` about u and v.

    ``evidence``: log evidence that it is expected to bring at least; ``between``: the effects it decides between.
    ``at_once``: the run should begin right after mounting, which the forecast does not count on.
    """

    setup: Setup
    mirror_turn_rad: tuple[float, float]
    evidence: float
    between: tuple[str, ...]
    at_once: bool
    text: str

    def to_json_dict(self) -> dict:
        s = self.setup
        length = {'length': s.length, 'stops': s.stops} if s.is_linear else {}
        return {'setup': s.name, 'standoff_m': s.standoff, 'psd_offset_m': list(s.psd_offset), **length,
                'mirror_turn_rad': list(self.mirror_turn_rad), 'at_once': self.at_once,
                'expected_log_evidence': self.evidence,
                'between': list(self.between), 'text': self.text}


def recommend(joint: Joint, rivals: Sequence[Sequence[Member]]) -> NextRun | None:
    """The further run that tells the likeliest set, the first of ``rivals``, from all others best."""
    if len(rivals) < 2:
        return None
    names = [{effect.name for effect, _ in members} for members in rivals]
    between = tuple(sorted(set.union(*names) - set.intersection(*names)))
    if not between:
        return None
    plain, varied = _runs(joint)
    best = _best(joint, rivals, between, plain, None)
    # Which diagonal or line matters most by its place in time; how it is set up is tried on the best.
    return _best(joint, rivals, between, varied.get(best.setup.name, []), best) if best else None


def _best(joint: Joint, rivals: Sequence[Sequence[Member]], between: tuple[str, ...], runs: Sequence[Run],
          best: NextRun | None) -> NextRun | None:
    """The run that is worth most among ``runs`` and ``best``."""
    for setup, turn, text in runs:
        longer = _Longer(joint, setup, turn)
        forecasts = [longer.forecast(members) for members in rivals]
        if None in forecasts:
            continue
        worth = min(min(_evidence(forecasts[0], other), _evidence(other, forecasts[0]))
                    for other in forecasts[1:])
        if best is None or worth > best.evidence:
            at_once = FRESH in between
            best = NextRun(setup, turn, float(worth), between, at_once,
                           text + (f' {SOON}' if at_once else '') + _hope(worth, between))
    return best


def _hope(worth: float, between: Sequence[str]) -> str:
    """What is expected of a run, in words."""
    names = f'{", ".join(between[:-1])} and {between[-1]}'
    odds = 'more than 10000' if worth > np.log(1e4) else f'{np.exp(worth):.0f}'
    return f' It is to decide between {names}' + (
        f', with odds of {odds} to one to be expected.' if worth > np.log(3.0) else '.')


def _runs(joint: Joint) -> tuple[list[Run], dict[str, list[Run]]]:
    """Every diagonal and line once more as it was; by name of the new setup, other ways to set it up."""
    description, names = joint.observation.log.description, joint.observation.table.setup_names
    turn = WALK_M / (2.0 * (float(np.linalg.norm(description.machine.volume)) + FARTHER_M))
    plain: list[Run] = []
    varied: dict[str, list[Run]] = {}
    for base in dict.fromkeys(path_of(name) for name in names):
        old = description.setups[base if base in names else
                                 next(name for name in names if path_of(name) == base)]
        again = replace(old, name=f'{base}.{1 + sum(path_of(name) == base for name in names)}')
        label = f'line {base}' if old.is_linear else f'diagonal {base}'
        plain.append((again, (0.0, 0.0), f'Mount and align the {label} once more and measure it again.'))
        if old.is_linear:
            continue
        varied[again.name] = [
            (again, (turn, -turn), f'Measure the {label} once more with the mirror turned by '
                                   f'{turn * 1e3:.1f} mrad about both of its axes.'),
            (replace(again, standoff=round(old.standoff + FARTHER_M, 4)), (0.0, 0.0),
             f'Measure the {label} once more with the base unit {FARTHER_M:g} m farther away.'),
            (replace(again, psd_offset=(old.psd_offset[0], old.psd_offset[1] + ASIDE_M)), (0.0, 0.0),
             f"Measure the {label} once more with the position sensor's beam {ASIDE_M * 1e3:.0f} mm aside.")]
    return plain, varied


@dataclass(frozen=True)
class _Forecast:
    """White new readings as a set foretells them: ``mean`` (n,), ``factor`` (n, n) of their covariance."""

    mean: np.ndarray
    factor: np.ndarray


def _evidence(true: _Forecast, other: _Forecast) -> float:
    """Expected log evidence of the new readings for ``true`` against ``other``."""
    spread = linalg.solve_triangular(other.factor, true.factor, lower=True, check_finite=False)
    shift = linalg.solve_triangular(other.factor, true.mean - other.mean, lower=True, check_finite=False)
    volume = np.sum(np.log(np.diag(other.factor))) - np.sum(np.log(np.diag(true.factor)))
    return float(0.5 * (np.sum(spread**2) - len(shift) + shift @ shift) + volume)


class _Longer:
    """The log with one more setup: what is known of it before it is measured."""

    def __init__(self, joint: Joint, setup: Setup, turn: tuple[float, float]):
        observation, old = joint.observation, joint.fit
        like = next(i for i, name in enumerate(observation.table.setup_names)
                    if path_of(name) == path_of(setup.name))
        rows = np.flatnonzero(observation.table.setup == like)
        table = _with_setup(observation.table, rows, setup)
        log = replace(observation.log, description=replace(
            observation.log.description, setups={**observation.log.description.setups, setup.name: setup}))
        noise = replace(joint.noise, sensor=np.concatenate([joint.noise.sensor, joint.noise.sensor[rows]]))
        parameters = parameters_of(log.description, table)
        first, new = old.parameters.offset_first, len(table.run_ids) - old.parameters.runs
        theta = np.concatenate([old.theta[:first], [0.0, 0.0, *turn], old.theta[first:],
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
        self._white = whiteners(table, noise, arrival, present)
        self._new = np.concatenate([w.rows for w in self._white]) >= start * present.shape[1]
        self._nominal = self._whitened(jacobian.toarray())
        self._precision = prior_precision(parameters)
        offsets = np.arange(parameters.offset_first, parameters.size)
        self._precision[offsets, offsets] = RESET_WIDTH_M**-2.0
        residual = np.zeros(present.shape)
        residual[:start] = observation.view.reading - predicted[:start]
        self._data = self._whitened(np.where(present, residual, 0.0).ravel())[~self._new]

    def forecast(self, members: Sequence[Member]) -> _Forecast | None:
        """The new readings if ``members`` act; None where one of them has no like in the longer log."""
        forms = [self._laid(effect, form) for effect, form in members]
        if None in forms:
            return None
        columns = np.concatenate([form.columns * form.scale[:, None, None] for form in forms])
        effects = self._whitened(columns.reshape(len(columns), -1).T)
        design = np.concatenate([self._nominal, effects], axis=1)
        known, new = design[~self._new], design[self._new]
        normal, along = known.T @ known, known.T @ self._data
        best = None
        for size in SIZES:
            # The size that suits the log best: a wider one would let the effect do more than it ever did.
            precision = linalg.block_diag(self._precision, np.eye(len(columns)) / size**2)
            scale = 1.0 / np.sqrt(np.diag(normal + precision))
            factor = linalg.cholesky((normal + precision) * np.outer(scale, scale), lower=True)
            half = linalg.solve_triangular(factor, scale * along, lower=True)
            fits = 0.5 * half @ half - np.sum(np.log(np.diag(factor) / scale)) - len(columns) * np.log(size)
            if best is None or fits > best[0]:
                best = fits, factor, scale, half
        _, factor, scale, half = best
        spread = linalg.solve_triangular(factor, (new * scale).T, lower=True)
        return _Forecast(spread.T @ half, linalg.cholesky(np.eye(len(new)) + spread.T @ spread, lower=True))

    def _laid(self, effect: Effect, form: Form) -> Form | None:
        """The form at the longer log: of the same name, else the one most like it in what is measured."""
        laid = same_form(effect, form, self.view)
        if laid is not form:
            return laid
        # Time constants in a label follow the log's length: the nearest of the longer log stands in.
        count = len(form.columns[0])
        old = (form.columns * form.scale[:, None, None]).reshape(len(form.columns), -1).T
        alike = None
        for other in effect.appearance(self.view):
            if len(other.columns) < len(form.columns):
                continue
            new = (other.columns * other.scale[:, None, None])[:, :count].reshape(len(other.columns), -1).T
            norms = np.maximum(np.linalg.norm(new, axis=0), 1e-300)
            basis, value, _ = np.linalg.svd(new / norms, full_matrices=False)
            basis = basis[:, value > 1e-6 * value[0]]
            left = np.linalg.norm(old - basis @ (basis.T @ old))
            if alike is None or (len(other.columns), left) < (alike[0], alike[1]):
                alike = len(other.columns), left, other
        return alike[2] if alike and alike[1] < 0.5 * np.linalg.norm(old) else None

    def _whitened(self, values: np.ndarray) -> np.ndarray:
        return np.concatenate([w(values) for w in self._white])


def _with_setup(table: StopTable, rows: np.ndarray, setup: Setup) -> StopTable:
    """The table with the stops ``rows`` of an old setup visited once more at its end."""
    runs, number = np.unique(table.run[rows], return_inverse=True)
    ids = tuple(f'{setup.name}/{table.run_ids[run].partition("/")[2]}' for run in runs)
    starts = [table.dwell_ns[table.setup == s].min() for s in np.unique(table.setup)]
    ends = [table.done_ns[table.setup == s].max() for s in np.unique(table.setup)]
    pause = int(np.median(np.array(starts)[1:] - np.array(ends)[:-1])) if len(starts) > 1 else 0
    shift = int(table.done_ns.max()) + max(pause, 0) - int(table.dwell_ns[rows].min())
    changed = {'run': number + len(table.run_ids), 'setup': np.full(len(rows), len(table.setup_names))}
    for name in ('move_ns', 'dwell_ns', 'done_ns'):
        changed[name] = getattr(table, name)[rows] + shift
    for name in ('repeat', 'direction', 'index', 'axis', 'commanded', 'displacement', 'displacement_scatter',
                 'displacement_count', 'displacement_rows', 'spot', 'spot_scatter', 'spot_count', 'spot_rows',
                 'intensity', 'refractive_index'):
        changed[name] = getattr(table, name)[rows]
    return replace(table, run_ids=(*table.run_ids, *ids), setup_names=(*table.setup_names, setup.name),
                   **{name: np.concatenate([getattr(table, name), value]) for name, value in changed.items()})
