"""Run by bench/bench_blind_peers.py in the peers' environment: three selection methods on one problem each.

    python peers_blind.py FOLDER PROCESSES

FOLDER holds NAME.npz: y (N,), X (N, p) of unit columns, effect (p,) number of each column's effect,
form (p,) number of its form.  Writes NAME.json beside each: for every method what it names, the
probabilities it gives (0 or 1 where it gives none), its credible sets, and the seconds it took.
"""

import itertools
import json
import os
import sys
import time
import warnings
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

os.environ.update({'OMP_NUM_THREADS': '1', 'OPENBLAS_NUM_THREADS': '1'})

import numpy as np
from abess import LinearRegression
from pysusie import susie, susie_get_cs, susie_get_pip

MOST = 3
"""Most effects that a subset may hold."""
EBIC_GAMMA = 1.0


def by_susie(y, X, effect, form):
    fit = susie(X, y, L=10, intercept=False, standardize=False)
    pip = np.asarray(susie_get_pip(fit))
    found = susie_get_cs(fit, X=X, coverage=0.95)
    sets = found['cs'] if isinstance(found, dict) else getattr(found, 'cs', found)
    sets = list(sets.values()) if isinstance(sets, dict) else list(sets or [])
    named_sets = [sorted({int(effect[int(k)]) for k in np.asarray(s, int)}) for s in sets]
    probability = {}
    for number in np.unique(effect):
        inside = pip[effect == number]
        probability[int(number)] = float(1.0 - np.prod(1.0 - np.clip(inside, 0.0, 1.0)))
    named = [n for n, p in sorted(probability.items(), key=lambda i: -i[1]) if p >= 0.5]
    return named, probability, named_sets


def by_abess(y, X, effect, form):
    order = np.argsort(form, kind='stable')
    groups = np.unique(form[order], return_inverse=True)[1]
    count = groups.max() + 1
    model = LinearRegression(support_size=range(min(MOST, count) + 1), group=groups, ic_type='ebic',
                             fit_intercept=False, thread=1)
    model.fit(X[:, order], y, is_normal=False)
    weight = {}
    for column in np.flatnonzero(model.coef_):
        number = int(effect[order][column])
        weight[number] = weight.get(number, 0.0) + float(model.coef_[column] ** 2)
    named = sorted(weight, key=lambda n: -weight[n])
    return named, dict.fromkeys(named, 1.0), [[n] for n in named]


def by_exhaustive(y, X, effect, form):
    """Every form alone and every pair of different effects' best forms, the least EBIC of all."""
    size, number_of_forms = len(y), len(np.unique(form))

    def ebic(columns, members):
        solution, *_ = np.linalg.lstsq(X[:, columns], y, rcond=1e-9)
        rest = float(np.sum((y - X[:, columns] @ solution) ** 2))
        rank = len(columns)
        choose = sum(np.log(number_of_forms - i) - np.log(i + 1) for i in range(members))
        return size * np.log(rest / size) + rank * np.log(size) + 2.0 * EBIC_GAMMA * choose
    scores = {(): size * np.log(float(y @ y) / size)}
    best: dict[int, tuple[float, np.ndarray]] = {}
    for number in np.unique(effect):
        for one in np.unique(form[effect == number]):
            columns = np.flatnonzero(form == one)
            value = ebic(columns, 1)
            if value < best.get(int(number), (np.inf, columns))[0]:
                best[int(number)] = (value, columns)
    scores |= {(number,): value for number, (value, _) in best.items()}
    for a, b in itertools.combinations(best, 2):
        scores[(a, b)] = ebic(np.concatenate([best[a][1], best[b][1]]), 2)
    least = min(scores.values())
    odds = {key: np.exp(-0.5 * (value - least)) for key, value in scores.items()}
    whole = sum(odds.values())
    probability = {n: float(sum(o for key, o in odds.items() if n in key) / whole) for n in best}
    chosen = min(scores, key=scores.__getitem__)
    named = sorted(chosen, key=lambda n: best[n][0])
    sets, total, causes = sorted(odds.items(), key=lambda i: -i[1]), 0.0, set()
    for key, value in sets:
        causes |= {named[0]} if named and named[0] in key else set(key)
        total += value / whole
        if total >= 0.95:
            break
    return named, probability, [sorted(causes)] if causes else []


METHODS = {'pysusie': by_susie, 'abess, EBIC': by_abess, 'exhaustive EBIC': by_exhaustive}


def answer(file: Path) -> None:
    """One problem, by every method."""
    warnings.simplefilter('ignore')
    problem = np.load(file)
    data = problem['y'], problem['X'].astype(float), problem['effect'], problem['form']
    answers = {}
    for name, method in METHODS.items():
        begin = time.process_time()
        named, probability, sets = method(*data)
        answers[name] = {'named': [int(n) for n in named], 'seconds': time.process_time() - begin,
                         'probability': {int(n): float(p) for n, p in probability.items()},
                         'sets': sets}
    file.with_suffix('.json').write_text(json.dumps(answers))


def main(folder: Path, processes: int) -> None:
    files = [file for file in sorted(folder.glob('*.npz')) if not file.with_suffix('.json').exists()]
    with ProcessPoolExecutor(processes) as pool:
        list(pool.map(answer, files))


if __name__ == '__main__':
    main(Path(sys.argv[1]), int(sys.argv[2]))
