"""Show in the terminal what runs: who has the laser's light, who waits, and how far each machine is.

Only reads: it takes what the nodes say of themselves once a second (/diagnostics), and commands nothing.
Ctrl-C ends it.

  stepdiag watch
  stepdiag watch --once      (one look, for a file or a pipe)
"""

import argparse
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass, field

from stepdiag_ros.cli.progress import drawn
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.guard.show import escaped

NAME = 'watch'
WIDTH = 20
HELP = "show who has the laser's light and how far each machine is"
#: A node that has said nothing for so long is silent, and one that has for so long is not shown any more.
SILENT_S, GONE_S = 5.0, 60.0
FIRST_LOOK_S = 3.0


@dataclass(frozen=True)
class Said:
    """What a node said of itself last: how long ago [s], whether it is well, one phrase, values by name."""

    age_s: float
    well: bool
    message: str
    values: Mapping[str, str] = field(default_factory=dict)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('--once', action='store_true', help='look once and end')


def run(args: argparse.Namespace) -> int:
    from stepdiag_ros.nodes.operator import Operator
    drawn = 0
    with Operator('') as operator:
        time.sleep(FIRST_LOOK_S)
        while True:
            lines = screen({name: Said(age_s, status.level == b'\x00', status.message,
                                       {v.key: v.value for v in status.values})
                            for name, (age_s, status) in operator.healths().items()})
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
    """The lines to show, from what the nodes (``/namespace/node``) said: lasers first, then machines, then troubles."""
    known = {name: word for name, word in said.items() if word.age_s < GONE_S}
    lines = []
    for name, word in sorted(known.items()):
        if name.endswith('/multiplexer'):
            lines += _light(name.rpartition('/')[0], word)
    for name, word in sorted(known.items()):
        if name.endswith('/step_sequencer'):
            lines.append(_machine(name.rpartition('/')[0], word))
    for name, word in sorted(known.items()):
        if word.age_s > SILENT_S:
            lines.append(f'  {name}: silent for {word.age_s:.0f} s')
        elif not word.well:
            lines.append(f'  {name}: {word.message}')
    return lines


def _light(space: str, word: Said) -> list[str]:
    values = word.values
    holder = values.get('holder')
    if holder:
        has = f'{holder} has the light for {_number(values, "held_for_s"):.0f} of about ' \
              f'{_number(values, "expected_s"):.0f} s'
    else:
        has = 'nobody has the light'
    waits = [f'{name} ~{wait} s' for name, wait in
             zip(values.get('queue', '').split(), values.get('waits_s', '').split(), strict=False)]
    lines = [f'{space}: {has}', f'  waiting: {", ".join(waits) or "nobody"}']
    if _number(values, 'grants'):
        lines.append(f'  used {_number(values, "held_s"):.0f} s in {_number(values, "grants"):.0f} grants, idle though '
                     f'wanted {100.0 * _number(values, "idle_share"):.1f} %')
    return lines


def _machine(space: str, word: Said) -> str:
    done, total = _number(word.values, 'stop'), _number(word.values, 'stops')
    if word.values.get('goal') != 'under way' or not total:
        return f'{space}: {word.message}'
    return (f'{space}: {drawn(done, total, WIDTH)} stops, about '
            f'{_number(word.values, "time_left_s"):.0f} s of measuring left: {word.message}')


def _number(values: Mapping[str, str], key: str) -> float:
    try:
        return float(values.get(key, 0.0))
    except ValueError:
        return 0.0
