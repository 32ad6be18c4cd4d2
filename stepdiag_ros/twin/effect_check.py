"""An effect of the user's own on trial: how it acts held against how it appears, in a small virtual cell.

The same cell is simulated with and without the effect.  What changed is fitted, in parity space, with each of the
effect's forms and with those of every other effect; then the log with the effect is diagnosed as any log would be.
"""

from dataclasses import dataclass, replace

import numpy as np

from stepdiag_ros.effects import all_effects
from stepdiag_ros.effects.base import Effect, Form
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.enhanced import readings_of
from stepdiag_ros.estimate.noise import NoiseModel, sensor_noise
from stepdiag_ros.gap.diagnose import diagnose
from stepdiag_ros.gap.inference.parity import Parity, parity
from stepdiag_ros.gap.preprocess.observe import Observation, observe
from stepdiag_ros.virtual.cell import Cell, parse_cell
from stepdiag_ros.virtual.offline import simulate_log

CELL = """\
seed: 5
machine: {name: effect_check, volume: [0.5, 0.4, 0.3], tool: [0.02, -0.01, -0.12]}
plan: {steps: 4, repeats: 2}
setups:
  ppp: {standoff: 0.3, psd_offset: [0.02, 0.01]}
  npp: {standoff: 0.3, psd_offset: [0.02, 0.01]}
  pnp: {standoff: 0.3, psd_offset: [0.02, 0.01]}
  nnp: {standoff: 0.3, psd_offset: [0.02, 0.01]}
  lin_x: {standoff: 0.3, psd_offset: [0.02, 0.01], length: 0.5, stops: 4}
  lin_y: {standoff: 0.3, psd_offset: [0.02, 0.01], length: 0.4, stops: 4}
  lin_z: {standoff: 0.3, psd_offset: [0.02, 0.01], length: 0.3, stops: 4}
noise: {displacement: 2.0e-8, spot: 2.0e-7, position_repeatability: 5.0e-8, angle_repeatability: 1.0e-7}
misalignments: {drawn: {laser: 4e-4, mirror: 3e-4}}
air: {temperature: 20.0, sensors: [temperature, pressure, humidity, scale], period: 1.0}
motion: {feed: 0.5, acceleration: 4.0, jerk: 400.0, in_position: 1.0e-8, settling: 0.001, dwell: 1.0, mount: 100.0}
sampling: {interferometer: 20, psd: 20, in_motion: false}
"""
MOST_LEFT = 0.1
"""Share of what the effect does that the best of its forms may leave: as much as a form to first order misses."""
SIZES = (0.8, 1.25)
"""Between these lies an estimated size over the given one where the two faces say the same."""
SEEN = 8.0
"""σ of what the effect does in the log from which it is on trial; drawn sizes may be less, then they are raised."""
APART = 3.0
"""σ below which what another effect leaves tells nothing."""
MOST_RAISED = 100.0
TIME_TRIED = 100.0
"""A time constant [s] as long as the mounting before the first dwell, or the nearest that is plausible: what the two
faces count from different beginnings then differs by a factor of e."""


@dataclass(frozen=True)
class Checked:
    """What came of one effect.

    ``parameters`` tried; ``sigma``: how far beyond the noise what it does stands; ``form`` that comes nearest and the
    share ``left`` that it leaves; ``ratio``: estimated size over the given one, ± ``ratio_sigma``, None where no
    parameter is the size of the form; ``confounded``: effects whose forms leave less than ``APART`` σ, with the σ;
    ``named``: probabilities of the diagnosis; ``problems``: what is wrong, each with what to do; none: the check is
    passed.
    """

    name: str
    parameters: dict[str, object]
    sigma: float
    form: str
    left: float
    ratio: float | None
    ratio_sigma: float | None
    confounded: dict[str, float]
    named: dict[str, float]
    problems: tuple[str, ...]


def check_effect(kind: type[Effect], seed: int = 1) -> Checked:
    """Try one effect; :class:`~stepdiag_ros.errors.StepdiagError` where it gives what no effect may give."""
    cell = parse_cell(CELL, f'effect check of {kind.name}')
    bare = observe(simulate_log(cell))
    noise = cell.description.noise
    space = parity(bare, bare.fit, NoiseModel(noise.position_repeatability, noise.angle_repeatability,
                                              sensor_noise(bare.table, noise), 'given'), readings_of(bare.table))
    values = dict(kind.draw(np.random.default_rng(seed)))
    values |= {p.name: float(np.clip(TIME_TRIED, p.low, p.high)) for p in kind.parameters
               if p.unit == 's' and p.size == 1 and p.low > 0.0}
    acting, target = _seen(kind, values, cell, bare, space)
    sigma = float(np.linalg.norm(target))
    forms = _with_times(kind(**values).appearance(acting.view), values)
    problems = []
    if sigma < SEEN:
        problems.append(f'with the drawn parameters it changes the log by {sigma:.2g} σ only, even raised '
                        f'{MOST_RAISED:g} times; check what before_pose, before_light and after_light change, or the '
                        'bounds of parameters')
    if not forms:
        problems.append('appearance gives no form for this log, so no diagnosis can find it; give one')
        return Checked(kind.name, values, sigma, '', 1.0, None, None, {}, {}, tuple(problems))
    lefts = [left_by(target, space.project(form)) / max(sigma, 1e-300) for form in forms]
    best = int(np.argmin(lefts))
    # Forms as good as the best may say the size more plainly: one coefficient for one parameter.
    ratio, ratio_sigma, sized = _ratio(kind, values, forms, lefts, target, space)
    if sigma >= SEEN and lefts[best] > max(MOST_LEFT, APART / sigma):
        problems.append(f'its best form ({forms[best].label}) leaves {100 * lefts[best]:.0f} % of what it does; '
                        'correct the columns (sign, direction, where its time profile begins: view.elapsed is '
                        'moment.seconds) or add a form')
    if ratio is not None and not SIZES[0] <= ratio <= SIZES[1] and abs(ratio - 1.0) > APART * ratio_sigma:
        problems.append(f'{sized} is estimated {ratio:.3f} ± {ratio_sigma:.3f} times as large as it was given; correct '
                        'the columns, which are changes per unit of the coefficient, or their time profile (counted '
                        'from the beginning of the log: view.elapsed)')
    confounded = {}
    for name, other in all_effects().items():
        rests = [left_by(target, space.project(form)) for form in other().appearance(acting.view)]
        if min(rests, default=sigma) < min(APART, 0.5 * sigma):
            confounded[name] = float(min(rests))
    diagnosis = diagnose(simulate_log(cell, effects=[kind(**values)]), [*(k() for k in all_effects().values()), kind()])
    named = {name: float(p) for name, p in diagnosis.ranking.items() if p >= 0.01}
    if sigma >= SEEN and not confounded and named.get(kind.name, 0.0) < 0.5:
        problems.append(f'the diagnosis of its own log gives it a probability of {named.get(kind.name, 0.0):.2f}; give '
                        'forms of the right size (scale) and time profile')
    return Checked(kind.name, values, sigma, forms[best].label, lefts[best], ratio, ratio_sigma, confounded, named,
                   tuple(problems))


def left_by(target: np.ndarray, columns: np.ndarray) -> float:
    """Norm of what ``columns`` (N, k) leave of ``target`` (N,)."""
    norms = np.linalg.norm(columns, axis=0)
    columns = columns[:, norms > 1e-9 * max(norms.max(initial=0.0), 1e-300)]
    stacked = np.column_stack([columns / np.linalg.norm(columns, axis=0), target])
    # The last of the triangle's diagonal is what the columns before leave of the last one.
    return float(abs(np.linalg.qr(stacked, mode='r')[-1, -1]))


def _seen(kind: type[Effect], values: dict[str, object], cell: Cell, bare: Observation,
          space: Parity) -> tuple[Observation, np.ndarray]:
    """The log with the effect observed, and what changed there in parity space (N,) [σ]; ``values`` of sizes are raised
    in place where they were drawn too small to see."""
    raised = 1.0
    while True:
        try:
            acting = observe(simulate_log(cell, effects=[kind(**values)]))
        except (ValueError, TypeError) as error:
            raise StepdiagError(f'{kind.file}: {kind.__name__}: its parameters {values} cannot be simulated: {error}; '
                                'correct parameters or draw') from None
        change = Form('change', np.nan_to_num(readings_of(acting.table) - readings_of(bare.table))[None], ('size',),
                      np.ones(1), inside=np.nan_to_num(acting.bins - bare.bins)[None])
        target = space.project(change)[:, 0]
        if np.linalg.norm(target) >= 3.0 * SEEN or raised >= MOST_RAISED:
            return acting, target
        raised *= 10.0
        for p in kind.parameters:
            if p.unit != 's' and not isinstance(values[p.name], str):
                values[p.name] = (10.0 * np.asarray(values[p.name], float)).tolist()


def _with_times(forms: list[Form], values: dict[str, object]) -> list[Form]:
    """``forms`` and, of those whose shape has a parameter of the effect, the same with its value."""
    tuned = []
    for form in forms:
        same = {key: float(values[key[:-2]]) for key in form.shape
                if key.endswith('_s') and isinstance(values.get(key[:-2]), float)}
        if same and form.retune is not None:
            tuned.append(form.at({**form.shape, **same}))
    return [*tuned, *forms]


def _ratio(kind: type[Effect], values: dict[str, object], forms: list[Form], lefts: list[float], target: np.ndarray,
           space: Parity) -> tuple[float | None, float | None, str]:
    """Estimated size over the given one, its σ, and what it is the size of: of the best form whose coefficients are as
    many and in the unit of one parameter."""
    for k in np.argsort(lefts, kind='stable'):
        form = forms[k]
        sizes = [p for p in kind.parameters if p.unit == form.units and np.size(values[p.name]) == len(form.names)]
        if form.process or len(sizes) != 1 or lefts[k] > 0.5:
            continue
        columns = space.project(replace(form, scale=np.ones(len(form.names))))
        given = np.atleast_1d(np.asarray(values[sizes[0].name], float))
        norm = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        pseudo = np.linalg.pinv(columns / norm, rcond=1e-9) / norm[:, None]
        found, power = pseudo @ target, float(given @ given)
        if power <= 0.0:
            continue
        return float(found @ given) / power, float(np.linalg.norm(given @ pseudo)) / power, sizes[0].name
    return None, None, ''
