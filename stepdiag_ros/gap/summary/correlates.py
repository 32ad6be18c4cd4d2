"""What an unmodelled structure correlates with: place, time, distance, spot, light, signal, air and scales.

It names no cause and decides nothing.  A quantity is laid on a channel as a column and held against what the named
effects leave, in parity space: what the machine's own errors could imitate is no correlation.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from stepdiag_ros.effects.base import StopView
from stepdiag_ros.gap.inference.joint import Joint, unexplained
from stepdiag_ros.gap.preprocess.observe import channels

LEAST_SHARE = 0.3
"""Share of the structure from which a quantity is named."""
MOST = 3
SURE = 25.0
"""χ² of the quantity's one column that noise alone does not make: five standard deviations."""


@dataclass(frozen=True)
class Correlate:
    """A quantity that a ``channel`` correlates with, and the ``share`` of the structure's variance there that does."""

    quantity: str
    channel: str
    share: float

    def to_json_dict(self) -> dict:
        return {'with': self.quantity, 'channel': self.channel, 'share': self.share}


def correlates(joint: Joint) -> tuple[Correlate, ...]:
    """The quantities that go best with what the named effects leave of the stops, best first."""
    space, view = joint.parity, joint.observation.view
    left = unexplained(space, tuple(a for a in joint.active if a.effect.name))[:space.stops]
    found = []
    for channel, columns in channels(view.beams).items():
        mine = np.isin(space.channel[:space.stops], np.arange(view.beams + 2)[columns])
        structure = float(left[mine] @ left[mine]) - float(mine.sum()) * space.dof[0] / space.stops
        for name, value in _quantities(view):
            column = view.zeros(1)
            column[0, :, columns] = value[:, None]
            seen = space.stop_part(column)[:, 0]
            size = float(seen @ seen)
            taken = float(seen @ left) ** 2 / size if size > 0.0 else 0.0
            share = taken / max(structure, 1e-300)
            if taken > SURE and share >= LEAST_SHARE:
                found.append(Correlate(name, channel, min(share, 1.0)))
    return tuple(sorted(found, key=lambda c: -c.share)[:MOST])


def _quantities(view: StopView) -> Iterator[tuple[str, np.ndarray]]:
    """Quantities (n,) at the stops that are known everywhere and change, of size one."""
    reach = np.linalg.norm(view.spot_model, axis=1)
    distance = view.distance.mean(axis=1)
    known = {
        'the time': view.time, 'the time since the mounting': view.mount_time,
        'the time since the reset': view.run_time, 'the direction of the run': view.direction.astype(float),
        'the distance to the mirror': distance, 'the square of the distance to the mirror': distance**2,
        'the distance of the spot from the centre': reach, 'the cube of the distance of the spot': reach**3,
        'the light on the detector': view.intensity, 'the signal quality of the laser': view.quality,
        'the index of air that was taken out': view.divided_index}
    known |= {f'the position of {axis}': view.commanded[:, k] for k, axis in enumerate('XYZ')}
    if view.air_index is not None:
        known['the index of air by its sensors'] = view.air_index
    if view.scale_temperature is not None:
        known |= {f'the temperature of the scale of {axis}': view.scale_temperature[:, k]
                  for k, axis in enumerate('XYZ')}
    for name, value in known.items():
        value = np.asarray(value, float)
        spread = np.std(value) if np.isfinite(value).all() else 0.0
        if spread > 1e-9 * max(np.abs(value).max(initial=0.0), 1e-300):
            yield name, (value - value.mean()) / spread
