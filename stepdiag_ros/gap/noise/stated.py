"""The noise of a log in words: its laws, its steps, and where it is not what the log's description says."""

from collections.abc import Iterator

import numpy as np

from stepdiag_ros.estimate.noise import Law, NoiseModel
from stepdiag_ros.gap.constants import NOISIER
from stepdiag_ros.gap.inference.joint import Joint
from stepdiag_ros.gap.noise.far_arrivals import FarArrivals

FAR = 3.0
"""Times the noise that the description states from which it is spoken of: a maker's guess is good to two."""
ALIKE = 1.3
"""Times the noise of white samples from which what the samples add inside the dwells is spoken of."""


def rms(size: float, law: Law) -> float:
    """Standard deviation of errors whose ``size`` is the scale of their law."""
    return size * float(np.sqrt(law.dof / (law.dof - 2.0))) if np.isfinite(law.dof) else size


def law_of(noise: NoiseModel) -> dict:
    """The noise of arrivals as ``gap.json`` has it; ``dof`` None: normal."""
    return {name: {'dof': law.dof if np.isfinite(law.dof) else None, 'correlation': law.correlation}
            for name, law in (('position', noise.position_law), ('angle', noise.angle_law))}


def stated(joint: Joint, far: FarArrivals, steps: np.ndarray) -> tuple[str, ...]:
    """What there is to say of the noise, and of arrivals that are ``far`` off; ``steps`` (c,) [m] in which readings
    move, 0: in none."""
    return (*_laws(joint.noise), *far.alone(), *_inside(joint), *_steps(steps),
            *(words for times, words in _beyond_description(joint) if times > FAR))


def noisier(joint: Joint) -> str:
    """What is so much noisier than the description says that it is a finding, in words; '' where nothing is."""
    times, words = max(_beyond_description(joint), default=(0.0, ''))
    return words if times > NOISIER else ''


def _laws(noise: NoiseModel) -> Iterator[str]:
    for what, law in (("an axis's error at each arrival", noise.position_law),
                      ("the mirror's angle at each arrival", noise.angle_law)):
        if np.isfinite(law.dof):
            yield (f"noise: {what} has heavy tails (Student's t with about {law.dof:.2g} degrees of freedom); it is "
                   'weighed as such')
        if law.correlation:
            yield f'noise: {what} correlates with the one before (correlation about {law.correlation:.2g})'


def _channels(beams: int) -> list[str]:
    """The readings' names: which beam where there are several."""
    lengths = ['displacement'] if beams == 1 else [f'displacement of beam {k}' for k in range(beams)]
    return [*lengths, 'spot x', 'spot y']


def _inside(joint: Joint) -> Iterator[str]:
    for name, factor in zip(_channels(joint.fit.model.beams), joint.parity.bin_scale, strict=True):
        if factor > ALIKE:
            yield (f'noise: {name}: means over parts of a dwell scatter {factor:.2g} times as much as independent '
                   'samples would make them')


def _steps(steps: np.ndarray) -> Iterator[str]:
    for name, width in zip(_channels(len(steps) - 2), steps, strict=True):
        if width:
            yield f'noise: {name}: readings move in steps of {width * 1e6:.3g} µm'


def _beyond_description(joint: Joint) -> Iterator[tuple[float, str]]:
    """Times by which the noise seen exceeds the one that the description states, in words too."""
    log, table, noise = joint.observation.log, joint.observation.table, joint.noise
    said = log.description.noise
    pairs = [("an axis's error at each arrival", rms(noise.position, noise.position_law),
              said.position_repeatability, noise.dof[0], 'm'),
             ("the mirror's angle at each arrival", rms(noise.angle, noise.angle_law),
              said.angle_repeatability, noise.dof[1], 'rad'),
             ('a sample of the displacement', _median(table.displacement_scatter), said.displacement, len(table), 'm'),
             ('a sample of the spot', _median(table.spot_scatter), said.spot, len(table), 'm')]
    for what, seen, stated_, dof, unit in pairs:
        if dof and stated_ > 0.0:
            yield seen / stated_, (f'the log is noisier than its description: {what} scatters by {seen:.2g} {unit}, '
                                   f'{seen / stated_:.2g} times the {stated_:.2g} {unit} stated')


def _median(scatter: np.ndarray) -> float:
    scatter = scatter[np.isfinite(scatter)]
    return float(np.median(scatter)) if len(scatter) else 0.0
