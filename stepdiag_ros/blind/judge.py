"""What the sealed worlds themselves say of their logs, for the score: what noise alone leaves, which effects compete.

Both are kept in ``worlds.json`` beside the answers; a cut run is resumed.  Nothing is judged before the set is
answered and both hashes are right.
"""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from stepdiag_ros.blind.apart import apart
from stepdiag_ros.blind.floor import floor
from stepdiag_ros.blind.opened import WORLDS, load
from stepdiag_ros.blind.pool import side_by_side
from stepdiag_ros.blind.score import COUNTS_FROM, total_visibility
from stepdiag_ros.blind.seal import kind_order, read_json, write_json
from stepdiag_ros.blind.world import make
from stepdiag_ros.gap.preprocess.observe import observe

Entry = dict[str, Any]


def judge_floors(folder: Path, processes: int = 2, progress: bool = True) -> None:
    """Find for every log with effects that count what noise alone leaves of it."""
    _judge(folder, ('single', 'pair'), 'noise_chi2', _floor, processes, progress)


def judge_apart(folder: Path, processes: int = 2, progress: bool = True) -> None:
    """Find for every log with one effect that counts how far the nearest effect of the vocabulary stays off."""
    _judge(folder, ('single', 'outside'), 'least_apart', _apart, processes, progress)


def _floor(purpose: str, seed: int, entry: Entry) -> Entry:
    return {'noise_chi2': floor(observe(make(kind_order(purpose, seed, entry)).undisturbed))}


def _apart(purpose: str, seed: int, entry: Entry) -> Entry:
    made = make(kind_order(purpose, seed, entry))
    left = apart(made, observe(made.yardstick.log))
    own = made.effects[0].name
    rival = min((n for n in left if n != own), key=left.__getitem__)
    return {'least_apart': left[rival], 'rival': rival, 'own_left': left.get(own)}


def _judge(folder: Path, categories: tuple[str, ...], key: str, judged: Callable[[str, int, Entry], Entry],
           processes: int, progress: bool) -> None:
    cases, head = load(folder)
    done = read_json(folder / WORLDS)
    os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')
    jobs = {case.name: (head['purpose'], head['seed'], case.truth) for case in cases
            if key not in case.truth and case.category in categories
            and all(total_visibility(e) >= COUNTS_FROM for e in case.truth['effects'])}
    said = side_by_side(judged, jobs, processes, 'judged' if progress else '')
    for count, (name, result) in enumerate(said, 1):
        done[name] = {**done.get(name, {}), **result}
        if count % 20 == 0:
            write_json(folder / WORLDS, done)
    write_json(folder / WORLDS, done)
