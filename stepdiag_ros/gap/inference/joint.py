"""The machine and its effects fitted together.

Given which effects act and in which form, their coefficients are found in parity space, the readings
are freed of them, machine and misalignments are fitted anew, and the forms are laid anew at the new
fit: a few rounds, for misalignments act to second order and a large effect moves them far.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product

import numpy as np
from scipy import linalg

from stepdiag_ros.effects.base import Effect, Form
from stepdiag_ros.effects.tuning import same_form, tune
from stepdiag_ros.estimate import dense
from stepdiag_ros.estimate.eigen import eigen
from stepdiag_ros.estimate.enhanced import Fit, readings_of
from stepdiag_ros.estimate.imitation import what_is_left
from stepdiag_ros.estimate.noise import NoiseModel, estimate_noise
from stepdiag_ros.estimate.noise_law import Latent, latents
from stepdiag_ros.estimate.reduce import StopTable
from stepdiag_ros.gap.inference.evidence import SIZES, Judged, judge, prior_sigma_of
from stepdiag_ros.gap.inference.parity import Parity, parity
from stepdiag_ros.gap.noise.arrival_law import reweighed
from stepdiag_ros.gap.preprocess.observe import Observation, sane_fit, view_of

ROUNDS = 4
SHAPE_STEP = 1e-3
"""Relative step in a shape parameter for its derivative."""
FREE = 3.0
"""Coefficients that are no process are held to this many times the size that the log shows: those that it
settles hardly feel it, those that nothing settles stay where the model is linear."""
LEAST_SIZE = 0.02
"""Sizes of an unknown profile less probable than this are left out."""
SETTLED = 0.02
"""Rounds end when no coefficient moves by more than this many standard deviations … or percent."""
LEAST_PIVOT = 1e-6
"""Pivot of a matrix with a unit diagonal below which its inverse is that of its eigenvalues, held at rounding's."""


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

    @cached_property
    def normal(self) -> np.ndarray:
        """``JᵀJ + P`` (size, size) of the white Jacobian ``J`` (rows, size) of the fit and the unknowns' priors."""
        return dense.normal_equations(self.fit.jacobian, self.parity.projection.white) + self.fit.precision

    @cached_property
    def left(self) -> np.ndarray:
        """What a fit without noise leaves of all that the effects add (n, c) [m], 0 where there is no reading."""
        observation, result = self.observation, self.fit
        added = np.where(result.present, sum(a.contribution for a in self.active), 0.0)
        return what_is_left(observation.log.description, observation.table, self.noise, result.theta, added)[0]

    def latents(self) -> Iterator[Latent]:
        """The errors of the arrivals, run by run, as the white readings show them."""
        return latents(self.observation.table, self.noise, self.fit.arrival, self.parity.projection.white)

    def whitened(self, values: np.ndarray) -> np.ndarray:
        """White version (rows, …) of the readings or Jacobian rows (n·c, …), the resets not taken out."""
        return np.concatenate([w.solve(values[w.rows]) for w in self.parity.projection.white])

    def freed(self, values: np.ndarray) -> np.ndarray:
        """The same without what the resets of the runs can do."""
        return np.concatenate([w.forward(values[w.rows]) for w in self.parity.projection.white])

    def along(self, white: np.ndarray, run: int | None = None) -> np.ndarray:
        """Products ``Jᵀ`` (size, k) of the white Jacobian with a change (rows, k) of the readings, or of one run's."""
        space = self.parity.projection
        if run is not None:
            one = space.white[run]
            return self.fit.jacobian[one.rows].T @ one.solve_back(white)
        back = np.zeros((self.fit.jacobian.shape[0], white.shape[1]))
        for one, rows in zip(space.white, space.runs, strict=True):
            back[one.rows] = one.solve_back(white[rows])
        return self.fit.jacobian.T @ back

    def followed(self, along: np.ndarray) -> np.ndarray:
        """How the unknowns follow a change of the readings with the products ``along`` (size, k): (JᵀJ + P)⁻¹ of
        these."""
        return np.linalg.solve(self.normal, along)


def fit_jointly(observation: Observation, chosen: list[tuple[Effect, Form]],
                noise: NoiseModel) -> Joint:
    """Fit machine and ``chosen`` effects; ``observation`` and ``noise`` start the rounds."""
    readings = readings_of(observation.table)
    space = parity(observation, observation.fit, noise, readings)
    chosen = tuned(space, chosen)
    active = solve(space, chosen)
    if not chosen:
        return Joint(observation, noise, space, ())
    for _ in range(ROUNDS):
        without = freed(observation.table, active)
        result = sane_fit(observation.log, without, observation.fit.theta, None if noise.tidy else noise)
        result = _as_read(result, active)
        observation = refitted(observation, result)
        noise = estimate_noise(without, observation.log.description.noise, result.arrival) if noise.tidy \
            else reweighed(observation, noise, without)
        chosen = [(effect, same_form(effect, form, observation.view)) for effect, form in chosen]
        space = parity(observation, result, noise, readings, observation.bins - sum(a.inside for a in active))
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


def _as_read(result: Fit, active: Iterable[Active]) -> Fit:
    """The fit, and what errors of arrivals do to the readings as the effects let it be read: a gain of the spot is one
    of its noise."""
    arrival = result.arrival
    for a in active:
        if a.form.gain is not None:
            arrival = arrival * (1.0 + a.coefficients @ a.form.gain)
    return replace(result, arrival=arrival)


def freed(table: StopTable, active: Iterable[Active]) -> StopTable:
    """The stops with the effects taken off their readings."""
    active = tuple(active)
    if not active:
        return table
    added = sum(a.contribution for a in active)
    return replace(table, displacement=table.displacement - added[:, :-2], spot=table.spot - added[:, -2:])


def refitted(observation: Observation, result: Fit) -> Observation:
    """The observation at another fit: what effects depend on is laid anew, the readings are as they were read."""
    return replace(observation, fit=result,
                   view=view_of(observation.log, observation.table, result, observation.view.bin_time))


def tuned(space: Parity, chosen: list[tuple[Effect, Form]]) -> list[tuple[Effect, Form]]:
    """The chosen forms, each with the shape parameters that suit best given the others."""
    active = solve(space, chosen)
    result = []
    for k, (effect, form) in enumerate(chosen):
        rest = unexplained(space, active[:k] + active[k + 1:])

        def explained(tried: Form, rest: np.ndarray = rest) -> float:
            columns = space.project(tried)
            normal = columns.T @ columns + np.eye(columns.shape[1]) / prior_sigma_of(tried) ** 2
            along = columns.T @ rest
            return float(along @ np.linalg.solve(normal, along))

        form = form if form.process else tune(form, explained)
        result.append((effect, _held(form, _judged(space, form, rest))))
    return result


def held_to_sizes(space: Parity, chosen: list[tuple[Effect, Form]]) -> list[tuple[float, list[tuple[Effect, Form]]]]:
    """The chosen forms, untuned, each held to the size that the log shows, an unknown profile in turn to each size
    that the log leaves it; with their probabilities.

    Where little of a profile is seen (a gain that ages, of which only the ageing shows), its size is hardly known,
    nor how far what is not seen may go.
    """
    active, ways = solve(space, chosen), []
    for k, (effect, form) in enumerate(chosen):
        judged = _judged(space, form, unexplained(space, active[:k] + active[k + 1:]))
        if form.process:
            sizes = [(p, float(size)) for p, size in zip(judged.of_sizes, SIZES, strict=True) if p > LEAST_SIZE]
            ways.append([(p, (effect, replace(form, held=size))) for p, size in sizes])
        else:
            ways.append([(1.0, (effect, _held(form, judged)))])
    return [(float(np.prod([p for p, _ in way])), [pair for _, pair in way]) for way in product(*ways)]


def _judged(space: Parity, form: Form, rest: np.ndarray) -> Judged:
    """A form judged in what the others leave."""
    columns = space.project(form)
    return judge((columns.T @ columns)[None], (columns.T @ rest)[None], float(rest @ rest), sum(space.dof),
                 float(sum(space.dof)))[0]


def _held(form: Form, judged: Judged) -> Form:
    """A form held to the size that speaks best for it: an unknown profile to that itself, other coefficients to a
    few times as much."""
    return replace(form, held=judged.size if form.process else min(FREE * judged.size, float(SIZES[-1])))


def size_of(form: Form) -> float:
    """The size, in its scales, that the log shows of a form held to it."""
    return prior_sigma_of(form) if form.process else prior_sigma_of(form) / FREE


def solve(space: Parity, chosen: list[tuple[Effect, Form]]) -> tuple[Active, ...]:
    """Coefficients of all chosen forms together, each held to its form's size."""
    if not chosen:
        return ()
    columns = np.concatenate([space.project(form) for _, form in chosen], axis=1)
    normal = columns.T @ columns + np.diag(prior_sigmas([form for _, form in chosen]) ** -2.0)
    along = columns.T @ space.data
    if any(form.by_reading is not None for _, form in chosen):
        own = np.concatenate([np.zeros((len(space.own_data), len(form.columns))) if form.by_reading is None
                              else space.own_rows(form) for _, form in chosen], axis=1)
        normal += own.T @ own
        along += own.T @ space.own_data
    covariance = inverse(normal)
    values = covariance @ along
    result, start = [], 0
    for effect, form in chosen:
        part = slice(start, start + len(form.columns))
        start = part.stop
        result.append(Active(effect, form, values[part] * form.scale,
                             covariance[part, part] * np.outer(form.scale, form.scale)))
    return tuple(result)


def prior_sigmas(forms: Iterable[Form]) -> np.ndarray:
    """Standard deviations of all coefficients of some forms, in their scales."""
    return np.concatenate([np.full(len(form.columns), prior_sigma_of(form)) for form in forms])


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
    sigma = np.concatenate([prior_sigmas(a.form for a in active), np.full(len(columns), np.log(10.0))])
    covariance = inverse(whole.T @ whole + np.diag(sigma**-2.0))
    result, start = [], 0
    for k, (a, block) in enumerate(zip(active, blocks, strict=True)):
        part = slice(start, start + block.shape[1])
        start = part.stop
        own = {name: float(value * np.sqrt(covariance[linear.shape[1] + i, linear.shape[1] + i]))
               for i, (of, name, value) in enumerate(places) if of == k}
        result.append(replace(a, covariance=covariance[part, part] * np.outer(a.form.scale, a.form.scale),
                              shape_sigma=own))
    return tuple(result)


def inverse_root(normal: np.ndarray) -> np.ndarray:
    """``F`` (k, k) with ``FFᵀ`` the inverse of a positive definite matrix (k, k), its units evened out.

    Forms that a large effect blew up may differ by eleven orders; a direction that only rounding leaves
    is held at the rounding's size instead of getting a negative variance.
    """
    scale = 1.0 / np.sqrt(np.diag(normal))
    value, vector = eigen(normal * np.outer(scale, scale))
    value = np.maximum(value, np.finfo(float).eps * len(value) * value[-1])
    return scale[:, None] * vector / np.sqrt(value)


def inverse(normal: np.ndarray) -> np.ndarray:
    """Inverse of a positive definite matrix (k, k), as :func:`inverse_root` gives it."""
    scale = 1.0 / np.sqrt(np.diag(normal))
    factor, failed = linalg.lapack.dpotrf(normal * np.outer(scale, scale), lower=1)
    if failed or np.diag(factor).min(initial=1.0) < LEAST_PIVOT:
        root = inverse_root(normal)
        return root @ root.T
    return dense.inverse(factor, scale)


def unexplained(space: Parity, active: tuple[Active, ...]) -> np.ndarray:
    """White residuals (N,) that the effects leave."""
    rest = space.data
    for a in active:
        rest = rest - space.project(a.form) @ (a.coefficients / a.form.scale)
    return rest
