"""Disturbances without a pattern, found in the samples: coarse readings, vibration and turbulence, mode hops.

What they do to the stops is noise, of another kind than the sensors' own; weighed as such, no effect is fitted to it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from stepdiag_ros.gap.inference.joint import refitted
from stepdiag_ros.gap.noise.dwell_spectrum import DwellSpectrum, dwell_spectrum, dwells_by_channel
from stepdiag_ros.gap.noise.knocks import Knocks, knocks
from stepdiag_ros.gap.noise.mode_hops import ModeHops, mode_hops
from stepdiag_ros.gap.noise.slips_at_rest import SlipAtRest, slips_at_rest, without
from stepdiag_ros.gap.preprocess.observe import Observation, sane_fit
from stepdiag_ros.gap.preprocess.timing import step_noise
from stepdiag_ros.model.log import CalibrationLog


@dataclass(frozen=True)
class Disturbances:
    """``quanta`` (c,) [m] of the steps in which readings move, 0: none; ``dwell_spectrum`` of the samples inside the
    dwells; ``mode_hops`` of the laser, None: none; ``slips`` of the counter while the axes stood; ``knocks`` in a few
    dwells, None: none."""

    quanta: np.ndarray
    dwell_spectrum: DwellSpectrum
    mode_hops: ModeHops | None
    slips: tuple[SlipAtRest, ...] = ()
    knocks: Knocks | None = None

    def words(self, names: Mapping[str, float]) -> tuple[str, str]:
        """What disturbs, in words: what goes before a pattern, and what is reported where there is none; ``names``:
        probabilities of the effects that are claimed."""
        instead = _disturbance_words(self.dwell_spectrum, names)
        if not instead and self.knocks and not names:
            # What has a name moves inside some dwells too, where it is large.
            instead = self.knocks.words
        return self.mode_hops.words if self.mode_hops else '', instead


def disturbed(log: CalibrationLog, observation: Observation) -> tuple[Observation, Disturbances]:
    """The observation with what disturbs it as noise, and what that is."""
    table = observation.table
    distance = observation.view.distance.mean(axis=1)
    channels = dwells_by_channel(log, table)
    samples = dwell_spectrum(channels, table.run, distance)
    quanta = np.array(table.quanta)
    if quanta.any():
        observation = _with_steps(observation, quanta)
    observation = _with_spectrum(observation, samples)
    hopping = mode_hops(log.displacement, observation.table, distance)
    if hopping:
        return _with_hops(observation, hopping), Disturbances(quanta, samples, hopping)
    slips = slips_at_rest(log.displacement, table)
    if slips:
        observation = _with_slips(observation, slips)
    # Dwells that swing are each as loud as its line happens to begin.
    knocked = None if samples.swings.any() else knocks(channels, {slip.row for slip in slips})
    return observation, Disturbances(quanta, samples, None, slips, knocked)


def _with_slips(observation: Observation, slips: tuple[SlipAtRest, ...]) -> Observation:
    """The observation with the dwells in which the counter slipped as they would be without that."""
    observation = replace(observation, table=without(observation.table, slips))
    return refitted(observation, sane_fit(observation.log, observation.table, observation.fit.theta))


def _with_steps(observation: Observation, width: np.ndarray) -> Observation:
    """The observation with what readings that move in steps of ``width`` (c,) [m] round off as noise.

    Neighbours in time are mostly equal and tell nothing of the bins' noise: their whole scatter is taken for it.
    """
    log, table, beams = observation.log, observation.table, observation.fit.model.beams
    variance = np.concatenate([step_noise(log.displacement, table.displacement_rows, width[:beams]),
                               step_noise(log.spot, table.spot_rows, width[beams:])])
    seen = np.isfinite(observation.bins).sum(axis=(0, 1))   # none of a channel where its dwells are too short for bins
    scatter = np.sqrt(np.nansum(observation.bins**2, axis=(0, 1)) / np.maximum(seen, 1))
    scatter = np.maximum(scatter, np.sqrt(variance))
    return replace(observation, table=replace(table, disturbed=np.tile(variance, (len(table), 1))),
                   bin_sigma=np.where(width > 0.0, np.maximum(observation.bin_sigma, scatter), observation.bin_sigma))


def _with_spectrum(observation: Observation, samples: DwellSpectrum) -> Observation:
    """The observation with vibration, turbulence or hum as noise of what shows it: else effects would be fitted
    to it.  Shaking hardly moves a dwell's mean; moving air does, and wanders from stop to stop."""
    table, beams = observation.table, observation.fit.model.beams
    if samples.swings.any():
        observation = replace(observation, swings=samples.swings)
    length, bins = float(np.median(table.done_ns - table.dwell_ns)) * 1e-9, observation.bins.shape[1]
    more = np.zeros(observation.bin_sigma.shape)
    if samples.turbulent:
        table = replace(table, wander=samples.power)
        # A part of a dwell has that of the e-folds between its length and the dwell's besides.
        more[:, :beams] = samples.power[:, None] * np.log(bins)
    # A line fills no more than two of the bins' contrasts, with all its power.
    elif samples.has_lines:
        more[:, :beams] = samples.displacement.variance(length / bins) * bins / 2.0
    if samples.mains_hum:
        more[:, beams:] = samples.swings[:, 1:].any(axis=0) * samples.spot.variance(length / bins) * bins / 2.0
    return replace(observation, bin_sigma=np.sqrt(observation.bin_sigma**2 + more), table=table) if more.any() \
        else observation


def _with_hops(observation: Observation, seen: ModeHops) -> Observation:
    """The observation with the unit of length as noise: in which unit a stop was read is not known.  Dwells
    with a step inside say nothing else."""
    table, beams = observation.table, observation.fit.model.beams
    bins, sigma = observation.bins.copy(), observation.bin_sigma.copy()
    bins[seen.rows, :, :beams] = np.nan
    sigma[:, :beams] = np.sqrt(sigma[:, :beams] ** 2 + seen.inside[:, None])
    return replace(observation, bins=bins, bin_sigma=sigma,
                   table=replace(table, hop=seen.step, hops_per_s=seen.per_s))


def _disturbance_words(samples: DwellSpectrum, names: Mapping[str, float]) -> str:
    """What the dwell spectrum shows besides a shaking of the tool point, in words."""
    if samples.turbulent:
        return ('displacement: slow random noise inside the dwells that grows with the path '
                f'(its power as path^{samples.growth:.1f}), as of moving air')
    if samples.grows_with_path:
        return (f'displacement: swings at {samples.displacement.frequency:.3g} Hz (as sampled) inside the dwells, '
                'the more the longer the path, as of moving air or of the laser')
    if samples.swings_in_few:
        return (f'displacement: swings, at about {samples.displacement.frequency:.2g} Hz, inside a few of the dwells '
                'only, as knocks from the floor or a supply that gives way would make it')
    if samples.mains_hum and names.get('ambient_light', 0.0) < 0.5:
        return (f'spot: swings at {samples.spot.frequency:.3g} Hz (as sampled) inside the dwells, '
                'the displacement does not')
    return ''
