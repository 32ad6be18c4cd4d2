"""The machine and its effects fitted together.

Given which effects act and in which form, their coefficients are found in parity space, the readings
are freed of them, machine and misalignments are fitted anew, and the forms are laid anew at the new
fit: a few rounds, for misalignments act to second order and a gross effect moves them far.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from stepdiag_ros.effects.base import Effect, Form
from stepdiag_ros.effects.tuning import same_form, tune
from stepdiag_ros.estimate.enhanced import Fit, readings_of
from stepdiag_ros.estimate.evaluate import solution_of
from stepdiag_ros.estimate.noise import NoiseModel, estimate_noise
from stepdiag_ros.estimate.solution import Solution
from stepdiag_ros.gap.evidence import judge, width_of
from stepdiag_ros.gap.observe import Observation, sane_fit, view_of
from stepdiag_ros.gap.parity import Parity, parity

ROUNDS = 4
SHAPE_STEP = 1e-3
"""Relative step in a shape parameter for its derivative."""
SETTLED = 0.02
"""Rounds end when no coefficient moves by more than this many standard deviations … or percent."""


@dataclass(frozen=True)
class Active:
    """An effect in one form with its coefficients (k,) and their covariance (k, k), in the form's units.

    ``shape_sigma``: standard deviations of the form's tuned shape parameters.
    """

    effect: Effect
    form: Form
    coefficients: np.ndarray
    covariance: np.ndarray
    shape_sigma: Mapping[str, float] = field(default_factory=dict)

    @property
    def contribution(self) -> np.ndarray:
        """What it adds to the stops' readings (n, c) [m]."""
        return np.tensordot(self.coefficients, self.form.columns, axes=1)

    @property
    def inside(self) -> np.ndarray | float:
        """What it adds to the bins (n, b, c) [m]."""
        if self.form.inside is None:
            return 0.0
        return np.tensordot(self.coefficients, self.form.inside, axes=1)


@dataclass(frozen=True)
class Joint:
    """A joint fit: ``observation`` with the fit and the view of the machine freed of the effects,
    ``noise`` of the freed readings, ``parity`` whose data still hold the effects."""

    observation: Observation
    noise: NoiseModel
    parity: Parity
    active: tuple[Active, ...]

    @property
    def fit(self) -> Fit:
        return self.observation.fit


def fit_jointly(observation: Observation, chosen: list[tuple[Effect, Form]],
                noise: NoiseModel) -> Joint:
    """Fit machine and ``chosen`` effects; ``observation`` and ``noise`` start the rounds."""
    table, readings = observation.table, readings_of(observation.table)
    space = parity(observation, observation.fit, noise, readings)
    chosen = tuned(space, chosen)
    active = solve(space, chosen)
    if not chosen:
        return Joint(observation, noise, space, ())
    for _ in range(ROUNDS):
        added = sum(a.contribution for a in active)
        freed = replace(table, displacement=table.displacement - added[:, :-2],
                        spot=table.spot - added[:, -2:])
        result = sane_fit(observation.log, freed, observation.fit.theta)
        noise = estimate_noise(freed, observation.log.description.noise, result.arrival)
        view = replace(view_of(observation.log, table, result, observation.view.bin_time),
                       reading=readings)
        observation = replace(observation, fit=result, view=view)
        chosen = [(effect, same_form(effect, form, view)) for effect, form in chosen]
        rest = observation.bins - sum(a.inside for a in active)
        scale = _bin_scale(rest, observation.bin_sigma)
        space = parity(observation, result, noise, readings, scale)
        chosen = tuned(space, chosen)
        updated = solve(space, chosen)
        moved = max((np.max(np.abs(new.coefficients - old.coefficients)
                            / (SETTLED * (np.sqrt(np.diag(new.covariance))
                                          + 0.5 * np.abs(new.coefficients)) + 1e-300))
                     for new, old in zip(updated, active, strict=True)), default=0.0)
        active = updated
        if moved < 1.0:
            break
    return Joint(observation, noise, space, with_shapes(space, active))


def _bin_scale(bins: np.ndarray, sigma: np.ndarray) -> float:
    ratio = np.abs(bins / sigma[:, None, :])
    ratio = ratio[np.isfinite(ratio)]
    return max(1.0, float(np.median(ratio)) / 0.6745) if len(ratio) else 1.0


def tuned(space: Parity, chosen: list[tuple[Effect, Form]]) -> list[tuple[Effect, Form]]:
    """The chosen forms, each with the shape parameters that suit best given the others."""
    active = solve(space, chosen)
    result = []
    for k, (effect, form) in enumerate(chosen):
        rest = unexplained(space, active[:k] + active[k + 1:])

        def explained(tried: Form, rest: np.ndarray = rest) -> float:
            columns = space.project(tried)
            normal = columns.T @ columns + np.eye(columns.shape[1]) / width_of(tried) ** 2
            along = columns.T @ rest
            return float(along @ np.linalg.solve(normal, along))

        result.append((effect, _held(space, form, rest) if form.process else tune(form, explained)))
    return result


def _held(space: Parity, form: Form, rest: np.ndarray) -> Form:
    """An unknown course held to the size that speaks best for it in what the others leave."""
    columns = space.project(form)
    judged = judge((columns.T @ columns)[None], (columns.T @ rest)[None], float(rest @ rest),
                   sum(space.dof), float(sum(space.dof)))
    return replace(form, held=judged[0].size)


def solve(space: Parity, chosen: list[tuple[Effect, Form]]) -> tuple[Active, ...]:
    """Coefficients of all chosen forms together, each held to the widest size only."""
    if not chosen:
        return ()
    blocks = [space.project(form) for _, form in chosen]
    columns = np.concatenate(blocks, axis=1)
    normal = columns.T @ columns + np.diag(widths([form for _, form in chosen]) ** -2.0)
    along = columns.T @ space.data
    start = 0
    for (_, form), block in zip(chosen, blocks, strict=True):
        part = slice(start, start + block.shape[1])
        start = part.stop
        if form.by_reading is not None:
            owed, width = space.own_noise(form)
            along[part] -= owed
            normal[part, part] += width
    covariance = np.linalg.inv(normal)
    values = covariance @ along
    result, start = [], 0
    for (effect, form), block in zip(chosen, blocks, strict=True):
        part = slice(start, start + block.shape[1])
        start = part.stop
        result.append(Active(effect, form, values[part] * form.scale,
                             covariance[part, part] * np.outer(form.scale, form.scale)))
    return tuple(result)


def widths(forms: Iterable[Form]) -> np.ndarray:
    """Standard deviations of all coefficients of some forms, in their scales."""
    return np.concatenate([np.full(len(form.columns), width_of(form)) for form in forms])


def with_shapes(space: Parity, active: tuple[Active, ...]) -> tuple[Active, ...]:
    """The same with the uncertainty of tuned shape parameters: their own, and what it adds to the coefficients'.

    Each shape parameter is one more unknown, on a logarithmic scale and held to a factor of ten; its column
    is the change of the effect's contribution.
    """
    blocks = [space.project(a.form) for a in active]
    columns, places = [], []
    for k, a in enumerate(active):
        if a.form.retune is None:
            continue
        for name, value in a.form.shape.items():
            other = a.form.at({**a.form.shape, name: value * (1.0 + SHAPE_STEP)})
            size = a.coefficients / a.form.scale
            columns.append((space.project(other) - blocks[k]) @ size / SHAPE_STEP)
            places.append((k, name, value))
    if not columns:
        return active
    linear = np.concatenate(blocks, axis=1)
    whole = np.column_stack([linear, *columns])
    width = np.concatenate([widths(a.form for a in active), np.full(len(columns), np.log(10.0))])
    covariance = np.linalg.inv(whole.T @ whole + np.diag(width**-2.0))
    result, start = [], 0
    for k, (a, block) in enumerate(zip(active, blocks, strict=True)):
        part = slice(start, start + block.shape[1])
        start = part.stop
        own = {name: float(value * np.sqrt(covariance[linear.shape[1] + i, linear.shape[1] + i]))
               for i, (of, name, value) in enumerate(places) if of == k}
        result.append(replace(a, covariance=covariance[part, part] * np.outer(a.form.scale, a.form.scale),
                              shape_sigma=own))
    return tuple(result)


def unexplained(space: Parity, active: tuple[Active, ...]) -> np.ndarray:
    """White residuals (N,) that the effects leave."""
    rest = space.data
    for a in active:
        rest = rest - space.project(a.form) @ (a.coefficients / a.form.scale)
    return rest


def freed_solution(joint: Joint) -> Solution:
    """The machine's errors with the effects taken out; what the effects' own uncertainty adds included."""
    result = joint.fit
    if joint.active:
        columns = [joint.parity.white_part(a.form.columns) * a.form.scale for a in joint.active]
        jacobian = np.concatenate([w(result.jacobian.toarray()) for w in joint.parity._white])
        white = np.concatenate(columns, axis=1)[:len(jacobian)]
        # The unknowns follow a change of the coefficients by −(JᵀJ + P)⁻¹ JᵀB.
        normal = jacobian.T @ jacobian + result.precision
        follow = np.linalg.solve(normal, jacobian.T @ white)
        left = white.T @ white - white.T @ jacobian @ follow
        spread = np.linalg.inv(left + np.diag(widths(a.form for a in joint.active) ** -2.0))
        result = replace(result, covariance=np.linalg.inv(normal) + follow @ spread @ follow.T)
    rest = unexplained(joint.parity, joint.active)[:joint.parity.stops]
    result = replace(result, chi2=float(rest @ rest), dof=joint.parity.dof[0])
    return solution_of(result, joint.observation.table)
