"""Bring a bidirectional positioning test (CSV) in as a bag.

The first line names the columns, each with its unit: target_mm, measured_mm (or
deviation_um, ...), and if known cycle, direction (+1, -1) and time_s.  Units are m,
mm, um, nm.  Every choice that the table leaves open is printed.

  stepdiag import stage_a_x.csv --to bags/stage_a_x
  stepdiag import test.csv --axis y --to bags/y_axis
"""

import argparse

from stepdiag_ros.bag.export import write_log
from stepdiag_ros.bag.import_csv import CADENCE_S, import_csv
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.guard.jsontext import to_json

NAME = 'import'
HELP = 'bring a table of measurements (CSV) in as a bag'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('file', metavar='FILE.csv', help='table of measurements')
    parser.add_argument('--to', metavar='BAG', required=True, help='the bag to write (a new folder)')
    parser.add_argument('--axis', metavar='x|y|z', help='the axis (default: from the file name)')
    parser.add_argument('--cadence', type=float, default=CADENCE_S, metavar='SECONDS',
                        help='time between stops where the table has no time_s (default: %(default)g)')
    parser.add_argument('--corrected', action='store_true',
                        help='whoever measured took the index of air into account; without it nobody is known to have')
    parser.add_argument('--namespace', default='/import', help='namespace of the topics (default: %(default)s)')
    parser.add_argument('--json', action='store_true', help='print the result as JSON')


def run(args: argparse.Namespace) -> int:
    if not args.namespace.strip('/'):
        raise StepdiagError('--namespace is empty; give a name such as /stage')
    result = import_csv(args.file, args.axis, args.cadence, args.corrected)
    custom = {'imported_from': result.log.source} | {f'note_{k}': n for k, n in enumerate(result.notes, 1)}
    bag = write_log(result.log, args.to, namespace=args.namespace, custom_data=custom)
    readings = len(result.log.displacement)
    if args.json:
        print(to_json({'bag': str(bag), 'readings': readings, 'notes': list(result.notes)}))
    else:
        print(f'{bag}: {readings} readings as setup {", ".join(result.log.description.setups)}')
        for note in result.notes:
            print(f'  {note}')
    return 0
