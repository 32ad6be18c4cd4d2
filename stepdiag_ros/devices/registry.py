"""Drivers of instruments by name: those that come along, and those that an installed package registers.

A driver is a function that takes settings by name, as the node of its instrument has them, and gives a client as
:mod:`~stepdiag_ros.devices.base` describes, not connected.  A package registers it as an entry point of the
instrument's group.
"""

from collections.abc import Callable, Mapping
from importlib import metadata
from typing import Any

from stepdiag_ros.errors import StepdiagError

GROUPS = {'interferometer': 'stepdiag_ros.interferometers', 'psd': 'stepdiag_ros.position_sensors',
          'cnc': 'stepdiag_ros.controls'}
"""Group of entry points by the instrument's key in a cell file."""
SHIPPED = {'interferometer': {'ids3010': 'stepdiag_ros.devices.ids3010:from_settings'},
           'psd': {'modbus': 'stepdiag_ros.devices.modbus_psd:from_settings'},
           'cnc': {'linuxcnc_rsh': 'stepdiag_ros.devices.linuxcnc_rsh:from_settings'}}
"""What comes along, registered by the package's own setup too; here for a source tree that is not installed."""
DEFAULT = {instrument: next(iter(drivers)) for instrument, drivers in SHIPPED.items()}

Driver = Callable[[Mapping[str, Any]], Any]


def drivers(instrument: str) -> dict[str, metadata.EntryPoint]:
    """Drivers of ``instrument`` (a key of :data:`GROUPS`) by name; nothing is imported."""
    group = GROUPS[instrument]
    found = {entry.name: entry for entry in metadata.entry_points(group=group)}
    # A name that comes along means what comes along, whatever else is installed.
    return found | {name: metadata.EntryPoint(name, where, group) for name, where in SHIPPED[instrument].items()}


def check(instrument: str, name: str, where: str) -> str:
    """``name``; raises :class:`~stepdiag_ros.errors.StepdiagError`, naming ``where`` it stands, for one not known."""
    known = drivers(instrument)
    if name not in known:
        raise StepdiagError(f'{where} is {name!r}; there is no such driver, known are {", ".join(sorted(known))} '
                            f'(a package of your own registers one in {GROUPS[instrument]})')
    return name


def driver(instrument: str, name: str, where: str) -> Driver:
    """The driver of this name, imported."""
    entry = drivers(instrument)[check(instrument, name, where)]
    try:
        found = entry.load()
    except (ImportError, AttributeError) as error:
        if name in SHIPPED[instrument]:
            raise
        raise StepdiagError(f'{where} is {name!r}, whose code {entry.value} cannot be loaded: {error}; mend or '
                            'reinstall the package that registers it') from None
    if not callable(found):
        raise StepdiagError(f'{where} is {name!r}, and {entry.value} is no function; register one that takes settings')
    return found
