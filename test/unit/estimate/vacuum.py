"""A small virtual cell whose interferometer reports vacuum lengths, with everything known that can be."""

import re
from dataclasses import replace
from pathlib import Path

from stepdiag_ros.virtual.cell import parse_cell
from stepdiag_ros.virtual.offline import simulate_log

DEMO = (Path(__file__).resolve().parents[3] / 'cells' / 'demo.yaml').read_text(encoding='utf-8')
KNOWN = """
material:
  scales:
    x: {expansion: 1.15e-5, sigma: 1.0e-6}
    y: {expansion: 1.15e-5, sigma: 1.0e-6}
    z: {expansion: 8.0e-6, sigma: 1.0e-6}
budget:
  - {name: detector zero, kind: psd_zero, type: B, value: 1.0e-6, unit: m}
"""
AIR = ('  sigma: {temperature: 0.5, pressure: 100.0, humidity: 0.1}\n'
       '  sensors: [temperature, pressure, humidity, scale]\n'
       '  scale_temperature: [22.0, 22.5, 23.0]\n  period: 1.0')


def cell(*changes, seed=20):
    """The cell, with ``(old, new)`` texts replaced in its file."""
    text = re.sub(r'steps: 4 ', 'steps: 3 ', DEMO).replace('seed: 20 ', f'seed: {seed} ')
    text = text.replace('compensated: true', 'compensated: false').replace('  period: 1.0', AIR) + KNOWN
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    return parse_cell(text)


def log_of(of):
    return simulate_log(of, rate=100.0, in_motion=False)


def without_topics(log, *names):
    """The log without these environment topics; without any where none is named."""
    return replace(log, environment={k: v for k, v in log.environment.items() if names and k not in names})


def describing(log, **changes):
    """The log with another cell description."""
    return replace(log, description=replace(log.description, **changes))
