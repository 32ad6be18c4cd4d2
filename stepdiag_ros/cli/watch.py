"""Show in the terminal what runs: who has the laser's light, who waits, and how far each machine is.

Only reads: it takes what the nodes say of themselves once a second (/diagnostics), and commands nothing.
Ctrl-C ends it.  ``stepdiag web`` shows the same and more on a page.

  stepdiag watch
  stepdiag watch --once      (one look, for a file or a pipe)
"""

import argparse
import sys
import time
from collections.abc import Mapping

from stepdiag_ros.cli.progress import drawn
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.guard.show import escaped
from stepdiag_ros.nodes.overview import Light, MachineSeen, Overview, Said, overview

NAME = 'watch'
HELP = "show who has the laser's light and how far each machine is"
WIDTH = 20
FIRST_LOOK_S, SILENT_S = 3.0, 10.0
"""Nodes speak once a second; those that are there and have not spoken are waited for so much longer."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('--once', action='store_true', help='look once and end')


def run(args: argparse.Namespace) -> int:
    from stepdiag_ros.nodes.observer import Observer
    from stepdiag_ros.nodes.patience import Patience
    drawn = 0
    with Observer(detail=False) as observer:
        time.sleep(FIRST_LOOK_S)
        Patience(SILENT_S).until(lambda: not observer.silent())
        while True:
            lines = lines_of(observer.overview())
            if args.once:
                if not lines:
                    raise StepdiagError('no node says anything; start a cell or a hall first')
                print('\n'.join(map(escaped, lines)))
                return 0
            drawn = _draw(lines or ['nothing runs'], drawn)
            try:
                time.sleep(1.0)
            except KeyboardInterrupt:
                return 0


def _draw(lines: list[str], drawn: int) -> int:
    control = getattr(sys.stdout, 'control', sys.stdout.write)
    if drawn:
        control(f'\x1b[{drawn}A\x1b[J')
    for line in lines:
        sys.stdout.write(escaped(line) + '\n')
    sys.stdout.flush()
    return len(lines)


def screen(said: Mapping[str, Said]) -> list[str]:
    """The lines to show, from what the nodes (``/namespace/node``) said."""
    return lines_of(overview(said))


def lines_of(seen: Overview) -> list[str]:
    """The lines to show: lasers first, then machines, then troubles."""
    return [*(line for light in seen.lights for line in _light(light)), *map(_machine, seen.machines),
            *(f'  {trouble.node}: {trouble.text}' for trouble in seen.troubles)]


def _light(light: Light) -> list[str]:
    has = 'nobody has the light' if not light.holder else \
        f'{light.holder} has the light for {light.held_s:.0f} of about {light.expected_s:.0f} s'
    waits = ', '.join(f'{name} ~{wait} s' for name, wait in light.queue)
    lines = [f'{light.name}: {has}', f'  waiting: {waits or "nobody"}']
    if light.grants:
        lines.append(f'  used {light.used_s:.0f} s in {light.grants} grants, idle though wanted '
                     f'{100.0 * light.idle_share:.1f} %')
    return lines


def _machine(machine: MachineSeen) -> str:
    if not machine.under_way:
        return f'{machine.name}: {machine.doing}'
    return (f'{machine.name}: {drawn(machine.stop, machine.stops, WIDTH)} stops, about '
            f'{machine.left_s:.0f} s of measuring left: {machine.doing}')
