"""Two logs of one machine as one: the run that was recommended joins the log that it is to settle.

Whoever measures a further run has it in a log of its own.  Its setups were mounted and aligned anew: ``ppp``
becomes ``ppp.2`` where the first log has a ``ppp`` already.  What was measured does not change.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.model.description import path_of
from stepdiag_ros.model.log import CalibrationLog, Samples, ScalarSeries, StepEvents


def joined(first: CalibrationLog, further: CalibrationLog) -> CalibrationLog:
    """``first`` with what was measured later in ``further``; noise and plan are believed as in ``first``.

    Raises :class:`StepdiagError` where the two are not of one machine, or not one after the other.
    """
    _check(first, further)
    names = _new_names(first, further)
    setups = {**first.description.setups}
    for name, new in names.items():
        if name in further.description.setups:
            setups[new] = replace(further.description.setups[name], name=new)

    def renamed(name: str) -> str:
        return names.get(name, name)
    environment = {key: _series([log.environment[key] for log in (first, further) if key in log.environment])
                   for key in {**first.environment, **further.environment}}
    return replace(
        first, description=replace(first.description, setups=setups), steps=_steps(first.steps, further.steps, renamed),
        displacement=_samples(first.displacement, further.displacement, renamed),
        spot=_samples(first.spot, further.spot, renamed),
        beam_angle=_samples(first.beam_angle, further.beam_angle, renamed), environment=environment,
        source=f'{first.source} and {further.source}', warnings=(*first.warnings, *further.warnings))


def _check(first: CalibrationLog, further: CalibrationLog) -> None:
    one, other = first.description, further.description
    for what in ('chain', 'volume', 'tool'):
        if getattr(one.machine, what) != getattr(other.machine, what):
            raise StepdiagError(f'{further.source}: machine.{what} is {getattr(other.machine, what)!r}, in '
                                f'{first.source} {getattr(one.machine, what)!r}; join logs of one machine only')
    for what in ('steps', 'order'):
        if getattr(one.plan, what) != getattr(other.plan, what):
            raise StepdiagError(f'{further.source}: plan.{what} is {getattr(other.plan, what)!r}, in {first.source} '
                                f'{getattr(one.plan, what)!r}; measure the further run by the same plan')
    beams, others = first.displacement.values.shape[1], further.displacement.values.shape[1]
    if beams != others:
        raise StepdiagError(f'{further.source}: the interferometer has {others} beams, in {first.source} {beams}; '
                            'measure with the same head')
    if not len(further.steps):
        raise StepdiagError(f'{further.source}: no step event; there is nothing to join')
    if len(first.steps) and further.steps.time_ns[0] <= first.steps.time_ns[-1]:
        raise StepdiagError(f'{further.source}: begins before {first.source} ends; name the earlier log first')


def _new_names(first: CalibrationLog, further: CalibrationLog) -> dict[str, str]:
    """What the setups measured in ``further`` are called in the whole: a mounting of its own each."""
    taken, result = {*first.steps.setup_names}, {}
    for name in dict.fromkeys(further.steps.setup_names):
        new, number = name, 2
        while new in taken:
            new, number = f'{path_of(name)}.{number}', number + 1
        taken.add(new)
        result[name] = new
    return result


def _places(first: tuple[str, ...], further: tuple[str, ...]) -> tuple[tuple[str, ...], np.ndarray]:
    """All names, and where those of ``further`` are among them."""
    both = tuple(dict.fromkeys((*first, *further)))
    return both, np.array([both.index(name) for name in further], np.intp)


def _steps(first: StepEvents, further: StepEvents, renamed: Callable[[str], str]) -> StepEvents:
    setup_names, setup = _places(first.setup_names, tuple(renamed(name) for name in further.setup_names))
    ids = []
    for run, old in enumerate(further.run_ids):
        name = further.setup_names[further.setup[np.argmax(further.run == run)]]
        rest = old.removeprefix(name)
        new = renamed(name) + rest if rest != old else old
        while new in first.run_ids:
            new += '.2'
        ids.append(new)
    run_ids, run = _places(first.run_ids, tuple(ids))
    kept = {name: np.concatenate([getattr(first, name), getattr(further, name)])
            for name in ('time_ns', 'repeat', 'direction', 'index', 'axis', 'commanded', 'phase')}
    return StepEvents(run_ids=run_ids, run=np.concatenate([first.run, run[further.run]]), setup_names=setup_names,
                      setup=np.concatenate([first.setup, setup[further.setup]]), **kept)


def _samples(first: Samples, further: Samples, renamed: Callable[[str], str]) -> Samples:
    names, setup = _places(first.setup_names, tuple(renamed(name) for name in further.setup_names))
    kept = {name: np.concatenate([getattr(first, name), getattr(further, name)])
            for name in ('time_ns', 'values', 'health', 'refractive_index')}
    unknown = [np.full(len(part), -1, np.int64) if part.uncertainty_ns is None else part.uncertainty_ns
               for part in (first, further)]
    block = further.block + (int(first.block.max()) + 1 if len(first) else 0)
    return Samples(setup_names=names, setup=np.concatenate([first.setup, setup[further.setup]]),
                   block=np.concatenate([first.block, block]),
                   uncertainty_ns=np.concatenate(unknown) if any(np.any(u >= 0) for u in unknown) else None, **kept)


def _series(parts: list[ScalarSeries]) -> ScalarSeries:
    return ScalarSeries(*(np.concatenate([getattr(part, name) for part in parts])
                          for name in ('time_ns', 'value', 'variance')))
