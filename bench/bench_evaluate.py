"""What a fit costs by steps and by repeats, against one banded solution of the same system.

    python bench/bench_evaluate.py                        a few minutes
    python bench/bench_evaluate.py --cases 8x2 6x30 100x2

Prints a table.  Targets: at most 300 KB a stop, at most 12 banded solutions for the whole.  One core, processor time.
"""

import os

# One core for everybody, before NumPy is loaded.
os.environ.update({'OMP_NUM_THREADS': '1', 'OPENBLAS_NUM_THREADS': '1'})

import argparse
import time

import numpy as np
from estimate_case import best_of, make_case, peak_mb

from stepdiag_ros.estimate import enhanced
from stepdiag_ros.estimate.banded import BandedNormal

CASES = ('8x2', '25x2', '6x30', '50x2')
MOST_KB, MOST_SOLUTIONS = 300.0, 12.0


def measure(steps: int, repeats: int) -> str:
    """One row of the table."""
    case = make_case(steps, repeats, both_ways=True)

    def whole():
        return enhanced.fit(case.description, case.table)

    begin = time.process_time()
    result = whole()
    spent = time.process_time() - begin
    stops, memory = len(case.table), 1e3 * peak_mb(whole) / len(case.table)
    band = BandedNormal(case.table, result.noise, result.arrival, result.present, enhanced.prior_sigmas(result.parameters),
                        enhanced.frame_rows(result.parameters), enhanced.PRIOR_FRAME_RAD,
                        min(result.parameters.setup_first.values()))
    residual = np.where(result.present, result.residual, 0.0).ravel()
    pull = result.precision @ result.theta
    one = best_of(lambda: band.solve(result.jacobian, residual, pull), 2, time.process_time)
    return (f'{steps:5d} {repeats:7d} {stops:6d} {spent:8.2f} {1e3 * spent / stops:9.2f} {one:9.3f} '
            f'{spent / one:9.1f} {memory:8.0f} {result.iterations:6d}  '
            f'{"met" if memory <= MOST_KB else "not met"}; {"met" if spent <= MOST_SOLUTIONS * one else "not met"}')


def main() -> int:
    parser = argparse.ArgumentParser(description='Cost of a fit by steps and repeats.')
    parser.add_argument('--cases', nargs='+', default=CASES, metavar='STEPSxREPEATS')
    print('steps repeats  stops  whole/s  ms a stop  band/s  solutions  KB a stop  steps  targets (memory; solutions)')
    for case in parser.parse_args().cases:
        print(measure(*map(int, case.split('x'))), flush=True)
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
