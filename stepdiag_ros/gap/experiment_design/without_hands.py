"""The further run that a cell can make by itself.

A cell mounts by code what its description names, and can wait, watch and measure again; it sets nothing up
otherwise.  What is left open is what the diagnosis leaves open: names that may stand for each other, a hint, a name
that is not sure.
"""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace

from stepdiag_ros.effects.base import Effect
from stepdiag_ros.gap.diagnosis import Diagnosis
from stepdiag_ros.gap.experiment_design.advice import WORTH
from stepdiag_ros.gap.experiment_design.competing_models import competing_models
from stepdiag_ros.gap.experiment_design.extended_log import Run, seconds_of
from stepdiag_ros.gap.experiment_design.next_run import NextRun, recommend
from stepdiag_ros.gap.inference.search import NOTHING
from stepdiag_ros.model.description import path_of

SURE = 0.95
"""A name with this probability, to which there is no alternative, is an answer."""


@dataclass(frozen=True)
class Able:
    """A run that the cell can make: ``run`` by the setup that its description calls ``code``; takes ``seconds``."""

    code: str
    run: NextRun
    seconds: float


def left_open(diagnosis: Diagnosis) -> Mapping[str, float]:
    """Probabilities of what the diagnosis leaves open, by name; empty where the answer is sure."""
    names = {name for group in diagnosis.indistinguishable for name in group}
    names |= {found.name for found in diagnosis.effects if found.probability < SURE}
    if diagnosis.hint:
        names |= {*diagnosis.hint.found.key, NOTHING}
    return dict(sorted(((name, diagnosis.ranking.get(name, 0.0)) for name in names), key=lambda item: -item[1]))


def run_without_hands(diagnosis: Diagnosis, effects: Iterable[Effect], setups: Collection[str],
                      made: Collection[str] = (), longest_s: float = float('inf')) -> Able | None:
    """The run worth its time that separates best what is left open; None where none is.

    ``setups``: those of the cell description that are mounted by code; ``made``: those measured for the same
    question already, which are not measured for it again; ``longest_s``: most that it may take [s].
    """
    best = diagnosis.hint.found if diagnosis.hint else diagnosis.raw[0]
    models = competing_models(diagnosis.screen, {effect.name: effect for effect in effects}, diagnosis.raw, best,
                       diagnosis.indistinguishable, diagnosis.hint is not None)
    joint = diagnosis.joint
    runs = {run.setup.name: (code, run) for code in setups if code not in made
            for run in [_of(diagnosis, code)]}
    found = recommend(joint, models, [run for _, run in runs.values()], longest_s)
    least = diagnosis.hint.settles if diagnosis.hint else WORTH
    if found is None or not (found.at_once or found.evidence >= least):
        return None
    return Able(runs[found.setup.name][0], found, seconds_of(joint, found.run))


def _of(diagnosis: Diagnosis, code: str) -> Run:
    """A setup of the cell once more, or for the first time."""
    observation = diagnosis.joint.observation
    measured = observation.table.setup_names
    setup = observation.log.description.setups[code]
    if code not in measured:
        return Run(setup, known=False)
    name = f'{path_of(code)}.{1 + sum(path_of(n) == path_of(code) for n in measured)}'
    return Run(replace(setup, name=name), as_mounted=code)
