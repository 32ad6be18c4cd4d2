"""Small virtual cells with one effect each, and what the diagnosis makes of them."""

import pickle
import sys
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from pathlib import Path

import pytest
import yaml

from stepdiag_ros.effects import effect_class
from stepdiag_ros.effects.base import Effect
from stepdiag_ros.gap.diagnose import diagnose
from stepdiag_ros.gap.diagnosis import Diagnosis
from stepdiag_ros.model.log import CalibrationLog
from stepdiag_ros.virtual.cell import Cell, parse_cell
from stepdiag_ros.virtual.offline import simulate_log

DEMO = Path(__file__).resolve().parents[2] / 'cells' / 'demo.yaml'


def times_left(notes: Sequence[str]) -> float:
    """How many times its noise an adopted simulator leaves of its log, by what it says."""
    said = next(note for note in notes if note.startswith('run along'))
    return float(said.split('leaves ')[1].split(' ')[0])


def small_cell(effects: dict, dwell: float = 0.1) -> Cell:
    """The demo's machine, at rest only, twenty samples a stop of ``dwell`` seconds."""
    text = yaml.safe_load(DEMO.read_text(encoding='utf-8'))
    text['sampling'] |= {'interferometer': 20.0 / dwell, 'psd': 20.0 / dwell, 'in_motion': False}
    text['motion'] |= {'dwell': dwell, 'mount': 20.0}
    text['effects'] = effects
    return parse_cell(yaml.safe_dump(text, sort_keys=False), str(DEMO))


@lru_cache(maxsize=16)
def _diagnosed(name: str, values: str, looked_for: tuple[str, ...], dwell: float) -> Diagnosis:
    log = simulate_log(small_cell({name: yaml.safe_load(values)} if name else {}, dwell))
    return diagnose(log, [effect_class(n)() for n in looked_for])


@pytest.fixture(scope='session')
def diagnosed() -> Callable[..., Diagnosis]:
    """``diagnosed(name, values, looked_for, dwell)``: an effect acts (none: ``''``), some are looked for."""
    def run(name: str, values: dict | None = None, looked_for: tuple[str, ...] | None = None,
            dwell: float = 0.1) -> Diagnosis:
        looked_for = looked_for or ((name,) if name else ('backlash',))
        return _diagnosed(name, yaml.safe_dump(values or {}), looked_for, dwell)
    return run


@pytest.fixture(scope='module')
def diagnosed_once() -> Iterator[None]:
    """What the commands diagnose more than once in a module, against the same effects, is computed once: the answer
    follows from log and effects alone."""
    found: dict[bytes, Diagnosis] = {}

    def once(log: CalibrationLog, effects: list[Effect]) -> Diagnosis:
        key = pickle.dumps((log, [(type(effect).__module__, type(effect).__qualname__, vars(effect))
                                  for effect in effects]))
        if key not in found:
            found[key] = diagnose(log, effects)
        return found[key]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys.modules[diagnose.__module__], 'diagnose', once)
        yield
