"""What to measure next: the run that a cell can do which tells the candidates apart best.

Each candidate foretells, with the size fitted to the log, what a further run would read.  The run's
power to discriminate two candidates is the distance of the two forecasts in units of the noise, freed
of what a new fit could imitate; the run with the greatest least distance is advised.  Runs whose outcome
an effect's appearance can be computed for are judged by computation; for the rest there is a rule that
follows from what the effect is.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stepdiag_ros.effects.base import Effect, Form, StopView
from stepdiag_ros.gap.joint import Joint
from stepdiag_ros.gap.parity import Parity


@dataclass(frozen=True)
class Advice:
    """A run to do, in words, and its power: least distance [σ] between the candidates' forecasts."""

    text: str
    power: float


LATER_S = 1800.0
TURNED_RAD = 1e-3
DISPLACED_M = 1e-3

SPECIAL = {
    frozenset({'psd_gain', 'ambient_light'}):
        'Switch the light off or cover the detector and repeat one diagonal: '
        'a wrong gain stays, background light goes.',
    frozenset({'psd_zero_offset', 'mirror_curvature'}):
        'Shift the position sensor by 1 mm and repeat one diagonal: an offset of the zero follows by 1 mm.',
    frozenset({'servo_settling', 'vibration'}):
        'Repeat one diagonal with a dwell three times as long: settling dies away, vibration does not.',
    frozenset({'backlash', 'servo_settling'}):
        'Repeat one diagonal with a dwell three times as long: settling dies away, backlash does not.',
    frozenset({'scale_thermal_expansion', 'air_refraction_drift'}):
        'Log the temperatures of the scales and of the air during one further diagonal.',
    frozenset({'beam_pointing_drift', 'mirror_mount_creep'}):
        'Repeat one diagonal without touching the mirror after half an hour: the mount has come to rest, '
        'the beam goes on turning.',
}
"""Pairs that one well-known trick separates, whatever the computation of further runs says."""

FOR_UNKNOWN = ('Repeat the diagonal with the largest share of the gap at once and again after half an hour: '
               'what stays belongs to the place, what changes belongs to time.')


def advise(joint: Joint, groups: Sequence[Sequence[str]], effects: dict[str, Effect],
           forms: dict[str, Form], unknown: bool) -> str | None:
    """The advice in words, or None where nothing is left to tell apart.

    ``groups``: names that cannot be told apart; ``forms``: the best form of each of them here.
    """
    for group in groups:
        named = [name for name in group if name in effects]
        for pair, text in SPECIAL.items():
            if pair <= set(named):
                return text
        if len(named) >= 2:
            best = max(_runs(joint, [(effects[n], forms[n]) for n in named if n in forms]),
                       key=lambda a: a.power, default=None)
            if best is not None and best.power > 0.0:
                return f'{best.text} It sets {" and ".join(named)} {best.power:.0f} σ apart.'
    return FOR_UNKNOWN if unknown or groups else None


def _runs(joint: Joint, candidates: Sequence[tuple[Effect, Form]]) -> list[Advice]:
    """Every computable further run with its power to tell the candidates apart."""
    if len(candidates) < 2:
        return []
    view, space = joint.observation.view, joint.parity
    result = []
    for setup, name in enumerate(view.setup_names):
        mine = view.setup == setup
        if not mine.any():
            continue
        label = f'diagonal {name}' if not name.startswith('lin') else f'linear run {name}'
        later = replace(view, time=np.where(mine, view.time + LATER_S, view.time),
                        mount_time=np.where(mine, view.mount_time + LATER_S, view.mount_time))
        turned = replace(view, model=view.model + np.where(
            mine[:, None], np.tensordot(np.array([TURNED_RAD, -TURNED_RAD]), view.by_mirror, axes=1),
            0.0))
        moved = replace(view, strike=view.strike + np.where(mine, DISPLACED_M * 10.0, 0.0)[:, None, None])
        back = replace(view, approach=np.where(mine[:, None], -view.approach, view.approach))
        for text, changed in (
                (f'Repeat the {label} half an hour later.', later),
                (f'Turn the mirror by 1 mrad about both axes and repeat the {label}.', turned),
                (f'Move the mirror sideways by 10 mm and repeat the {label}.', moved),
                (f'Repeat the {label}, coming to each stop from the other side.', back)):
            result.append(Advice(text, _power(space, view, changed, mine, candidates)))
    return result


def _power(space: Parity, view: StopView, changed: StopView, mine: np.ndarray,
           candidates: Sequence[tuple[Effect, Form]]) -> float:
    """Least distance [σ] between what the candidates foretell for the changed run, sizes fitted to this log."""
    forecasts = []
    for effect, form in candidates:
        columns = space.project(form)
        normal = columns.T @ columns + 1e-3 * np.eye(columns.shape[1])
        size = np.linalg.solve(normal, columns.T @ space.data)
        other = next((f for f in effect.appearance(changed) if f.label == form.label), None)
        if other is None or len(other.columns) != len(form.columns):
            continue
        full = np.tensordot(size * form.scale, np.where(mine[None, :, None], other.columns,
                                                        form.columns), axes=1)
        forecasts.append(space.stop_part(full[None])[:, 0])
    if len(forecasts) < 2:
        return 0.0
    return float(min(np.linalg.norm(a - b) for i, a in enumerate(forecasts)
                     for b in forecasts[i + 1:]))
