"""The hall file: many cells, one source of light.

It names cell files and what is different in the hall (name, seed); see docs/reference/hall_file.md.  Each machine gets
a cell file of its own in the runtime directory, as it would be written by hand, and the source one too.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.guard import limits, strict_yaml
from stepdiag_ros.guard.files import read_text
from stepdiag_ros.virtual.cell import SCHEMA, Endpoint, load_cell
from stepdiag_ros.virtual.yamlreader import Reader, read_yaml

CELL_FILE = 'cell.yaml'
KEYS = ('schema', 'name', 'machines', 'laser', 'switch', 'lease')
MOST = 64


@dataclass(frozen=True)
class HallMachine:
    """One machine of a hall: its cell file and its name, seed (``None``: the cell's) and priority in the hall."""

    cell: Path
    name: str
    seed: int | None
    priority: int


@dataclass(frozen=True)
class HallFile:
    """A hall: name, machines in the order of the switch's channels, addresses of laser and switch, lease [s]."""

    source: str
    name: str
    machines: tuple[HallMachine, ...]
    laser: Endpoint
    switch: Endpoint
    lease_s: float


def load_hall(path: str | Path) -> HallFile:
    """Read a hall file and every cell file that it names; :class:`StepdiagError` names file, line and key."""
    top = read_yaml(path)
    keys = top.mapping(KEYS)
    if 'schema' in keys and keys['schema'].count() != SCHEMA:
        raise keys['schema'].fail(f'must be {SCHEMA} for this version')
    if 'machines' not in keys or not keys['machines'].items():
        raise top.fail("the key 'machines' is missing or empty; name the machines' cell files as in cells/hall.yaml")
    items = keys['machines'].items()
    if len(items) > MOST:
        raise keys['machines'].fail(f'has {len(items)} machines; a switch has at most {MOST} channels')
    name = keys['name'].text() if 'name' in keys else 'hall'
    machines: list[HallMachine] = []
    for item in items:
        machine = _machine(item)
        if machine.name in [other.name for other in machines] or machine.name == name:
            raise item.fail(f'is called {machine.name!r} as another or the hall itself; give each a name of its own')
        machines.append(machine)
    return HallFile(str(path), name, tuple(machines), _endpoint(keys.get('laser')), _endpoint(keys.get('switch')),
                    keys['lease'].number(minimum=0.5, maximum=3600.0, unit='s') if 'lease' in keys else 5.0)


def _machine(item: Reader) -> HallMachine:
    keys = item.mapping(('cell', 'name', 'seed', 'priority'))
    if 'cell' not in keys:
        raise item.fail("the key 'cell' is missing; name a cell file")
    file = Path(item.source).parent / keys['cell'].text()
    try:
        cell = load_cell(file)
    except StepdiagError as error:
        raise keys['cell'].fail(f'cannot be used: {error}') from None
    if cell.instruments.multiplexer:
        raise keys['cell'].fail('has a multiplexer itself; in a hall the switch is the hall file\'s')
    name = keys['name'].text() if 'name' in keys else cell.description.machine.name
    if not name.isidentifier() or not name.isascii() or len(name) > limits.NAME_LETTERS:
        raise (keys.get('name') or item).fail(f'is called {name!r}; give a name of letters, digits and _')
    return HallMachine(file, name, keys['seed'].count() if 'seed' in keys else None,
                       keys['priority'].count(0, 255) if 'priority' in keys else 0)


def _endpoint(node: Reader | None) -> Endpoint:
    if node is None or node.is_null:
        return Endpoint()
    keys = node.mapping(('host', 'port'))
    return Endpoint(keys['host'].text() if 'host' in keys else Endpoint.host,
                    keys['port'].count(0, 65535) if 'port' in keys else 0)


def write_cells(hall: HallFile, runtime: Path) -> tuple[Path, dict[str, Path]]:
    """Write the cell file of the source and of each machine below ``runtime``; their paths."""
    files = {}
    for machine in hall.machines:
        content = _content(machine)
        files[machine.name] = _write(runtime / machine.name / CELL_FILE, content)
    first, *others = hall.machines
    source = _content(first)
    instruments = source['instruments'] = source.get('instruments') or {}
    laser = instruments.get('interferometer') or {}
    laser |= {'host': hall.laser.host, 'port': hall.laser.port, 'multiplexer': {
        'host': hall.switch.host, 'port': hall.switch.port,
        'machines': [f'{machine.name}/{CELL_FILE}' for machine in others]}}
    instruments['interferometer'] = laser
    return _write(runtime / CELL_FILE, source), files


def _content(machine: HallMachine) -> dict[str, Any]:
    content = strict_yaml.load(read_text(machine.cell, limits.YAML_BYTES, 'cell file'), str(machine.cell))
    content['machine'] = content['machine'] | {'name': machine.name}
    # What the cell names relative to its own file is to be found from the folder of the machine, too.
    control = (content.get('instruments') or {}).get('cnc') or {}
    named = [(effect, 'file') for effect in (content.get('effects') or {}).values() if effect]
    for keys, key in (*named, (control, 'config')):
        if keys.get(key):
            keys[key] = str(machine.cell.absolute().parent / keys[key])
    return content if machine.seed is None else content | {'seed': machine.seed}


def _write(path: Path, content: dict[str, Any]) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(yaml.safe_dump(content, sort_keys=False, allow_unicode=True), encoding='utf-8')
    return path
