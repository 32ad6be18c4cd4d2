"""The position reached depends on the direction of approach.

Play, friction and wind-up leave an axis behind on the side it came from: by half the reversal error,
against its last motion.  Reported is the whole reversal error B of each axis (ISO 230-2).
"""

from collections.abc import Mapping

import numpy as np

from stepdiag_ros.effects.adoption import Fitted
from stepdiag_ros.effects.base import Effect, Form, Moment, Parameter, StopView

AXES = ('X', 'Y', 'Z')
WAVES = 6
"""Cosines along an axis that a reversal error may follow."""


class Backlash(Effect):
    name = 'backlash'
    short = 'Backlash (lost motion on reversal)'
    title = 'An axis stops at a different place depending on the direction it came from.'
    parameters = (Parameter('B', 'm', 0.0, 3e-5, 3, 'reversal error of X, Y, Z'),
                  Parameter('along', 'm', -3e-5, 3e-5, 3 * WAVES, 'by how much more along X, then Y, then Z: sizes of '
                            f'{WAVES} cosines, of half a wave over its travel the first', detail=True),
                  Parameter('load', 'm', -3e-5, 3e-5, 6, 'by how much more of X along Y and along Z, of Y along X and '
                            'along Z, of Z along X and along Y, from end to end', detail=True))
    sources = ('ISO 230-2, reversal error B',)
    remedy = 'Check the ball screw, its bearings and the scale mount; set the reversal compensation.'
    signature = 'Steps by the same amount whenever an axis turns round.'
    neighbours = 'count_slip steps once; servo_settling creeps inside the dwell; structural_thermal_drift is smooth.'

    def before_pose(self, moment: Moment) -> None:
        share = moment.commanded / np.array(moment.description.machine.volume)
        waves = np.cos(np.pi * np.arange(1, WAVES + 1) * share[:, :, None])
        loaded = np.zeros((3, 3))
        loaded[~np.eye(3, dtype=bool)] = self.load
        lost = self.B + np.einsum('naw,aw->na', waves, self.along.reshape(3, WAVES)) + (share - 0.5) @ loaded.T
        moment.position = moment.position - 0.5 * lost * moment.approach

    def appearance(self, view: StopView) -> list[Form]:
        forms = []
        for how, approach in _starts(view).items():
            half = -0.5 * approach.T[:, :, None] * view.by_shift
            # Which side an axis was on before the log's first moves is not known: left free.
            open_start = -0.5 * (approach.T == 0.0)[:, :, None] * view.by_shift
            begin = [k for k in range(3) if np.any(open_start[k])]
            nuisance, names = open_start[begin], tuple(f'{AXES[k]} at the start' for k in begin)
            forms.append(Form(f'constant reversal, {how}', np.concatenate([half, nuisance]),
                              AXES + names, np.full(3 + len(begin), 3e-6)))
            # Wind-up that grows along the travel: the reversal differs from end to end.
            share = view.commanded.T / np.array(view.description.machine.volume)[:, None] - 0.5
            forms.append(Form(f'reversal changing along the axis, {how}',
                              np.concatenate([half, half * share[:, :, None], nuisance]),
                              AXES + tuple(f'{a} along travel' for a in AXES) + names,
                              np.full(6 + len(begin), 3e-6)))
            # A worn screw has its own play at every place.
            waves = np.cos(np.pi * np.arange(1, WAVES + 1)[:, None, None] * (share + 0.5))
            worn = (half[None] * waves[..., None]).reshape(-1, *view.reading.shape)
            worn_names = tuple(f'{a} wave {k}' for k in range(1, WAVES + 1) for a in AXES)
            forms.append(Form(f'reversal of each place, {how}', np.concatenate([half, worn, nuisance]),
                              AXES + worn_names
                              + names, np.full(3 + 3 * WAVES + len(begin), 3e-6)))
            # What another axis carries there loads the screw: the reversal follows its place too.
            others = [(a, b) for a in range(3) for b in range(3) if a != b and np.ptp(share[b]) > 0.0]
            if not others:
                continue
            loaded = np.stack([half[a] * share[b][:, None] for a, b in others])
            forms.append(Form(f'reversal of each place and under load, {how}',
                              np.concatenate([half, worn, loaded, nuisance]),
                              AXES + worn_names
                              + tuple(f'{AXES[a]} along {AXES[b]}' for a, b in others) + names,
                              np.full(3 + 3 * WAVES + len(others) + len(begin), 3e-6)))
        return forms

    def guess(self, fitted: Fitted) -> Mapping[str, object]:
        values = fitted.values
        return {'B': [max(values.get(axis, 0.0), 0.0) for axis in 'XYZ']}


def _starts(view: StopView) -> dict[str, np.ndarray]:
    """Signs of approach (n, 3) by what may have been before a setup's first moves."""
    unknown = view.approach == 0.0
    onward = view.approach.copy()
    travelled = view.approach.copy()
    kept = view.approach.copy()
    last = own = np.zeros(3)
    for i in range(len(onward)):
        step = np.sign(view.commanded[i] - view.commanded[i - 1]) if i else np.zeros(3)
        last = np.where(step != 0.0, step, last)
        own = np.where(unknown[i], own, view.approach[i])
        travelled[i] = np.where(unknown[i], last, travelled[i])
        kept[i] = own
    for i in range(len(onward) - 2, -1, -1):
        if view.setup[i] == view.setup[i + 1]:
            onward[i] = np.where(unknown[i], onward[i + 1], onward[i])
    overrun = view.approach.copy()
    for axis, name in enumerate(('lin_x', 'lin_y', 'lin_z')):
        if name in view.setup_names:
            rows = view.setup == view.setup_names.index(name)
            overrun[rows, axis] = view.direction[rows]
    result = {'released before the first move': view.approach,
            'carried over between setups': travelled,
            'kept from the last run': kept,
            'as if moved on': onward}
    if np.any(overrun != view.approach):
        # A positioning test by ISO 230-2 runs past its ends, to come to the last target from beyond.
        result['overrun at the turns'] = overrun
    return result
