"""What every estimator returns: values, covariance, status, and what it could not see."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from stepdiag_ros.estimate.closure import Closure
from stepdiag_ros.estimate.finding import Finding
from stepdiag_ros.estimate.traceability import Traceability
from stepdiag_ros.model.machine import CURVES, SQUARENESS, Curve, GeometricErrors
from stepdiag_ros.model.sensor import Misalignment

if TYPE_CHECKING:
    from stepdiag_ros.estimate.contributions import Contribution


@dataclass(frozen=True)
class Unidentifiable:
    """A direction the data say nothing about: the names that trade against each other, and why."""

    names: tuple[str, ...]
    why: str


@dataclass(frozen=True)
class Residuals:
    """What the fit leaves at each stop visited, one row a stop of a run.

    ``run``, ``setup``, ``repeat``, ``direction``, ``index``, ``axis``, ``time_s`` (n,) identify the
    visit (``time_s`` from the log's first event); ``displacement_m`` (n, beams), ``spot_m`` (n, 2),
    NaN where a reading is missing.
    """

    run: np.ndarray
    setup: np.ndarray
    repeat: np.ndarray
    direction: np.ndarray
    index: np.ndarray
    axis: np.ndarray
    time_s: np.ndarray
    displacement_m: np.ndarray
    spot_m: np.ndarray


@dataclass(frozen=True)
class Solution:
    """The estimate of a machine's errors by one method.

    ``positions`` maps a curve's name to its positions (k,) [m].  ``names`` orders the
    parameters: ``('EXX', i)`` for the curve's value at its i-th position, ``('EC0Y', -1)`` for a
    squareness error; ``value`` (p,) [m or rad] and ``covariance`` (p, p) follow it.  Curves are
    zero at position 0 with zero variance.  Straightness and squareness refer to the reference
    lines of ISO 230-1 (:mod:`stepdiag_ros.estimate.gauge`).  A method that cannot give an error
    leaves its name out.  ``sanity``: mistakes of commissioning that the log shows
    (:mod:`stepdiag_ros.estimate.sanity`).  ``misalignment_sigma``: standard uncertainties of ``misalignments`` by the
    whole budget, for the setups whose angles are found; a line along one axis shows the difference of mirror and beam
    at most, and has none.  ``closure``: how each cycle came back to its first stop.
    ``parts``: what each kind of setup contributed (:mod:`stepdiag_ros.estimate.contributions`).

    ``covariance`` is that of the whole budget where ``traceability`` is set, else of the repeats alone;
    ``repeatability`` (p, p) then keeps what the repeats, or the noise that the cell declares, give alone.
    """

    method: str
    positions: Mapping[str, np.ndarray]
    names: tuple[tuple[str, int], ...]
    value: np.ndarray
    covariance: np.ndarray
    status: str = 'ok'
    reduced_chi2: float | None = None
    dof: int | None = None
    unidentifiable: tuple[Unidentifiable, ...] = ()
    gauge: str = ''
    misalignments: Mapping[str, Misalignment] = field(default_factory=dict)
    misalignment_sigma: Mapping[str, Misalignment] = field(default_factory=dict)
    noise: Mapping[str, float] = field(default_factory=dict)
    residuals: Residuals | None = None
    warnings: tuple[str, ...] = ()
    extra: Mapping[str, Any] = field(default_factory=dict)
    repeatability: np.ndarray | None = None
    traceability: Traceability | None = None
    sanity: tuple[Finding, ...] = ()
    closure: tuple[Closure, ...] = ()
    parts: tuple['Contribution', ...] = ()

    @property
    def sigma(self) -> np.ndarray:
        """One standard uncertainty of every parameter (p,)."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    @property
    def sigma_repeatability(self) -> np.ndarray:
        """What repeats alone give of :attr:`sigma` (p,)."""
        covariance = self.covariance if self.repeatability is None else self.repeatability
        return np.sqrt(np.maximum(np.diag(covariance), 0.0))

    @property
    def traceable(self) -> bool:
        """Whether the lengths are metres: somebody took the index of air into account."""
        return self.traceability is not None and self.traceability.traceable

    def curve_repeatability(self, name: str) -> np.ndarray:
        """:attr:`sigma_repeatability` of a curve (k,)."""
        return self.sigma_repeatability[[i for i, (n, _) in enumerate(self.names) if n == name]]

    def curve(self, name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Positions, values and standard deviations of a curve, each (k,)."""
        rows = [i for i, (n, _) in enumerate(self.names) if n == name]
        return np.asarray(self.positions[name]), self.value[rows], self.sigma[rows]

    def squareness(self, name: str) -> tuple[float, float]:
        """Value and standard deviation [rad] of ``EC0Y``, ``EB0Z`` or ``EA0Z``."""
        row = self.names.index((name, -1))
        return float(self.value[row]), float(self.sigma[row])

    def has(self, name: str) -> bool:
        return any(n == name for n, _ in self.names)

    @property
    def errors(self) -> GeometricErrors:
        """The estimate as a machine that can be simulated or predicted with."""
        curves = {}
        for name in CURVES:
            if self.has(name):
                position, value, _ = self.curve(name)
                curves[name] = Curve(position, value)
        return GeometricErrors(curves, {n: self.squareness(n)[0] for n in SQUARENESS if self.has(n)})

    def _misaligned(self, setup: str) -> dict[str, Any]:
        """The angles of a setup with their standard uncertainties; nulls where the log does not find them."""
        angles, sigma = self.misalignments[setup], self.misalignment_sigma.get(setup)
        if self.misalignment_sigma and sigma is None:
            return {'found': False, **dict.fromkeys(('laser_rad', 'mirror_rad', 'laser_sigma_rad', 'mirror_sigma_rad'))}
        known = {} if sigma is None else {'laser_sigma_rad': list(sigma.laser), 'mirror_sigma_rad': list(sigma.mirror)}
        return {'found': True, 'laser_rad': list(angles.laser), 'mirror_rad': list(angles.mirror), **known}

    def to_json_dict(self) -> dict[str, Any]:
        """The contract's answer of ``stepdiag evaluate --json``."""
        errors: dict[str, Any] = {}
        for name in CURVES:
            if self.has(name):
                position, value, sigma = self.curve(name)
                errors[name] = {'position_m': _list(position), 'value': _list(value), 'sigma': _list(sigma),
                                'sigma_repeatability': _list(self.curve_repeatability(name))}
        for name in SQUARENESS:
            if self.has(name):
                value, sigma = self.squareness(name)
                errors[name] = {'value': value, 'sigma': sigma,
                                'sigma_repeatability': float(self.sigma_repeatability[self.names.index((name, -1))])}
        tied = self.traceability
        return {'method': self.method, 'status': self.status, 'errors': errors,
                'unidentifiable': [{'names': list(u.names), 'why': u.why}
                                   for u in self.unidentifiable],
                'reference_temperature': None if tied is None else tied.reference_temperature,
                'traceability': None if tied is None else tied.to_json_dict(),
                'gauge': self.gauge, 'reduced_chi2': self.reduced_chi2, 'dof': self.dof,
                'misalignments': {name: self._misaligned(name) for name in self.misalignments
                                  if name not in self.extra.get('stations', {})},
                'noise': dict(self.noise), 'warnings': list(self.warnings),
                'sanity': [finding.to_json_dict() for finding in self.sanity],
                'closure': [one.to_json_dict() for one in self.closure],
                'parts': [part.to_json_dict() for part in self.parts], **self.extra}


def _list(values: np.ndarray) -> list[float]:
    return [float(v) for v in values]
