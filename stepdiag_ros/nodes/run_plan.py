"""What a goal asks for, stop by stop.  Pure: no ROS, no clock."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.model.cycle import cycle
from stepdiag_ros.model.description import Description


@dataclass(frozen=True)
class Stop:
    """One stop of a run: its index along the path, the axis that moved to it, position (3,) [m], direction of the
    traverse; ``beyond_m`` (3,): where the machine passes before it, None: nowhere; ``most_m_s``: greatest feed
    [m/s]."""

    index: int
    axis: int
    position_m: np.ndarray
    direction: int = 1
    beyond_m: np.ndarray | None = None
    most_m_s: float = np.inf


@dataclass(frozen=True)
class Run:
    """What is measured without a reset; ``direction`` of its first stop."""

    run_id: str
    setup: str
    repeat: int
    direction: int
    stops: tuple[Stop, ...]


def with_steps(description: Description, steps: int) -> Description:
    """The description with another number of steps; 0 leaves the plan's."""
    if steps == 0 or steps == description.plan.steps:
        return description
    return replace(description, plan=replace(description.plan, steps=steps))


def planned_runs(description: Description, setups: Sequence[str] = (), repeats: int = 0,
           first_repeat: Mapping[str, int] | None = None) -> list[Run]:
    """The runs of a calibration: each setup, each repeat, forward then backward.

    ``setups`` empty: all of the description; ``repeats`` 0: the plan's.  Repeats of a setup
    count on from ``first_repeat``, so that no two runs of a log bear one name.
    """
    names = list(setups) or list(description.setups)
    unknown = [name for name in names if name not in description.setups]
    if unknown:
        raise StepdiagError(f'unknown setup {unknown[0]!r}; the cell description has '
                            f'{", ".join(description.setups)}')
    if len(set(names)) < len(names):
        raise StepdiagError('a setup is named twice; repeats are asked for with the field repeats')
    runs = []
    for name in names:
        begin, most = (first_repeat or {}).get(name, 0), description.setups[name].feed or np.inf
        for repeat in range(begin, begin + (repeats or description.repeats_of(name))):
            for part in cycle(description, name):
                visits = tuple(Stop(v.index, v.axis, v.position, v.direction, v.beyond, most) for v in part.visits)
                runs.append(Run(f'{name}/{repeat}/{part.name}', name, repeat, visits[0].direction, visits))
    return runs


def remaining(runs: Sequence[Run], completed: Sequence[str], broken: str) -> list[Run]:
    """What of ``runs`` a sequencer that took over has to do: not the ``completed``; ``broken`` under a new name."""
    done = {original(run_id) for run_id in completed}
    left = [run for run in runs if run.run_id not in done]
    return [once_more(replace(run, run_id=broken)) if run.run_id == original(broken) else run for run in left]


def original(run_id: str) -> str:
    """The name that a run bore when it was first tried: ``ppp/0/+/2`` -> ``ppp/0/+``."""
    return '/'.join(run_id.split('/')[:3])


def attempt(run_id: str) -> int:
    """Which try of a run a name means: ``ppp/0/+`` 1, ``ppp/0/+/2`` 2."""
    last = run_id.split('/')[3:]
    return int(last[0]) if last and last[0].isdigit() else 1


def once_more(run: Run) -> Run:
    """The run as it is called when it is repeated because it was broken off: no two runs of a log bear one name."""
    return replace(run, run_id=f'{original(run.run_id)}/{attempt(run.run_id) + 1}')


def first_repeats(run_ids: Sequence[str]) -> dict[str, int]:
    """The least repeat of each setup among runs."""
    found: dict[str, int] = {}
    for run_id in filter(None, run_ids):
        setup, repeat, *_ = [*run_id.split('/'), '', '']
        if repeat.isdigit():
            found[setup] = min(int(repeat), found.get(setup, int(repeat)))
    return found
