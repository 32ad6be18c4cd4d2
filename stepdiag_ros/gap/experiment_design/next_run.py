"""The further run that settles which of two sets of effects acts: computed, not guessed.

A run is one more setup at the end of the log: a diagonal or line, mounted and aligned anew, perhaps from another
distance, with the detector's beam elsewhere, the mirror turned or less light; perhaps watched at its first stop for a
while, where no arrival errs and what drifts shows at the sensors' own noise; perhaps left standing and measured
again, so that what goes on while nothing is touched shows; such a run begins after a wait.  The run with the least
probability of error (:mod:`experiment_design.discrimination`) is taken, the largest over all sets that compete with the
likeliest.  Expected log evidence, which is given beside, would be a worse guide: where one set predicts little, it
is large on the average of outcomes and nothing in many of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stepdiag_ros.gap.alternatives.unmodelled import NAME as UNKNOWN
from stepdiag_ros.gap.experiment_design.discrimination import Mixture, apart, expected_evidence
from stepdiag_ros.gap.experiment_design.extended_log import ExtendedLog, Known, Run, Ways, seconds_of
from stepdiag_ros.gap.inference.joint import Joint
from stepdiag_ros.gap.inference.search import NOTHING
from stepdiag_ros.model.description import LINEAR, Setup, path_of

WALK_M = 2e-3
"""Spot at the far end when the mirror is turned on purpose: well on any detector."""
FARTHER_M = 1.0
"""How much farther away the base unit is set up."""
ASIDE_M = 0.02
"""How far the detector's beam is set aside."""

RESTS = (0.0, 0.3, 1.0)
"""How long a run is left standing before it is measured again: shares of the log's length, the first that is …"""
ENOUGH = 15.0
"""… separated by this −ln ρ is taken.  The forms are never quite right: runs of which they promised odds of a hundred
to one settled one case in two."""
WATCHED = (60.0, 1200.0)
"""A run is watched for as long as a setup usually takes, within these limits [s]."""
PATIENT_S = 600.0
"""Where it is the time profiles that tell, the cell is left alone before the run for as long as the log took, and
watched for at least so long: what follows the clock has gone on by then, what begins at each mounting begins as before.
No forecast asks for that, for each takes one of its forms to be right."""
GREY = 0.5
"""Light that is left in the beam where background is to be distinguished from it."""
BACKGROUND = 'ambient_light'
FRESH = 'mirror_mount_creep'
SOON = 'Begin right after mounting the mirror: a mount that relaxes moves most then, nothing else does.'
"""An effect that a fresh mounting shows best, whatever its forms predict."""

Best = tuple[Run, float, Mixture, list[Mixture]] | None
"""A run, its −ln ρ and the forecasts of the likeliest set and of the others."""


@dataclass(frozen=True)
class NextRun:
    """The ``run`` to add at the end of the log.

    ``evidence``: log evidence that it is expected to bring at least; ``error``: most that the probability may be of
    its speaking for the wrong effect; ``between``: the effects it decides between.
    ``at_once``: the run should begin right after mounting, which the forecast does not count on.
    """

    run: Run
    evidence: float
    error: float
    between: tuple[str, ...]
    at_once: bool
    text: str

    @property
    def setup(self) -> Setup:
        return self.run.setup

    def to_json_dict(self) -> dict:
        s = self.setup
        length = {'length': s.length, 'stops': s.stops} if s.is_linear else {}
        return {'setup': s.name, 'standoff_m': s.standoff, 'psd_offset_m': list(s.psd_offset), **length,
                'mirror_turn_rad': list(self.run.mirror_turn_rad), 'light': self.run.light,
                'wait_s': self.run.wait, 'watch_s': self.run.watch, 'again_after_s': self.run.again_after,
                'at_once': self.at_once,
                'expected_log_evidence': self.evidence, 'error_probability': self.error,
                'between': list(self.between), 'text': self.text}


def recommend(joint: Joint, models: Sequence[Ways], able: Sequence[Run] | None = None,
              longest_s: float = np.inf) -> NextRun | None:
    """The further run that tells the likeliest set, the first of ``models``, from all others best.

    ``able``: the runs to choose from, which are only watched, left standing or waited for, for a cell that sets nothing
    up otherwise; None: all that hands can do.  ``longest_s``: a run that takes longer [s] is not thought of.
    """
    if len(models) < 2:
        return None
    names = [{effect.name for effect, _ in ways[0][1]} or {NOTHING} for ways in models]
    between = tuple(sorted(set.union(*names) - set.intersection(*names)))
    if not between:
        return None
    # Which diagonal or line, whether it is watched or left standing, matters most; how it is set up is tried on the
    # best.
    log, best, plain = Known(joint), None, _once_more(joint) if able is None else able

    def better(runs: Sequence[Run], than: Best) -> Best:
        return _best(joint, models, [run for run in runs if seconds_of(joint, run) <= longest_s], than, log)
    for runs in (plain, [_watched(joint, run) for run in plain], [_standing(joint, run)[-1] for run in plain]):
        if best is None or best[1] < ENOUGH:
            best = better(runs, best)
    if best and best[1] < ENOUGH and able is None:
        best = better(_set_up(joint, best[0], between), best)
    if best and best[1] < ENOUGH:
        best = better([_watched(joint, best[0]), *_standing(joint, best[0])], best)
    if best is None:
        return None
    if best[0].watch or best[0].again_after is not None:
        best = better([_patient(joint, best[0])], None) or best
    run, separation, first, others = best
    evidence = min(min(expected_evidence(first, other), expected_evidence(other, first)) for other in others)
    error, at_once = 0.5 * float(np.exp(-max(separation, 0.0))), FRESH in between
    return NextRun(run, evidence, error, between, at_once,
                   run.text + (f' {SOON}' if at_once else '') + _hope(error, between))


def _best(joint: Joint, models: Sequence[Ways], runs: Sequence[Run], best: Best,
          log: Known) -> Best:
    """The run that tells the sets apart best among ``runs`` and ``best``.

    A mounting by code may bring back the directions that it had or not: what tells less counts.
    """
    for run in runs:
        found = [_separation(joint, models, way, log) for way in ([run, replace(run, as_mounted='')] if run.as_mounted
                                                            else [run])]
        if None in found:
            continue
        separation, first, others = min((one for one in found if one), key=lambda one: one[0])
        if best is None or separation > best[1]:
            best = run, separation, first, others
    return best


def _separation(joint: Joint, models: Sequence[Ways], run: Run,
                log: Known) -> tuple[float, Mixture, list[Mixture]] | None:
    """−ln ρ of a run and the forecasts of the likeliest set and of the others; None where one forecasts nothing."""
    extended = ExtendedLog(joint, run, log)
    forecasts = [extended.forecasts(ways) for ways in models]
    if not all(forecasts):
        return None
    return min(apart(forecasts[0], other) for other in forecasts[1:]), forecasts[0], forecasts[1:]


def _hope(error: float, between: Sequence[str]) -> str:
    """What is expected of a run, in words."""
    said = ['something else' if name == UNKNOWN else name for name in between]
    names = f'{", ".join(said[:-1])} and {said[-1]}'
    odds = 'more than 10000' if error < 1e-4 else f'{float(f"{1.0 / error:.2g}"):.0f}'
    return f' It is to decide between {names}' + (
        f', with odds of {odds} to one that it does if the time profiles thought of hold.' if error < 0.25 else
        '; no run that was thought of promises to.')


def _once_more(joint: Joint) -> list[Run]:
    """Every diagonal and line once more as it was, and the lines that the log does not hold."""
    description, names = joint.observation.log.description, joint.observation.table.setup_names
    runs = []
    for base in dict.fromkeys(path_of(name) for name in names):
        old = description.setups[base if base in names else
                                 next(name for name in names if path_of(name) == base)]
        runs.append(Run(replace(old, name=f'{base}.{1 + sum(path_of(name) == base for name in names)}')))
    diagonals = [name for name in names if path_of(name) not in LINEAR]
    for axis, base in enumerate(LINEAR) if diagonals else ():
        if not any(path_of(name) == base for name in names):
            line = replace(description.setups[diagonals[-1]], name=f'{base}.1',
                           length=description.machine.volume[axis], stops=description.plan.steps + 1)
            runs.append(Run(line, known=False))
    return runs


def _set_up(joint: Joint, run: Run, between: Sequence[str]) -> list[Run]:
    """Other ways to set up a run: the mirror turned, farther away, the detector's beam aside, less light."""
    setup = run.setup
    turn = WALK_M / (2.0 * (float(np.linalg.norm(joint.observation.log.description.machine.volume)) + FARTHER_M))
    turned = replace(run, mirror_turn_rad=(turn, -turn),
                     how=f'with the mirror turned by {turn * 1e3:.1f} mrad about both of its axes')
    runs = []
    if not setup.is_linear:
        aside = (setup.psd_offset[0], setup.psd_offset[1] + ASIDE_M)
        runs = [turned,
                replace(run, setup=replace(setup, standoff=round(setup.standoff + FARTHER_M, 4)),
                        how=f'with the base unit {FARTHER_M:g} m farther away'),
                replace(run, setup=replace(setup, psd_offset=aside),
                        how=f"with the position sensor's beam {ASIDE_M * 1e3:.0f} mm aside")]
    light = joint.observation.table.intensity
    if BACKGROUND in between and np.isfinite(light).all() and light.min() > 0.0:
        runs += [replace(run, light=GREY), replace(turned, light=GREY)]
    return runs


def _watched(joint: Joint, run: Run) -> Run:
    """The run with a long look at its first stop, before anything moves."""
    table = joint.observation.table
    taken = np.median([np.ptp(table.time_s[table.setup == s]) for s in np.unique(table.setup)])
    return replace(run, watch=60.0 * float(np.ceil(np.clip(taken, *WATCHED) / 60.0)))


def _patient(joint: Joint, run: Run) -> Run:
    """The run after the cell has been left alone for as long as the log took, and with a long look."""
    span = float(np.ptp(joint.observation.table.time_s))
    return replace(run, wait=60.0 * float(np.ceil(span / 60.0)), watch=max(run.watch, PATIENT_S))


def _standing(joint: Joint, run: Run) -> list[Run]:
    """The run left standing, mirror and base unit untouched, and measured again."""
    span = float(np.ptp(joint.observation.table.time_s))
    return [replace(run, again_after=60.0 * round(share * span / 60.0)) for share in RESTS]
