"""What a cell file states only by its size: error curves and misalignments, drawn from the seed.

A curve is a slope and a few sine waves, zero at position 0 and scaled to the stated
size (largest absolute value).  Straight between the plan's positions, as the
estimator's model is, unless ``knots`` asks for finer ones.
"""

from typing import TYPE_CHECKING

import numpy as np

from stepdiag_ros.guard import limits
from stepdiag_ros.model.description import Description
from stepdiag_ros.model.machine import AXES, CURVES, SQUARENESS, Curve, GeometricErrors
from stepdiag_ros.model.sensor import Misalignment
from stepdiag_ros.virtual.draw import normals, uniforms

if TYPE_CHECKING:
    from stepdiag_ros.virtual.yamlreader import Reader

SIZES = {'positioning': 8.0e-6, 'straightness': 4.0e-6, 'angle': 2.0e-5, 'squareness': 1.5e-5}
"""Sizes [m, m, rad, rad] when a cell says ``drawn`` without numbers."""
MOST = {**dict.fromkeys(('positioning', 'straightness', 'psd_zero', 'station'), limits.LENGTH_M),
        **dict.fromkeys(('angle', 'squareness', 'laser', 'mirror'), limits.ANGLE_RAD)}
WAVES = 3


def geometry(node: 'Reader | None', seed: int, description: Description) -> GeometricErrors:
    """Error curves from the cell's ``geometry``: ``drawn``, or ``curves`` and ``squareness`` given.

    Given ones replace drawn ones; without the key every curve is drawn at the usual size.
    """
    keys = node.mapping(('drawn', 'curves', 'squareness', 'seed', 'knots')) \
        if node is not None and not node.is_null else {}
    own_seed = keys['seed'].count() if 'seed' in keys else seed
    sizes = dict.fromkeys(SIZES, 0.0) if 'curves' in keys or 'squareness' in keys else dict(SIZES)
    if 'drawn' in keys:
        sizes = dict(SIZES)
        if not keys['drawn'].is_null:
            sizes |= {key: child.number(minimum=0.0, maximum=MOST[key])
                      for key, child in keys['drawn'].mapping(tuple(SIZES)).items()}
    per_step = keys['knots'].count(1) if 'knots' in keys else 1
    curves, square = {}, {}
    for name in CURVES:
        axis = AXES.index(name[2])
        size = sizes['angle'] if name[1] in 'ABC' else \
            sizes['positioning'] if name[1] == name[2] else sizes['straightness']
        knots = np.linspace(0.0, description.machine.volume[axis],
                            per_step * description.plan.steps + 1)
        if size > 0.0:
            curves[name] = Curve(knots, _shape(own_seed, name, knots / knots[-1]) * size)
    for name in SQUARENESS:
        if sizes['squareness'] > 0.0:
            square[name] = sizes['squareness'] * float(normals(own_seed, f'square/{name}', 0, 1)[0, 0])
    if 'curves' in keys:
        for name, child in keys['curves'].mapping(CURVES).items():
            curves[name] = _given(child, 'rad' if name[1] in 'ABC' else 'm')
    if 'squareness' in keys:
        square |= {name: child.number(unit='rad')
                   for name, child in keys['squareness'].mapping(SQUARENESS).items()}
    return GeometricErrors(curves, square)


def _given(node: 'Reader', unit: str) -> Curve:
    keys = node.mapping(('position', 'value'))
    for needed in ('position', 'value'):
        if needed not in keys:
            raise node.fail(f'the key {needed!r} is missing; a curve has position and value')
    position = np.array([item.number(unit='m') for item in keys['position'].items()])
    value = np.array([item.number(unit=unit) for item in keys['value'].items()])
    if len(position) != len(value) or len(position) < 1:
        raise keys['value'].fail(f'has {len(value)} numbers and position has {len(position)}; '
                                 'give one value for each position')
    if np.any(np.diff(position) <= 0.0):
        raise keys['position'].fail('must rise')
    return Curve(position, value)


def _shape(seed: int, name: str, place: np.ndarray) -> np.ndarray:
    """A random smooth curve over ``place`` (k,) in 0…1: zero at 0, of size 1."""
    numbers = normals(seed, f'curve/{name}', 0, 1, 2 + 2 * WAVES)[0]
    value = numbers[0] * place
    for wave in range(WAVES):
        amplitude, phase = numbers[2 + 2 * wave], numbers[3 + 2 * wave]
        angle = np.pi * (wave + 1) * place + phase * np.pi
        value = value + 0.5 * amplitude / (wave + 1) * (np.sin(angle) - np.sin(phase * np.pi))
    largest = np.max(np.abs(value))
    return value / largest * float(0.5 + 0.5 * uniforms(seed, f'size/{name}', 0, 1)[0, 0])


def misalignments(node: 'Reader | None', seed: int, setups: tuple[str, ...]
                  ) -> tuple[dict[str, Misalignment], dict[str, tuple[float, float]]]:
    """Laser and mirror misalignments [rad], how far stations stand elsewhere [m] and PSD zero [m], by setup."""
    keys = node.mapping(('drawn', 'given', 'seed')) if node is not None and not node.is_null else {}
    own_seed = keys['seed'].count() if 'seed' in keys else seed
    sizes = {'laser': 0.0, 'mirror': 0.0, 'psd_zero': 0.0, 'station': 0.0}
    if 'drawn' in keys:
        sizes |= {key: child.number(minimum=0.0, maximum=MOST[key])
                  for key, child in keys['drawn'].mapping(tuple(sizes)).items()}
    given = keys['given'].mapping(setups) if 'given' in keys else {}
    turns, zeros = {}, {}
    for name in setups:
        values = {kind: tuple(size * normals(own_seed, f'misalignment/{kind}/{name}', 0, 1, _parts(kind))[0])
                  for kind, size in sizes.items()}
        if name in given:
            values |= {kind: child.vector(_parts(kind), unit='rad' if kind in ('laser', 'mirror') else 'm')
                       for kind, child in given[name].mapping(tuple(sizes)).items()}
        own = {kind: tuple(float(part) for part in value) for kind, value in values.items()}
        turns[name] = Misalignment(own['laser'], own['mirror'], own['station'])
        zeros[name] = own['psd_zero']
    return turns, zeros


def _parts(kind: str) -> int:
    return 3 if kind == 'station' else 2
