"""What `stepdiag gap` takes in memory and processor time by the length of the log, the page included.

    python bench/bench_diagnose.py                        some minutes, the longest case 4 GB
    python bench/bench_diagnose.py --cases 8x2 25x2

Logs without an effect, written by `stepdiag simulate`; each is diagnosed by the command in a process of its own, on one
core.  Limits: 300 KB a stop beyond what the command takes for a log of 60 stops; 3 s for 424 stops, 0.5 s of it for the
page; time a stop at most 1.5 times that at 424 stops.  Prints a table.
"""

import argparse
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

CASES = ('8x2', '6x10', '25x2', '6x30', '50x2')
LEAST, MOST_KB = '2x1', 300.0
CELL = """\
seed: 3
machine: {{name: bench, volume: [0.8, 0.6, 0.5], tool: [0.0, 0.0, -0.1]}}
plan: {{steps: {steps}, repeats: {repeats}}}
setups:
  ppp: {{standoff: 0.3, psd_offset: [0.02, 0.0]}}
  npp: {{standoff: 0.3, psd_offset: [0.02, 0.0]}}
  pnp: {{standoff: 0.3, psd_offset: [0.02, 0.0]}}
  nnp: {{standoff: 0.3, psd_offset: [0.02, 0.0]}}
  lin_x: {{standoff: 0.3, psd_offset: [0.02, 0.0], length: 0.8, stops: 2}}
  lin_y: {{standoff: 0.3, psd_offset: [0.02, 0.0], length: 0.6, stops: 2}}
  lin_z: {{standoff: 0.3, psd_offset: [0.02, 0.0], length: 0.5, stops: 2}}
noise: {{displacement: 5.0e-9, spot: 2.0e-7, position_repeatability: 3.0e-7, angle_repeatability: 2.0e-7}}
misalignments: {{drawn: {{laser: 4.0e-4, mirror: 3.0e-4}}}}
motion: {{feed: 0.3, acceleration: 3.0, jerk: 100.0, in_position: 1.0e-9, settling: 0.005, dwell: 0.6, mount: 120.0}}
sampling: {{interferometer: 50, psd: 50, in_motion: false}}
"""
ENVIRONMENT = {**os.environ, 'OMP_NUM_THREADS': '1', 'OPENBLAS_NUM_THREADS': '1'}


def stepdiag(*arguments: str) -> tuple[str, float, float]:
    """What the command prints, its processor time [s], its largest memory [MB]."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    code = ('import resource, sys; from stepdiag_ros.cli.main import main; status = main(sys.argv[1:]); '
            'print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, file=sys.stderr); sys.exit(status)')
    done = subprocess.run([sys.executable, '-c', code, *arguments], env=ENVIRONMENT, capture_output=True, text=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode not in (0, 1):
        raise SystemExit(f'stepdiag {" ".join(arguments)} ended with {done.returncode}: {done.stderr[-2000:]}')
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return done.stdout, spent, float(done.stderr.split()[-1]) / 1e3


def measured(case: str, folder: Path) -> tuple[int, float, float, float]:
    """Stops of a log, processor time [s] and memory [MB] of its diagnosis, processor time [s] of the page in it."""
    steps, repeats = map(int, case.split('x'))
    cell, bag = folder / f'{case}.yaml', folder / case
    cell.write_text(CELL.format(steps=steps, repeats=repeats), encoding='utf-8')
    said, _, _ = stepdiag('simulate', str(cell), '--out', str(bag))
    stops = int(said.split(' stops')[0].split()[-1])
    _, spent, memory = stepdiag('gap', str(bag), '--out', str(folder / 'pages'))
    return stops, spent, memory, page_share(bag)


def page_share(bag: Path) -> float:
    """Processor time [s] of the page alone, imports of what only it needs included."""
    code = ('import sys, time; from stepdiag_ros.bag.reader import read_log; '
            'from stepdiag_ros.effects import all_effects; '
            'from stepdiag_ros.gap.diagnose import diagnose; '
            'found = diagnose(read_log(sys.argv[1]), [kind() for kind in all_effects().values()]); '
            'begin = time.process_time(); from stepdiag_ros.report.gap_page import gap_page; gap_page(found, "log"); '
            'print(time.process_time() - begin)')
    return float(subprocess.run([sys.executable, '-c', code, str(bag)], env=ENVIRONMENT, capture_output=True, text=True,
                                check=True).stdout)


def main() -> int:
    parser = argparse.ArgumentParser(description='Cost of a diagnosis by the length of the log.')
    parser.add_argument('--cases', nargs='+', default=CASES, metavar='STEPSxREPEATS')
    with tempfile.TemporaryDirectory() as folder:
        few, _, base, _ = measured(LEAST, Path(folder))
        print(f'{few} stops: {base:.0f} MB\n\nsteps repeats  stops   CPU/s  page/s  ms a stop     MB  KB a stop beyond  limit',
              flush=True)
        for case in parser.parse_args().cases:
            stops, spent, memory, page = measured(case, Path(folder))
            each = 1e3 * (memory - base) / max(stops - few, 1)
            steps, repeats = map(int, case.split('x'))
            print(f'{steps:5d} {repeats:7d} {stops:6d} {spent:7.1f} {page:7.2f} {1e3 * spent / stops:10.1f} {memory:6.0f} '
                  f'{each:17.0f}  {"met" if each <= MOST_KB else "not met"}', flush=True)
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
