"""What runs, made of what the nodes say of themselves: lights with their queues, machines, troubles.

`stepdiag watch` shows it in the terminal and `stepdiag web` on a page.  No ROS in here: plain values in and out.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

#: A node that has said nothing for so long is silent, and one that has for so long is not shown any more.
SILENT_S, GONE_S = 5.0, 60.0
MULTIPLEXER, SEQUENCER = 'multiplexer', 'step_sequencer'


@dataclass(frozen=True)
class Said:
    """What a node said of itself last: how long ago [s], whether it is well, one phrase, values by name."""

    age_s: float
    well: bool
    message: str
    values: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Light:
    """One shared laser: who has it (empty: nobody), for how long of how long expected, who waits how long [s]."""

    name: str
    holder: str
    held_s: float
    expected_s: float
    queue: tuple[tuple[str, str], ...]
    used_s: float
    grants: int
    idle_share: float


@dataclass(frozen=True)
class MachineSeen:
    """One machine: whether it is being calibrated, how far it is, and what it does in one phrase."""

    name: str
    under_way: bool
    stop: int
    stops: int
    left_s: float
    doing: str


@dataclass(frozen=True)
class Trouble:
    """A node that is unwell or silent, and what is wrong."""

    node: str
    text: str


@dataclass(frozen=True)
class Overview:
    """All that runs, each sorted by name."""

    lights: tuple[Light, ...]
    machines: tuple[MachineSeen, ...]
    troubles: tuple[Trouble, ...]


def overview(said: Mapping[str, Said]) -> Overview:
    """Sort what the nodes (``/namespace/node``) said."""
    known = {name: word for name, word in sorted(said.items()) if word.age_s < GONE_S}

    def of(node: str) -> list[tuple[str, Said]]:
        return [(name.rpartition('/')[0], word) for name, word in known.items() if name.endswith(f'/{node}')]
    troubles = [Trouble(name, f'silent for {word.age_s:.0f} s' if word.age_s > SILENT_S else word.message)
                for name, word in known.items() if word.age_s > SILENT_S or not word.well]
    return Overview(tuple(_light(*one) for one in of(MULTIPLEXER)), tuple(_machine(*one) for one in of(SEQUENCER)),
                    tuple(troubles))


def _light(space: str, word: Said) -> Light:
    values = word.values
    return Light(space, values.get('holder', ''), _number(values, 'held_for_s'), _number(values, 'expected_s'),
                 tuple(zip(values.get('queue', '').split(), values.get('waits_s', '').split(), strict=False)),
                 _number(values, 'held_s'), int(_number(values, 'grants')), _number(values, 'idle_share'))


def _machine(space: str, word: Said) -> MachineSeen:
    stop, stops = int(_number(word.values, 'stop')), int(_number(word.values, 'stops'))
    return MachineSeen(space, word.values.get('goal') == 'under way' and stops > 0, stop, stops,
                       _number(word.values, 'time_left_s'), word.message)


def _number(values: Mapping[str, str], key: str) -> float:
    try:
        number = float(values.get(key, 0.0))
    except ValueError:
        return 0.0
    return number if abs(number) < 1e15 else 0.0    # neither NaN nor infinite
