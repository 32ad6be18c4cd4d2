"""What stepdiag adds to a LinuxCNC control.

  sudo stepdiag linuxcnc install                 builds and installs the two components (halcompile)
  stepdiag linuxcnc watch ~/linuxcnc/configs/mill    the machine stops when its remote client dies or is cut off
  stepdiag linuxcnc unwatch ~/linuxcnc/configs/mill  takes that out again

The components: stepdiagkins, kinematics with the 21 geometric errors, and stepdiagwatch, which stops a move
whose remote client has been silent for a quarter of a second.  `stepdiag improve` writes the compensation.
"""

import argparse
from pathlib import Path

from stepdiag_ros.errors import StepdiagError

NAME = 'linuxcnc'
HELP = 'install the components for LinuxCNC, add the watchdog to a configuration'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    tasks = parser.add_subparsers(dest='task', metavar='TASK', required=True)
    tasks.add_parser('install', help='build and install the components; needs linuxcnc-uspace-dev')
    for name, text in (('watch', 'add the watchdog of the remote client to a configuration'),
                       ('unwatch', 'take the watchdog out again')):
        task = tasks.add_parser(name, help=text)
        task.add_argument('folder', metavar='FOLDER', type=Path, help='folder with the INI file')
        if name == 'watch':
            task.add_argument('--host', default='127.0.0.1', help='address on which signs of life are taken')
            task.add_argument('--port', type=int, default=5008, help='TCP port for them (default: 5008)')


def run(args: argparse.Namespace) -> int:
    from stepdiag_ros.linuxcnc import configuration, install

    if args.task == 'install':
        for path in install.install():
            print(f'installed {path}')
        return 0
    ini, text = configuration.read_ini(args.folder)
    if args.task == 'unwatch':
        configuration.write(args.folder, configuration.renamed(configuration.unwatched(text), ini.name))
        print(f'{ini}: the watchdog is out; restart LinuxCNC')
        return 0
    if not install.installed('stepdiagwatch'):
        raise StepdiagError('stepdiagwatch is not installed; run: sudo stepdiag linuxcnc install')
    configuration.write(args.folder, configuration.renamed(
        configuration.watched(text, args.port, args.host), ini.name))
    print(f'{ini}: a move stops {configuration.SILENCE_S:g} s after the last sign of life of its remote client, and '
          f'what braking takes; restart LinuxCNC and put watch_port: {args.port} into instruments.cnc of the cell file')
    return 0
