"""Faults on request: what instruments do on a bad day.

A cell file may name them under ``faults: {psd: {kind: stall}}``; while a cell runs they are
injected and taken back by :func:`inject` and :func:`clear`, which write a small file in the
runtime directory.

==============  ==============================================================
``drop``        the connection is closed at the next request
``nonsense``    the answer is not in the protocol
``stall``       requests are read and never answered
``no_signal``   the light is gone: quality 0, a dark detector
==============  ==============================================================
"""

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.virtual.serving import FAULT_FILE, write_atomically

KINDS = ('drop', 'nonsense', 'stall', 'no_signal')
INSTRUMENTS = ('interferometer', 'psd', 'cnc')
_LOOK_S = 0.01


def inject(runtime: Path, instrument: str, kind: str) -> None:
    """From now on ``instrument`` has the fault ``kind``."""
    current = _read(runtime / FAULT_FILE)
    current[instrument] = {'kind': _checked(instrument, kind)}
    write_atomically(runtime / FAULT_FILE, yaml.safe_dump(current))


def clear(runtime: Path, instrument: str) -> None:
    """``instrument`` works again."""
    current = _read(runtime / FAULT_FILE)
    current[instrument] = {'kind': None}
    write_atomically(runtime / FAULT_FILE, yaml.safe_dump(current))


def _checked(instrument: str, kind: str) -> str:
    if instrument not in INSTRUMENTS or kind not in KINDS:
        raise StepdiagError(f'no fault {kind!r} of {instrument!r}; instruments are '
                            f'{", ".join(INSTRUMENTS)}, faults {", ".join(KINDS)}')
    return kind


def _read(path: Path) -> dict[str, Any]:
    try:
        return yaml.safe_load(path.read_text(encoding='utf-8')) or {}
    except FileNotFoundError:
        return {}


class Faults:
    """What ails one instrument now."""

    def __init__(self, runtime: Path, instrument: str, from_cell: Mapping[str, Mapping[str, Any]]):
        self._path = runtime / FAULT_FILE
        self._instrument = instrument
        given = from_cell.get(instrument, {}).get('kind')
        self._kind = _checked(instrument, given) if given is not None else None
        self._stamp = 0
        self._next_look = 0.0

    @property
    def kind(self) -> str | None:
        now = time.monotonic()
        if now >= self._next_look:
            self._next_look = now + _LOOK_S
            try:
                stamp = self._path.stat().st_mtime_ns
            except FileNotFoundError:
                stamp = 0
            if stamp and stamp != self._stamp:
                self._stamp = stamp
                entry = _read(self._path).get(self._instrument)
                if entry is not None:
                    self._kind = entry.get('kind')
        return self._kind
