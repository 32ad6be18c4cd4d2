"""Write the log of a virtual cell without running the graph: a whole calibration in a second or two.

The cell runs its plan on a virtual clock, with everything that its file describes:
errors, misalignments, noise, air and effects.  The same file gives the same log.

  stepdiag simulate cells/demo.yaml --out bags/demo
  stepdiag simulate cells/workshop.yaml --out bags/workshop --truth truth.json --seed 7
"""

import argparse
import dataclasses
import shutil
from pathlib import Path

from stepdiag_ros.cli.progress import Bar
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.guard.jsontext import to_json

NAME = 'simulate'
HELP = 'write the log of a virtual cell without running the graph'
LONG_S = 2.0
"""Work shorter than this needs no progress."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('cell', metavar='CELL.yaml', type=Path, help='cell file, e.g. cells/demo.yaml')
    parser.add_argument('--out', metavar='BAG', type=Path, required=True, help='bag to write (a folder)')
    parser.add_argument('--truth', metavar='FILE', type=Path,
                        help="write the machine's true errors there, as JSON")
    parser.add_argument('--setups', metavar='NAME', nargs='+',
                        help='only these setups, in this order (default: all, as in the file)')
    parser.add_argument('--seed', type=int,
                        help="another draw of noise and arrivals; the machine stays the file's")
    parser.add_argument('--rate', type=float, metavar='HZ', help='sample rate of both sensors')
    parser.add_argument('--dwell-only', action='store_true', help='sample at rest only, not in motion')
    parser.add_argument('--effect', metavar='FILE.py', action='append', default=[],
                        help='let the cell file name this Python file with an effect of your own; it is run, so '
                             'give only files that you trust')
    parser.add_argument('--force', action='store_true', help='replace a bag that is there already')
    parser.add_argument('--json', action='store_true', help='print what was written as JSON')


def run(args: argparse.Namespace) -> int:
    from stepdiag_ros.bag.export import write_log
    from stepdiag_ros.virtual.acting import allow_effect_files
    from stepdiag_ros.virtual.cell import load_cell
    from stepdiag_ros.virtual.offline import simulate_log
    from stepdiag_ros.virtual.truth import truth

    allow_effect_files(args.effect)
    cell = load_cell(args.cell)
    unknown = [name for name in args.setups or () if name not in cell.setup_names]
    if unknown:
        raise StepdiagError(f'{args.cell}: setup {unknown[0]!r} is not in the cell; '
                            f'it has {", ".join(cell.setup_names)}')
    if args.rate is not None and not 1.0 <= args.rate <= 50_000.0:
        raise StepdiagError(f'--rate is {args.rate:g}; give 1 to 50000 Hz')
    if args.seed is not None:
        cell = dataclasses.replace(cell, seed=args.seed)
    if args.out.exists():
        if not args.force:
            raise StepdiagError(f'{args.out}: exists already; choose another name or give --force')
        if not (args.out / 'metadata.yaml').is_file():
            raise StepdiagError(f'{args.out}: exists and is no bag; choose another name')
        shutil.rmtree(args.out)
    bar = Bar('simulating', quiet=args.json, after_s=LONG_S)
    log = simulate_log(cell, setups=tuple(args.setups) if args.setups else None, rate=args.rate,
                       in_motion=False if args.dwell_only else None,
                       progress=lambda done, total: bar.show(done, total, 'sampling'))
    write_log(log, args.out, progress=lambda done, total: bar.show(done, total, f'writing {args.out}'))
    bar.close()
    if args.truth is not None:
        args.truth.write_text(to_json(truth(cell)) + '\n', encoding='utf-8')
    seconds = (int(log.steps.time_ns[-1]) - int(log.steps.time_ns[0])) * 1e-9
    summary = {'bag': str(args.out), 'machine': log.description.machine.name,
               'runs': len(log.steps.run_ids), 'stops': len(log.steps) // 3,
               'displacement_samples': len(log.displacement), 'spot_samples': len(log.spot),
               'duration_s': round(seconds, 3), 'effects': list(cell.effects)}
    if args.json:
        print(to_json(summary))
    else:
        print(f'{args.out}: {summary["runs"]} runs, {summary["stops"]} stops, '
              f'{summary["displacement_samples"]} displacement and {summary["spot_samples"]} spot samples, '
              f'{seconds:.0f} s of machine time')
    return 0
