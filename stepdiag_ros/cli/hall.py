"""Start many cells that share one laser, and watch over them until Ctrl-C.

HALL.yaml names cell files, see cells/hall.yaml.  Every machine gets its own namespace, bag and evaluation; a
multiplexer gives the laser to one after another.  A machine that cannot be kept alive is given up, the others go on.

  stepdiag hall cells/hall.yaml
  stepdiag calibrate --all          (in another terminal)
"""

import argparse
import signal
import time
from pathlib import Path

from stepdiag_ros.guard.show import escaped
from stepdiag_ros.virtual.hall import load_hall

NAME = 'hall'
HELP = 'start many cells that share one laser, and watch over them until Ctrl-C'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    from stepdiag_ros.nodes.bringup import add_most
    parser.add_argument('hall', type=Path, metavar='HALL.yaml', help='hall file, e.g. cells/hall.yaml')
    parser.add_argument('--hardware', action='store_true',
                        help="start no virtual cells: the files' instruments are real")
    parser.add_argument('--bag-folder', type=Path, default=Path('.'), help='where bags are made (default: here)')
    parser.add_argument('--runtime', type=Path, metavar='DIR',
                        help='directory for logs and parameters, a folder a machine (default: a temporary one)')
    add_most(parser, sharing=True)
    parser.add_argument('--effect', metavar='FILE.py', action='append', default=[],
                        help='let the cell files name this Python file with an effect of your own; it is run, so '
                             'give only files that you trust')


def run(args: argparse.Namespace) -> int:
    from stepdiag_ros.nodes.bringup import refuse_too_many
    from stepdiag_ros.nodes.hall import Hall
    from stepdiag_ros.virtual.acting import allow_effect_files
    allow_effect_files(args.effect)
    refuse_too_many(len(load_hall(args.hall).machines), args.most, str(args.hall))
    asked: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda got, _frame: asked.append(got))

    def say(text: str) -> None:
        print(escaped(f'stepdiag: {text}'), flush=True)

    with Hall(args.hall, hardware=args.hardware, bag_folder=args.bag_folder, runtime=args.runtime, say=say) as hall:
        say(f'{len(hall.machines)} machines are up; calibrate them with: stepdiag calibrate --all   (Ctrl-C ends)')
        while not asked:
            hall.watch()
            time.sleep(0.2)
        say('ending')
    say('all processes have ended')
    return 1 if hall.lost else 0
