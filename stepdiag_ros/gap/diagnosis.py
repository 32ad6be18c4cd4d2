"""What a diagnosis is: everything that a report needs."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from stepdiag_ros.estimate.conditions import NO_AIR
from stepdiag_ros.estimate.evaluate import solution_of
from stepdiag_ros.estimate.solution import Solution
from stepdiag_ros.gap.experiment_design.next_run import NextRun
from stepdiag_ros.gap.inference.averaged import averaged_solution
from stepdiag_ros.gap.inference.candidates import Screen
from stepdiag_ros.gap.inference.joint import Joint
from stepdiag_ros.gap.inference.search import EffectSet
from stepdiag_ros.gap.noise.incoherent_lines import Vibration
from stepdiag_ros.gap.noise.slips_at_rest import SlipAtRest
from stepdiag_ros.gap.noise.stated import law_of
from stepdiag_ros.gap.preprocess.observe import Observation
from stepdiag_ros.gap.preprocess.timing import Timing
from stepdiag_ros.gap.summary.bands import Band, bands
from stepdiag_ros.gap.summary.correlates import Correlate, correlates
from stepdiag_ros.gap.summary.cross_validation import CrossValidation, cross_validated_by_setup
from stepdiag_ros.gap.summary.explain import Weighed, weighed
from stepdiag_ros.gap.summary.hint import Hint
from stepdiag_ros.gap.summary.margins import Margins, margins
from stepdiag_ros.gap.summary.volume import VolumeChange, volume_change
from stepdiag_ros.gap.summary.where import Share
from stepdiag_ros.model.log import CalibrationLog
from stepdiag_ros.model.machine import AXES

AXIS_LIKE = 3
"""Names of sizes shorter than this are of an axis or a direction: X, y, u."""
ALONG = tuple(f'E{axis}{axis}' for axis in AXES)
STAMPS = 'clock_skew'
"""The effect that is seen while axes move, and only then."""
COUNTS = 'count_slip'
"""The effect that is seen within a dwell too, to nanometres."""


@dataclass(frozen=True)
class Found:
    """An effect of the diagnosis: name, probability, parameters with σ by name; ``closes``: by how much of the whole
    gap's variance above the floor it alone is missed."""

    name: str
    title: str
    probability: float
    parameters: Mapping[str, float]
    sigma: Mapping[str, float]
    units: str
    form: str
    closes: float
    remedy: str


@dataclass(frozen=True)
class Diagnosis:
    """Everything that a report needs.

    ``verdict`` as in the contract; ``effects`` what the diagnosis would add to the simulator; ``ranking``
    probabilities of all effects, ``unknown`` and ``nothing``; ``sets`` the sets thought of with their probabilities,
    of ``causes`` possible ones; ``separation`` the log evidence by which what may stand for the likeliest falls
    behind; ``untold``: that the lengths are no metres, in words, '' where somebody took the index of air into account;
    ``slips`` of the counter while the axes stood, which ``effects`` have.
    """

    log: CalibrationLog
    verdict: str
    cross_validation: CrossValidation
    shares: tuple[Share, ...]
    effects: tuple[Found, ...]
    ranking: Mapping[str, float]
    sets: tuple[tuple[tuple[str, ...], float], ...]
    indistinguishable: tuple[tuple[str, ...], ...]
    nominal: Observation
    joint: Joint
    clocks: Mapping[str, Timing | None]
    shaking: Vibration | None
    unmodelled: str
    warnings: tuple[str, ...]
    raw: list[EffectSet]
    screen: Screen
    next_measurement: str | None = None
    next_run: NextRun | None = None
    separation: Mapping[str, float] = field(default_factory=dict)
    hint: Hint | None = None
    causes: int = 20
    untold: str = ''
    slips: tuple[SlipAtRest, ...] = ()

    def to_json_dict(self) -> dict:
        """``gap.json`` of the contract, and more beside it."""
        return {
            'verdict': self.verdict,
            'gap': self.cross_validation.to_json_dict(),
            'over_setups': self.over_setups.to_json_dict() if self.over_setups else None,
            'where': [share.to_json_dict() for share in self.shares],
            'shares': self.margins.to_json_dict() if self.margins else None,
            'bands': [band.to_json_dict() for band in self.bands],
            'effects': [{'name': f.name, 'probability': f.probability, 'parameters': dict(f.parameters),
                         'sigma': dict(f.sigma), 'units': f.units, 'form': f.form, 'closes': f.closes,
                         'what': f.title, 'remedy': f.remedy} for f in self.effects],
            'indistinguishable': [list(group) for group in self.indistinguishable],
            'separation': dict(self.separation),
            'hint': self.hint.to_json_dict() if self.hint else None,
            'next_measurement': self.next_measurement,
            'next_run': self.next_run.to_json_dict() if self.next_run else None,
            'unknown': self.unmodelled or None,
            'correlates': [one.to_json_dict() for one in self.correlates],
            'ranking': dict(sorted(self.ranking.items(), key=lambda item: -item[1])),
            'sets': [{'names': list(names), 'probability': p} for names, p in self.sets],
            'weighed': [row.to_json_dict() for row in self.weighed],
            'volumetric_change': self.volume_change.to_json_dict() if self.volume_change else None,
            'traceable': not self.untold,
            'errors': self.shown(self.solution).to_json_dict()['errors'],
            'errors_before': self.shown(self.plain).to_json_dict()['errors'] if self.joint.active else None,
            'noise': {'position_repeatability_m': self.joint.noise.position,
                      'angle_repeatability_rad': self.joint.noise.angle,
                      'law': law_of(self.joint.noise), 'source': self.joint.noise.source},
            'warnings': list(self.warnings)}

    @cached_property
    def weighed(self) -> tuple[Weighed, ...]:
        """The sets of effects that were weighed, with their evidence and why one may not be claimed."""
        return weighed(self.raw, self.causes, self.screen)

    @property
    def only_stamps(self) -> bool:
        """Whether nothing is wrong but stamps: at rest that changes nothing."""
        return [found.name for found in self.effects] == [STAMPS] and not self.unmodelled

    @cached_property
    def margins(self) -> Margins | None:
        """How the gap shares out; None where there is none, or none that has a place."""
        if self.verdict == 'no_gap':
            return None
        stamps = sum((found.parameters[name] / found.sigma[name]) ** 2
                     for found in self.effects if found.name == STAMPS for name in found.sigma)
        return margins(self.joint, bool(self.unmodelled), stamps, standing=not self.only_stamps)

    @cached_property
    def bands(self) -> tuple[Band, ...]:
        """What stands out of the noise, by channel and frequency, before and after the effects."""
        return bands(self.joint)

    @cached_property
    def over_setups(self) -> CrossValidation | None:
        """How far the gap closes where each setup is predicted from the others; None of a log of one setup."""
        return cross_validated_by_setup(self.joint)

    @cached_property
    def correlates(self) -> tuple[Correlate, ...]:
        """What an unmodelled structure correlates with; none where there is no such."""
        return correlates(self.joint) if self.unmodelled else ()

    @cached_property
    def volume_change(self) -> VolumeChange | None:
        """What taking the causes out changes of the volumetric error; None where there are none."""
        if not self.joint.active:
            return None
        return volume_change(self.plain, self.solution, self.log.description.machine)

    def shown(self, solution: Solution) -> Solution:
        """``solution`` as it may be shown: where nobody tells the index of air, all lengths are uncertain alike."""
        if not self.untold:
            return solution
        longer = np.array([NO_AIR * solution.positions[name][knot] if name in ALONG else 0.0
                           for name, knot in solution.names])
        return replace(solution, covariance=solution.covariance + np.outer(longer, longer))

    @cached_property
    def plain(self) -> Solution:
        """The 21 errors as an evaluation gives them that knows of no effect."""
        return solution_of(self.nominal.fit, self.nominal.table)

    @cached_property
    def solution(self) -> Solution:
        """The 21 errors with the effects taken out, their uncertainty included."""
        return averaged_solution(self.joint, self.screen, self.raw[0])
