"""The enhanced method's estimation against one dense numpy.linalg.lstsq of the same matrix.

    python bench/bench_estimate.py                    10, 20, 50 steps an axis, a minute or two
    python bench/bench_estimate.py --steps 10 50 200  up to 200 steps: some minutes and 4 GB

Writes docs/bench/estimate.md and prints it.  One core for everybody, processor time instead of the
clock's, so that a busy machine does not blur the ratios; all ratios are from one run.
"""

import os

# One core for everybody, before NumPy is loaded.
os.environ.update({'OMP_NUM_THREADS': '1', 'OPENBLAS_NUM_THREADS': '1'})

import argparse
import platform
import time
from pathlib import Path

import numpy as np
import scipy
from estimate_case import best_of, make_case, peak_mb

from stepdiag_ros.estimate import enhanced
from stepdiag_ros.estimate.banded import BandedNormal

PAGE = Path(__file__).resolve().parents[1] / 'docs' / 'bench' / 'estimate.md'
LARGEST_DENSE = 100
"""Steps an axis above which the dense peer is left out: it grows with the cube."""


def measure(steps: int) -> tuple[str, float | None, float]:
    """One row of the table, the ratio of the linear problem, and the difference of the answers [σ]."""
    case = make_case(steps)
    result = enhanced.fit(case.description, case.table, case.noise)
    parameters, model = result.parameters, result.model
    n, size = result.jacobian.shape
    theta = result.theta
    residual = np.where(result.present, result.residual, 0.0).ravel()
    pull = result.precision @ theta
    arrival = model.jacobian(enhanced.start(parameters, model, case.table, enhanced.readings_of(case.table)))[2]
    band = BandedNormal(case.table, case.noise, arrival, result.present, enhanced.prior_sigmas(parameters),
                        enhanced.frame_rows(parameters), enhanced.PRIOR_FRAME_RAD,
                        min(parameters.setup_first.values()))
    band.solve(result.jacobian, residual, pull)
    best = 5 if steps <= 50 else 1
    ours = best_of(lambda: band.solve(result.jacobian, residual, pull), best, time.process_time)
    whole = best_of(lambda: enhanced.fit(case.description, case.table, case.noise), 2 if steps <= 50 else 1,
                    time.process_time)
    memory = peak_mb(lambda: enhanced.fit(case.description, case.table, case.noise)) if steps <= 50 else np.nan
    ratio, gap, dense_text, whole_text = None, 0.0, '', ''
    if steps <= LARGEST_DENSE:
        # The same problem as rows: whitened readings, then the priors.
        dense = result.jacobian.toarray()
        rows = np.concatenate([white(dense) for white in result.whiteners])
        right = np.concatenate([white(residual) for white in result.whiteners])
        prior = np.concatenate([np.diag(1.0 / enhanced.prior_sigmas(parameters)),
                                enhanced.frame_rows(parameters) / enhanced.PRIOR_FRAME_RAD])
        matrix = np.concatenate([rows, prior])
        target = np.concatenate([right, -prior @ theta])
        scale = 1.0 / np.linalg.norm(matrix, axis=0)
        begin_best = 2 if steps <= 50 else 1
        # Only the readings' rows: the peer gets the smaller matrix, and no whitening to pay for.
        peer = best_of(lambda: np.linalg.lstsq(rows, right, rcond=None), begin_best, time.process_time)
        full = np.linalg.lstsq(matrix * scale, target, rcond=None)[0] * scale
        step = band.solve(result.jacobian, residual, pull)
        gap = float(np.max(np.abs(full - step) / np.sqrt(np.diag(result.covariance))))
        ratio = peer / ours
        dense_text = f'{1e3 * peer:.0f} | {ratio:.1f}×'
        whole_text = f'{peer / whole:.2f}×'
    else:
        dense_text = '– | –'
    return (f'| {steps} | {n} | {size} | {band.bandwidth} | {1e3 * ours:.1f} | {dense_text} | {1e3 * whole:.0f} '
            f'({result.iterations}) | {whole_text or "–"} | {"–" if np.isnan(memory) else f"{memory:.0f}"} |',
            ratio, gap)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--steps', type=int, nargs='+', default=[10, 20, 50], help='steps an axis')
    args = parser.parse_args()
    rows, ratios, gaps = [], {}, []
    for steps in args.steps:
        row, ratio, gap = measure(steps)
        rows.append(row)
        gaps.append(gap)
        if ratio is not None:
            ratios[steps] = ratio
        print(row, flush=True)
    lines = ['# Estimation', '', 'Made by `python bench/bench_estimate.py`. Four diagonals and three lines run once, distance '
             'and tilts at every stop; errors of arrival tie the stops of a run together.',
             f'{platform.machine()}, Python {platform.python_version()}, NumPy {np.__version__}, SciPy '
             f'{scipy.__version__}; one core, processor time, all from one run.', '',
             '*Linear* is one solution of the linear problem: assembling and solving the normal equations as a band with a '
             'border (`estimate/banded.py`), against one dense `numpy.linalg.lstsq` of the same matrix, already whitened '
             'and assembled for it. *Whole* is the entire estimation: noise model, all Gauss–Newton steps with the full '
             'kinematic model, the full covariance of all unknowns.', '',
             '| steps an axis | readings | unknowns | band | linear, ours / ms | linear, dense lstsq / ms | ours is | '
             'whole / ms (steps of Gauss–Newton) | one dense lstsq against the whole | peak MB of the whole |',
             '|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|', *rows, '',
             f'Largest difference between the two linear answers: {max(gaps):.1e} standard uncertainties.']
    if 50 in ratios:
        met = ratios[50] >= 10.0
        lines += ['', 'Target: at least 10× at 50 steps: ' + f'{ratios[50]:.1f}×, ' + (
            'met for the linear problem.' if met else 'missed: the sparse products and the border of the band take most '
            'of the time.') + ' The whole estimation does more than one dense solution does: several steps, and a '
            'covariance of all unknowns, which takes the dense equations once or twice.']
    PAGE.write_text('\n'.join(lines) + '\n', encoding='utf-8')
    print('\n'.join(lines[-4:]))
    print(PAGE)


if __name__ == '__main__':
    main()
