"""An uncertainty budget: named contributors, read from YAML and checked line by line.

    schema: 1
    contributors:
      - {name: wavelength, kind: scale, type: B, distribution: normal, value: 2.0e-8, unit: m/m}

``kind`` says how a contributor acts (:data:`KINDS`), ``unit`` must be the kind's own and is written so
that a reader sees it.  ``value`` is a standard uncertainty for ``normal`` and a half width for
``rectangular``, ``triangular`` and ``arcsine``; ``from log`` takes what the log itself says (type A:
repeats and scatter in the dwells).  ``dof`` are the degrees of freedom of ``value``, infinite if left out.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.guard import strict_yaml

SCHEMA = 1
FROM_LOG = 'from log'
KINDS: dict[str, tuple[str, str]] = {
    'position_repeatability': ('m', 'an axis errs at each arrival and stays so until it moves again'),
    'angle_repeatability': ('rad', "the mirror's attitude errs at each arrival"),
    'interferometer_noise': ('m', "one sample of the interferometer"),
    'psd_noise': ('m', 'one sample of the detector, along x and y'),
    'scale': ('m/m', 'all lengths of the interferometer alike: wavelength'),
    'air_temperature': ('K', 'index of air, through the temperature sensor'),
    'air_pressure': ('Pa', 'index of air, through the pressure sensor'),
    'humidity': ('1', 'index of air, through the humidity sensor (relative, 0 to 1)'),
    'index_formula': ('1', 'index of air, through the equation and the CO2 content'),
    'air_variation': ('1', 'change of the index within a run and from run to run, acting on the whole path'),
    'dead_path': ('1', 'change of the index within a run, acting on the path before the first stop'),
    'cyclic': ('m', 'swing of the interferometer with the fringe, anew at each stop'),
    'cosine': ('rad', 'beam against axis in the linear setups, about each of two axes'),
    'psd_gain': ('1', "scale of the detector, x and y apart"),
    'psd_zero': ('m', 'zero of the detector, x and y, anew in each setup'),
    'psd_rotation': ('rad', 'turn of the detector about the beam'),
    'mirror_flatness': ('m', 'form of the mirror where a beam strikes, the same in each run over a stop'),
    'mirror_slope': ('rad', 'slope of that form, which turns the beam of the detector'),
    'tool': ('m', "knowledge of the tool vector's three components"),
    'beam_offset': ('m', 'knowledge of where beams and detector lie beside the first beam, each setup'),
    'standoff': ('m', 'knowledge of the distance from base unit to mirror, each setup'),
    'scale_temperature': ('K', 'temperature of an axis to which positioning errors are referred'),
    'expansion_coefficient': ('1/K', "expansion coefficient, times the axes' distance from 20 °C"),
}
"""kind → unit of its value, what it does."""
MEASURED = ('position_repeatability', 'angle_repeatability', 'interferometer_noise', 'psd_noise')
"""Kinds that a log says something about itself."""
SPREAD = {'normal': 1.0, 'rectangular': 1 / math.sqrt(3.0), 'triangular': 1 / math.sqrt(6.0),
          'arcsine': 1 / math.sqrt(2.0)}
"""Standard deviation of each distribution per unit of ``value``."""
Complaint = Callable[[int, str, str], StepdiagError]
KEYS = ('name', 'kind', 'type', 'distribution', 'value', 'unit', 'dof', 'coefficient')


@dataclass(frozen=True)
class Contributor:
    """One line of a budget.  ``value`` None: from the log.  ``coefficient`` [1/K]: of scale_temperature."""

    name: str
    kind: str
    type: str
    distribution: str
    value: float | None
    dof: float = math.inf
    coefficient: float = 0.0

    @property
    def unit(self) -> str:
        return KINDS[self.kind][0]

    @property
    def standard(self) -> float | None:
        """Standard uncertainty in :attr:`unit`."""
        return None if self.value is None else self.value * SPREAD[self.distribution]

    def to_dict(self) -> dict[str, Any]:
        """The line as it is written in a budget."""
        line = {'name': self.name, 'kind': self.kind, 'type': self.type, 'distribution': self.distribution,
                'value': FROM_LOG if self.value is None else self.value, 'unit': self.unit}
        line |= {'dof': self.dof} if math.isfinite(self.dof) else {}
        return line | ({'coefficient': self.coefficient} if self.kind == 'scale_temperature' else {})

    def draw(self, rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
        """Variates of mean 0 and, for infinite ``dof``, of standard deviation 1.

        A normal with few degrees of freedom is drawn from Student's t (GUM Supplement 1, 6.4.9).  A
        cosine error follows from two normal angles: their summed squares, less the mean.
        """
        if self.kind == 'cosine':
            # (α² + β²)/2ε² of two normal angles is exponential with mean and deviation 1.
            return rng.exponential(1.0, shape) - 1.0
        if self.distribution == 'rectangular':
            return rng.uniform(-1.0, 1.0, shape) / SPREAD['rectangular']
        if self.distribution == 'triangular':
            return rng.triangular(-1.0, 0.0, 1.0, shape) / SPREAD['triangular']
        if self.distribution == 'arcsine':
            return np.sin(rng.uniform(-np.pi, np.pi, shape)) / SPREAD['arcsine']
        if math.isfinite(self.dof):
            # One estimated deviation stands behind all draws of a trial.
            chi = rng.chisquare(self.dof, (shape[0],) + (1,) * (len(shape) - 1)) / self.dof
            return rng.standard_normal(shape) / np.sqrt(chi)
        return rng.standard_normal(shape)


@dataclass(frozen=True)
class Budget:
    """All contributors, by their order in the file."""

    contributors: tuple[Contributor, ...]
    source: str = 'budget'

    @classmethod
    def from_yaml(cls, text: str, source: str = 'budget') -> 'Budget':
        """Parse and check; :class:`StepdiagError` names source, line and key."""
        node, data = strict_yaml.compose(text, source), strict_yaml.load(text, source)
        if not isinstance(data, dict) or data.get('schema') != SCHEMA:
            raise StepdiagError(f'{source}:1: schema is '
                                f'{data.get("schema") if isinstance(data, dict) else None!r}; '
                                f'a budget begins with "schema: {SCHEMA}"')
        places = {key.value: (key, value) for key, value in node.value}
        for name, (key, _) in places.items():
            if name not in ('schema', 'contributors'):
                raise StepdiagError(f'{source}:{key.start_mark.line + 1}: {name}: unknown key; '
                                    'known are schema, contributors')
        raw = data.get('contributors')
        if not isinstance(raw, list) or not raw:
            raise StepdiagError(f'{source}:1: contributors is missing or empty; list at least one')
        entries = places['contributors'][1].value

        def wrong(number: int, key: str, text: str) -> StepdiagError:
            entry = entries[number]
            lines = {k.value: k.start_mark.line + 1 for k, _ in entry.value} if isinstance(raw[number], dict) else {}
            return StepdiagError(f'{source}:{lines.get(key, entry.start_mark.line + 1)}: {key}: {text}')
        return cls.from_list(raw, wrong, source)

    @classmethod
    def from_list(cls, raw: list, wrong: 'Complaint', source: str = 'budget') -> 'Budget':
        """Check parsed lines; ``wrong(number of the line, key, text)`` makes the error to raise."""
        found: list[Contributor] = []
        for number, body in enumerate(raw):
            contributor = _contributor(body, partial(wrong, number))
            if contributor.name in [c.name for c in found]:
                raise wrong(number, 'name',
                            f'{contributor.name!r} comes twice; give each contributor a name of its own')
            found.append(contributor)
        return cls(tuple(found), source)

    def to_list(self) -> list[dict[str, Any]]:
        """The lines as :meth:`from_list` reads them."""
        return [c.to_dict() for c in self.contributors]

    def over(self, standard: 'Budget') -> 'Budget':
        """This budget where it names a kind, ``standard`` for the kinds that it leaves out."""
        own = {c.kind for c in self.contributors}
        return Budget((*self.contributors, *(c for c in standard.contributors if c.kind not in own)), self.source)


def _contributor(body: Any, wrong: Callable[[str, str], StepdiagError]) -> Contributor:
    if not isinstance(body, dict):
        raise wrong('contributors', 'each entry is a mapping with name, kind, type, distribution, value, unit')
    for key in body:
        if key not in KEYS:
            raise wrong(str(key), f'unknown key; known are {", ".join(KEYS)}')
    kind = body.get('kind')
    if not isinstance(kind, str) or kind not in KINDS:
        raise wrong('kind', f'{kind!r} is not known; choose from {", ".join(KINDS)}')
    name = str(body.get('name') or kind)
    if body.get('type') not in ('A', 'B'):
        raise wrong('type', f'{body.get("type")!r}; write A (statistics) or B (other knowledge)')
    distribution = body.get('distribution', 'normal')
    if not isinstance(distribution, str) or distribution not in SPREAD:
        raise wrong('distribution', f'{distribution!r} is not known; choose from {", ".join(SPREAD)}')
    if kind == 'cosine' and distribution != 'normal':
        raise wrong('distribution', 'a cosine error follows from two normal angles; write normal')
    if str(body.get('unit')) != KINDS[kind][0]:
        raise wrong('unit', f'{body.get("unit")!r}; {kind} is given in {KINDS[kind][0]}')
    value = body.get('value')
    if value == FROM_LOG:
        if kind not in MEASURED:
            raise wrong('value', f'a log does not say {kind}; give a number')
        if body['type'] != 'A' or distribution != 'normal':
            raise wrong('value', 'what comes from the log is type A and normal')
        number = None
    else:
        number = _number(value, wrong, 'value', f'; give a number in {KINDS[kind][0]}'
                         + (f' or "{FROM_LOG}"' if kind in MEASURED else ''))
    dof = math.inf
    if 'dof' in body:
        dof = _number(body['dof'], wrong, 'dof', '; give a number above 2 or .inf', infinite=True)
        if dof <= 2.0:
            raise wrong('dof', f'{dof:g}; below 3 Student\'s t has no standard deviation, give more')
        if distribution != 'normal':
            raise wrong('dof', f'only for normal; a {distribution} width is taken as exact')
    if kind == 'scale_temperature' and 'coefficient' not in body:
        raise wrong('coefficient', 'missing; give the expansion coefficient [1/K], e.g. 1.15e-5')
    coefficient = _number(body.get('coefficient', 0.0), wrong, 'coefficient', '; give a number in 1/K')
    return Contributor(name, kind, body['type'], distribution, number, dof, coefficient)


def _number(value: Any, wrong, key: str, advice: str, infinite: bool = False) -> float:
    try:
        number = math.nan if isinstance(value, bool) else float(value)
    except (TypeError, ValueError):
        number = math.nan
    if math.isnan(number) or number < 0.0 or (math.isinf(number) and not infinite):
        raise wrong(key, f'{value!r}{advice}')
    return number
