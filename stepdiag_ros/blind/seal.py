"""Seal a set: draw the orders, make each log in a process of its own, lock the truth away.

``DIR/logs/log_NNN/`` are the logs, ``DIR/manifest.json`` says how many and publishes the SHA-256
of ``DIR/sealed/truth.json``, which nothing but :mod:`stepdiag_ros.blind.opened` reads.
"""

import hashlib
import json
import os
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from stepdiag_ros.bag.export import write_log
from stepdiag_ros.blind.cells import KINDS
from stepdiag_ros.blind.live import write_live
from stepdiag_ros.blind.outsiders import MET, UNMET, USUAL
from stepdiag_ros.blind.pool import side_by_side
from stepdiag_ros.blind.vocabulary import NAMES
from stepdiag_ros.blind.world import PURPOSES, Order, make
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.guard.jsontext import to_json

SCHEMA = 1
MANIFEST, SEALED, LOGS = 'manifest.json', 'sealed/truth.json', 'logs'
NOT_TOGETHER = ({'psd_gain', 'ambient_light'},)
"""Pairs that are not drawn: in most logs no one could tell them from either alone."""


def orders(purpose: str, seed: int, counts: dict[str, int], world: str = 'varied',
           small: bool = False, untidy: float = 0.0, wide: bool = False) -> list[Order]:
    """The orders of a set in the order of its logs, every effect about equally often.

    ``untidy``: share of the simulated worlds whose noise is as instruments have it; ``counts['live']`` logs come last,
    measured through the running graph, every second one on a busy computer; ``counts['unseen']`` are from outside, of
    kinds that the diagnosis has not met.  ``wide``: more kinds from outside, larger sizes, and time profiles that begin
    with anything.
    """
    if not 0.0 <= untidy <= 1.0:
        raise StepdiagError(f'--untidy {untidy:g} is no share; give a number from 0 to 1')
    if purpose not in PURPOSES:
        raise StepdiagError(f'--purpose {purpose!r} is unknown; choose one of {", ".join(PURPOSES)}')
    if world not in KINDS:
        raise StepdiagError(f'--world {world!r} is unknown; choose one of {", ".join(KINDS)}')
    rng = np.random.default_rng(np.random.SeedSequence([PURPOSES[purpose], seed]))
    wanted: list[tuple[str, tuple[str, ...]]] = [('null', ())] * counts.get('null', 0)
    wanted += [('single', (name,)) for name in _evenly(rng, NAMES, counts.get('single', 0))]
    wanted += [('outside', (name,)) for name in
               _evenly(rng, [kind.name for kind in (MET if wide else USUAL)], counts.get('outside', 0))]
    for first in _evenly(rng, NAMES, counts.get('pair', 0)):
        others = [n for n in NAMES if n != first and {n, first} not in NOT_TOGETHER]
        wanted.append(('pair', (first, str(rng.choice(others)))))
    wanted += [('outside', (name,)) for name in _evenly(rng, [kind.name for kind in UNMET], counts.get('unseen', 0))]
    simulated = [Order(purpose, seed, number + 1, *wanted[place], world, small, untidy, wide=wide)
                 for number, place in enumerate(rng.permutation(len(wanted)))]
    return simulated + [Order(purpose, seed, len(wanted) + number + 1, 'null', (), world, small, live=True,
                              loaded=number % 2 == 1) for number in range(counts.get('live', 0))]


def kind_order(purpose: str, seed: int, entry: dict[str, Any]) -> Order:
    """The order that the log of a truth's entry was made from."""
    return Order(purpose, seed, entry['number'], entry['category'],
                 tuple(e['name'] for e in entry['effects']), entry['world'], entry['small'],
                 entry.get('untidy', 0.0), wide=entry.get('wide', False))


def _evenly(rng: np.random.Generator, names: Iterable[str], count: int) -> list[str]:
    names = list(names)
    rounds = -(-count // len(names)) if count else 0
    return [str(n) for _ in range(rounds) for n in rng.permutation(names)][:count]


def name_of(order: Order, total: int) -> str:
    """``log_007``: the number alone, with as many digits as the set needs."""
    return f'log_{order.number:0{max(2, len(str(total)))}d}'


def seal(out: Path, todo: list[Order], processes: int = 2, progress: bool = True) -> str:
    """Write the set; returns the SHA-256 of the truth.  Logs that are there are kept and made again
    only in memory where their truth is missing."""
    if not todo:
        raise StepdiagError('blind seal: nothing to seal; give --null, --single, --pair, --outside, --unseen or --live')
    if (out / MANIFEST).exists():
        raise StepdiagError(f'{out}: is sealed already; give another --out')
    (out / LOGS).mkdir(parents=True, exist_ok=True)
    parts = out / 'sealed' / 'parts'
    parts.mkdir(parents=True, exist_ok=True)
    names = {name_of(order, len(todo)): order for order in todo}
    missing = [name for name in names if not (parts / f'{name}.json').exists()]
    # A fresh process for every world: nothing of one log can remain in the next.
    os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')
    jobs = {name: (names[name], str(out / LOGS / name), str(parts / f'{name}.json'))
            for name in missing if not names[name].live}
    for _ in side_by_side(_one, jobs, processes, 'sealed' if progress else '', fresh=True):
        pass
    for name in missing:   # one at a time: each has the computer, or what its load leaves of it, for itself
        if names[name].live:
            write_live(names[name], out / LOGS / name, parts / f'{name}.json')
            if progress:
                print(f'{name}: measured live', file=sys.stderr, flush=True)
    truth = {'schema': SCHEMA, 'purpose': todo[0].purpose, 'seed': todo[0].seed,
             'logs': {name: json.loads((parts / f'{name}.json').read_text()) for name in names}}
    text = to_json(truth, sort_keys=True)
    (out / SEALED).write_text(text)
    for part in parts.iterdir():
        part.unlink()
    parts.rmdir()
    digest = hashlib.sha256(text.encode()).hexdigest()
    write_json(out / MANIFEST, {'schema': SCHEMA, 'logs': len(names), 'truth_sha256': digest})
    return digest


def _one(order: Order, path: str, truth_path: str) -> None:
    """Make one log; the truth is written last, so that a cut run is resumed rightly."""
    made = make(order)
    target = Path(path)
    if target.exists():
        for file in target.iterdir():
            file.unlink()
    # The writer's receipt times, names and custom data hold nothing of the draw.
    write_log(made.log, target, namespace='cell1')
    write_json(Path(truth_path), made.truth)


def read_json(path: Path) -> dict[str, Any]:
    """What :func:`write_json` has written; nothing where it has not yet."""
    return json.loads(path.read_text()) if path.exists() else {}


def write_json(path: Path, data: dict[str, Any]) -> None:
    """Write at once or not at all."""
    temporary = path.with_name(f'.{path.name}.{os.getpid()}')
    temporary.write_text(to_json(data, sort_keys=True) + '\n')
    temporary.replace(path)
