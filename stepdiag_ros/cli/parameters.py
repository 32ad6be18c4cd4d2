"""Write the parameter file of a cell's nodes, for `ros2 launch` and for nodes started by hand.

The instruments' addresses are those of a virtual cell that runs with the same --runtime folder (its
endpoints.yaml), or with --hardware those of the cell file.

  stepdiag parameters cells/demo.yaml --runtime /tmp/demo
  stepdiag parameters workshop.yaml --hardware --runtime machine
"""

import argparse
import time
from pathlib import Path

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.guard import limits, strict_yaml
from stepdiag_ros.guard.files import read_text

NAME = 'parameters'
HELP = "write the parameter file of a cell's nodes, for ros2 launch"
ENDPOINTS = 'endpoints.yaml'
#: So long a virtual cell that was started just before may take until its instruments listen.
START_S = 10.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('cell', metavar='CELL.yaml', type=Path, help='cell file, e.g. cells/demo.yaml')
    parser.add_argument('--runtime', metavar='DIR', type=Path, required=True,
                        help='folder that the file is written into, and that a virtual cell runs with')
    parser.add_argument('--hardware', action='store_true', help="the file's instruments are real")
    parser.add_argument('--bag-folder', metavar='DIR', type=Path, default=Path('.'),
                        help='where the recorder makes bags (default: here)')


def run(args: argparse.Namespace) -> int:
    from stepdiag_ros.nodes.graph import hardware_endpoints, write_graph
    from stepdiag_ros.virtual.cell import load_cell

    cell = load_cell(args.cell)
    if args.hardware:
        endpoints = hardware_endpoints(cell)
    else:
        file = args.runtime / ENDPOINTS
        end = time.monotonic() + START_S
        while not file.is_file() and time.monotonic() < end:
            time.sleep(0.1)
        if not file.is_file():
            raise StepdiagError(f'{file}: is not there: no virtual cell runs with this folder; start one with '
                                f'python3 -m stepdiag_ros.virtual.cell_process {args.cell} --runtime {args.runtime}, '
                                'or give --hardware')
        endpoints = strict_yaml.load(read_text(file, limits.YAML_BYTES, 'file of addresses'), str(file))
    try:
        graph = write_graph(cell, endpoints, args.runtime, bag_folder=args.bag_folder)
    except OSError as error:
        raise StepdiagError(f'{args.runtime}: cannot be written: {error.strerror}') from None
    print(graph.parameters_file)
    return 0
