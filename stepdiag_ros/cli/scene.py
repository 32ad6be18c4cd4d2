"""Draw a setup of a cell: machine volume, path, mirror at the stops and the traced beams.

The cell's own geometric errors and misalignments are in the beams, at true scale.

  stepdiag scene cells/demo.yaml --out scene.png
  stepdiag scene cells/demo.yaml --setup npp --out scene.svg
  stepdiag scene cells/demo.yaml --setup all --out scenes.png
"""

import argparse
from pathlib import Path

import numpy as np

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.model.machine import tool_pose
from stepdiag_ros.model.path import stops
from stepdiag_ros.report.scene_figure import SetupScene, draw_scene
from stepdiag_ros.virtual.acting import allow_effect_files
from stepdiag_ros.virtual.cell import Cell, load_cell
from stepdiag_ros.virtual.scene import SensorScene

NAME = 'scene'
HELP = 'draw the beams, the mirror and the path of a cell'
FORMATS = ('.png', '.svg', '.pdf')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('cell', metavar='CELL.yaml', help='a cell file such as cells/demo.yaml')
    parser.add_argument('--out', metavar='FILE', type=Path, required=True,
                        help=f'picture to write ({", ".join(FORMATS)})')
    parser.add_argument('--effect', metavar='FILE.py', action='append', default=[],
                        help='let the cell file name this Python file with an effect of your own; it is run, so '
                             'give only files that you trust')
    parser.add_argument('--setup', metavar='NAME', help="a setup of the cell, or 'all' (default: the first)")


def run(args: argparse.Namespace) -> int:
    allow_effect_files(args.effect)
    cell = load_cell(args.cell)
    if args.out.suffix.lower() not in FORMATS:
        raise StepdiagError(f'--out {args.out}: unknown kind of picture; end the name in {" or ".join(FORMATS)}')
    if args.setup not in (None, 'all', *cell.setup_names):
        raise StepdiagError(f'{args.cell}: no setup {args.setup!r}; '
                            f'choose one of {", ".join(cell.setup_names)}, or all')
    mirrors = tuple(name for name, setup in cell.description.setups.items() if not setup.follows)
    if not mirrors or args.setup not in (None, 'all', *mirrors):
        raise StepdiagError(f'{args.cell}: {args.setup or "every setup"} has a station whose beam follows a '
                            f'retroreflector; drawn are setups with a mirror: {", ".join(mirrors) or "none is here"}')
    chosen = mirrors if args.setup == 'all' else (args.setup or mirrors[0],)
    try:
        draw_scene([traced(cell, name) for name in chosen], args.out)
    except OSError as error:
        raise StepdiagError(f'--out {args.out}: cannot be written: {error.strerror}') from None
    print(f'picture: {args.out}')
    return 0


def traced(cell: Cell, name: str) -> SetupScene:
    """One setup of a cell with its beams traced to the mirror at every stop."""
    machine, path = cell.description.machine, stops(cell.description, name)
    point, attitude = tool_pose(cell.geometry, path.positions, np.array(machine.tool), machine.chain)
    sensor, off = SensorScene.from_description(cell.description, name), cell.misalignments[name]
    lines = sensor.beam_lines(point, attitude, beam_tilt=off.laser, mirror_tilt=off.mirror)
    return SetupScene(name, machine.name, np.array(machine.volume), np.array(machine.tool), point, path.axis,
                      sensor.triad, sensor.origin, lines[:len(sensor.beams)], lines[-1])
