"""Does the recommended further run settle what an answer left open?

Of every log whose answer holds effects that may stand for each other and recommends a run, the sealed world
is made again, the run is added at its end — the same machine, the same hidden effects going on, the mirror
mounted and aligned anew — and the extended log is diagnosed as it stands.  It is settled when what truly acts of the
group has at least 95 %, both where both act, and all others have less than half.  Where none of the group acts, that
must be seen, and what acts instead have at least 95 %.
"""

import copy
import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from stepdiag_ros.blind.cells import MOST_WALK_M
from stepdiag_ros.blind.forms_detector import AmbientLight
from stepdiag_ros.blind.hidden import Hidden
from stepdiag_ros.blind.logs import measure
from stepdiag_ros.blind.opened import SETTLED, load
from stepdiag_ros.blind.pool import side_by_side
from stepdiag_ros.blind.score import Case
from stepdiag_ros.blind.seal import kind_order, read_json, write_json
from stepdiag_ros.blind.world import SealedWorld, make
from stepdiag_ros.effects import all_effects
from stepdiag_ros.effects.base import Moment
from stepdiag_ros.gap.diagnose import diagnose
from stepdiag_ros.model.description import Setup
from stepdiag_ros.model.log import CalibrationLog
from stepdiag_ros.model.sensor import Misalignment
from stepdiag_ros.virtual.offline import Visit

SURE = 0.95
AT_ONCE_S = 10.0
"""From mounting to the first move of a run that is to begin at once."""


def extended_log(made: SealedWorld, run: Mapping[str, Any]) -> CalibrationLog:
    """The log of a sealed world with the run ``next_run`` of an answer at its end."""
    beams = next(iter(made.cell.description.setups.values())).beams
    setup = Setup(run['setup'], run['standoff_m'], tuple(run['psd_offset_m']), beams,
                  **{key: run[key] for key in ('length', 'stops') if key in run})
    rng = np.random.default_rng(np.random.SeedSequence([made.cell.seed, 0xADD]))
    laser, mirror = np.clip(rng.normal(0.0, _aligned(made), (2, 2)), -_most(made), _most(made))
    mirror = mirror + np.array(run['mirror_turn_rad'])
    cell = made.cell
    description = replace(cell.description, setups={**cell.description.setups, setup.name: setup})
    cell = replace(
        cell, description=description, psd_zero={**cell.psd_zero, setup.name: (0.0, 0.0)},
        misalignments={**cell.misalignments, setup.name: Misalignment(tuple(laser.tolist()),
                                                                     tuple(mirror.tolist()))})
    effects = [_mounted_again(effect, cell.setup_names[:-1], setup.name, rng) for effect in made.effects]
    if run.get('light', 1.0) < 1.0:
        effects = [_GreyFilter(setup.name, run['light'], made.truth['noise']['spot'], rng), *effects]
        for effect in effects:
            if isinstance(effect, AmbientLight):
                effect.beam = {setup.name: run['light']}
    visit = Visit(run.get('wait_s', 0.0), AT_ONCE_S if run['at_once'] else None, run.get('watch_s', 0.0),
                  run.get('again_after_s'))
    log = measure(cell, made.conditions, effects, {setup.name: visit})
    # What was measured before stays as it was; only the description's new setup comes beside it.
    return replace(log, description=replace(made.log.description, setups=description.setups))


class _GreyFilter(Hidden):
    """less light in the beam of one setup: against it the detector's own noise [m] is larger"""

    name = 'grey_filter'

    def __init__(self, setup: str, light: float, noise: float, rng: np.random.Generator):
        self._setup, self._light, self._rng = setup, light, rng
        self._more = noise * np.sqrt(light**-2 - 1.0)

    def after_light(self, moment: Moment) -> None:
        if moment.setup == self._setup:
            moment.intensity = moment.intensity * self._light
            moment.spot = moment.spot + self._more * self._rng.standard_normal(moment.spot.shape)


def _aligned(made: SealedWorld) -> float:
    """How well the operator aligns: the spread [rad] of the log's own misalignments."""
    return float(np.sqrt(np.mean([np.square((m.laser, m.mirror)) for m in made.cell.misalignments.values()])))


def _most(made: SealedWorld) -> float:
    return MOST_WALK_M / (2.0 * (float(np.linalg.norm(made.cell.description.machine.volume)) + 0.5))


def _mounted_again(effect: Hidden, setups: Iterable[str], name: str, rng: np.random.Generator) -> Hidden:
    """The effect in one setup more: what it has drawn for every setup is, there, like in any of them."""
    longer, setups = copy.copy(effect), list(setups)
    for key, value in vars(effect).items():
        if isinstance(value, dict) and set(value) == set(setups):
            setattr(longer, key, {**value, name: value[str(rng.choice(setups))]})
    return longer


def is_settled(ranking: Mapping[str, float], between: Iterable[str], true: Iterable[str]) -> bool:
    """Whether what acts of ``between`` is sure and nothing else of it likely; where nothing of it acts, whether that is
    seen and what else acts is sure."""
    acting = set(true) & {*between} or set(true)
    likely = {name for name in {*between, *acting} if ranking.get(name, 0.0) >= 0.5}
    return likely == acting and all(ranking[name] >= SURE for name in likely)


def settle(folder: Path, progress: Callable[[dict[str, Any]], None] | None = None,
           processes: int = 2) -> list[dict[str, Any]]:
    """Do the recommended runs of an answered set, its hashes checked; writes and returns what became of each.

    A cut call is resumed: runs of the same answers are not done again.
    """
    cases, head = load(folder)
    open_ones = [case for case in cases if case.category in ('single', 'pair')
                 and case.alarmed and case.gap['indistinguishable']]
    os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')
    file = folder / SETTLED
    before = read_json(file)
    same = before.get('answers_sha256') == head['answers_sha256']
    result = {'answers_sha256': head['answers_sha256'], 'of': len(open_ones), 'logs': before['logs'] if same else []}
    write_json(file, result)
    done = {row['log'] for row in result['logs']}
    jobs = {case.name: (case, head['purpose'], head['seed']) for case in open_ones if case.name not in done}
    for _, row in side_by_side(_settled, jobs, processes):
        result['logs'] = sorted([*result['logs'], row], key=lambda one: one['log'])
        write_json(file, result)
        if progress:
            progress(row)
    return result['logs']


def _settled(case: Case, purpose: str, seed: int) -> dict[str, Any]:
    """What became of one answer."""
    run = case.gap.get('next_run')
    row = {'log': case.name, 'true': case.true_names, 'run': run, 'settled': False,
           'between': run['between'] if run else case.gap['indistinguishable'][0]}
    if not run:
        return row
    made = make(kind_order(purpose, seed, case.truth))
    after = diagnose(extended_log(made, run), [kind() for kind in all_effects().values()])
    return row | {'settled': is_settled(after.ranking, run['between'], case.true_names),
                  'after': {name: after.ranking.get(name, 0.0) for name in run['between']},
                  'effects': [[found.name, found.probability] for found in after.effects]}
