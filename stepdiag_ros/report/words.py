"""How numbers and causes are put to someone who knows machines but not this program."""

import re

import numpy as np

from stepdiag_ros.effects import short_title
from stepdiag_ros.model.description import LINEAR, Setup, path_of

WITHOUT_EFFECT = {'unknown': 'Something that is not in the list', 'nothing': 'Nothing wrong'}
SHORT_CHANNELS = {'displacement': 'length', 'spot_x': 'spot x', 'spot_y': 'spot y'}
CHANNEL_NAMES = tuple(SHORT_CHANNELS.values())
K = 2.0
"""Coverage factor of the bands in pictures."""

SCALES = {'m': ((1e-7, 1e-9, 'nm'), (1e-3, 1e-6, 'µm'), (1.0, 1e-3, 'mm'), (np.inf, 1.0, 'm')),
          'rad': ((1e-3, 1e-6, 'µrad'), (np.inf, 1e-3, 'mrad')),
          '1': ((1e-3, 1e-6, 'ppm'), (0.5, 1e-2, '%'), (np.inf, 1.0, '')),
          's': ((0.5, 1e-3, 'ms'), (600.0, 1.0, 's'), (np.inf, 60.0, 'min')),
          '1/K': ((np.inf, 1e-6, 'ppm/K'),)}
"""Unit → (below this value, divide by, say)."""


def title(name: str) -> str:
    """An effect's name for people."""
    return WITHOUT_EFFECT.get(name) or short_title(name)


def scale(unit: str, size: float) -> tuple[float, str]:
    """Divisor and unit in which a number of this size reads well."""
    for below, divisor, said in SCALES.get(unit, ((np.inf, 1.0, unit),)):
        if size < below:
            return divisor, said
    raise ValueError(f'{size} {unit}: not a size')


def quantity(value: float, unit: str, sigma: float | None = None) -> str:
    """``5.71 ± 0.12 µm``: two digits of the uncertainty, three of a value without one."""
    size = max(abs(value), sigma or 0.0)
    if not np.isfinite(size):
        return 'not known'
    divisor, said = scale(unit, size)
    value = value / divisor
    if sigma is None or sigma <= 0.0:
        text = plain(value)
    else:
        sigma = sigma / divisor
        digits = max(0, 1 - int(np.floor(np.log10(sigma))))
        text = f'{value:.{digits}f} ± {sigma:.{digits}f}' if digits <= 6 else f'{value:.4g} ± {sigma:.1g}'
    return f'{text} {said}'.strip().replace('-', '−')


def plain(value: float) -> str:
    """Three significant digits without an exponent where that reads well."""
    if value == 0.0:
        return '0'
    if 1e-3 <= abs(value) < 1e5:
        digits = max(0, 2 - int(np.floor(np.log10(abs(value)))))
        return f'{value:.{digits}f}'
    return f'{value:.3g}'


def micrometres(value_m: float) -> str:
    """A gap: always in µm, three digits."""
    return f'{plain(value_m * 1e6)} µm'


def percent(share: float) -> str:
    """A probability or share; never 100 % or 0 % by rounding."""
    if share > 0.999:
        return '> 99.9 %'
    if share > 0.99:
        return f'{100 * share:.1f} %'
    if share < 0.001:
        return '< 0.1 %'
    return f'{100 * share:.0f} %' if share >= 0.1 else f'{100 * share:.1f} %'


def closed_percent(share: float) -> str:
    """How much of a gap is gone."""
    return f'{100 * min(max(share, 0.0), 1.0):.0f} %'


def certainty(probability: float) -> str:
    """A probability in a word."""
    for least, word in ((0.99, 'practically certain'), (0.9, 'very likely'), (0.6, 'likely')):
        if probability >= least:
            return word
    return 'possible'


def parameter_unit(name: str, units: str) -> str:
    """Unit of one parameter: from its name where it says so, else the form's."""
    bare = re.sub(r' \(\d+\)$', '', name)
    for suffix, unit in (('_Hz', 'Hz'), ('_rad', 'rad'), ('_s', 's'), ('_m', 'm')):
        if bare.endswith(suffix):
            return unit
    choices = [u.strip() for u in units.split(',')]
    if len(choices) > 1 and any(word in bare for word in ('shift', 'dead path')):
        return choices[-1]
    return choices[0]


def parameter_name(name: str) -> str:
    """A parameter's name without the unit at its end."""
    bare, tail = re.match(r'(.*?)( \(\d+\))?$', name).groups()
    for suffix in ('_Hz', '_rad', '_s', '_m'):
        if bare.endswith(suffix):
            bare = bare[:-len(suffix)]
            break
    bare = {'tau': 'time constant', 'period': 'period', 'wavelength': 'wavelength', 'start': 'start',
            'both': 'x and y alike', 'all': 'all axes'}.get(bare, bare).replace('_', ' ')
    return bare + (tail or '')


def setup_words(setup: Setup | str) -> str:
    """Where a setup runs, for someone who does not know the signs; a short name needs no more than the name."""
    name = setup if isinstance(setup, str) else setup.name
    path, ends = path_of(name), {'p': 'to +', 'n': 'to −'}
    again = '' if path == name else ', mounted once more'
    if isinstance(setup, Setup) and setup.way is not None:
        points = ' to '.join('(' + ', '.join(f'{1e3 * v:g}' for v in p) + ')' for p in (setup.way.start, setup.way.end))
        if setup.station is not None:
            place = ', '.join(f'{1e3 * v:g}' for v in setup.station)
            return f'{setup.way.moves} from {points} mm, followed from a station at about ({place}) mm{again}'
        kind = f'line along {"XYZ"[setup.axes[0]]}' if setup.is_line else setup.kind
        moves = '' if setup.is_line else ', axes together' if setup.is_straight else f', moves {setup.way.moves}'
        return f'{kind} from {points} mm{moves}{again}'
    if path in LINEAR:
        return f'line along {path[-1].upper()}{again}'
    return 'diagonal ' + ' '.join(f'{ends[sign]}{axis}' for sign, axis in zip(path, 'XYZ', strict=True)) + again
