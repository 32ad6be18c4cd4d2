"""What the pages about the papers share: tables, pictures that come out alike, the traced sensor."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.readings import Sight, sight_of
from stepdiag_ros.model.description import LINEAR, Description, Machine, Plan, Setup
from stepdiag_ros.model.machine import CURVES, Curve, GeometricErrors
from stepdiag_ros.model.optics import Body, Plane, Scene
from stepdiag_ros.model.rays import components, stacked
from stepdiag_ros.model.sensor import Misalignment, turned

TRUE, CONVENTIONAL, ENHANCED, RED, GREEN = '#222222', '#d1495b', '#2e9e6b', '#c0392b', '#1f8a4c'


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = ['| ' + ' | '.join(head) + ' |', '|' + '---|' * len(head)]
    lines += ['| ' + ' | '.join(row) + ' |' for row in rows]
    return '\n'.join(lines) + '\n'


def save(figure: Figure, out: Path, name: str) -> str:
    """Write a picture and return its Markdown link."""
    path = out / name
    try:
        out.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=100, metadata={'Software': None})
    except OSError as error:
        raise StepdiagError(f'{path}: the picture cannot be written: {error}') from None
    return f'![{Path(name).stem.replace("_", " ")}]({name})\n'


def small(value: float, unit: str, limit: float = 1e-12) -> str:
    """A deviation for a table: below ``limit`` only that is stated, rounding differs between machines."""
    return f'< {limit:g} {unit}' if value < limit else f'{value:.2e} {unit}'


def slopes(machine: Machine, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> GeometricErrors:
    """A machine whose axes over-travel by x, y, z [m/m]."""
    return GeometricErrors({f'E{a}{a}': Curve(np.array([0.0, length]), np.array([0.0, s * length]))
                            for a, length, s in zip('XYZ', machine.volume, (x, y, z), strict=True)}, {})


def drawn_machine(machine: Machine, steps: int, seed: int = 18, angles: bool = True) -> GeometricErrors:
    """Smooth error curves of some micrometres and tens of microradians, three squareness errors.

    EYX, EZX and EZY begin and end at zero: the frame is that of the machine's own lines.
    """
    rng = np.random.default_rng(seed)
    curves = {}
    for name in CURVES:
        length = machine.volume['XYZ'.index(name[2])]
        part = np.linspace(0.0, 1.0, steps + 1)
        value = sum(rng.normal(0.0, 1.0 / k) * np.sin(np.pi * k * part + (rng.uniform(0, np.pi) if k > 1 else 0.0))
                    for k in (1, 2, 3, 5))
        value = value + rng.normal() * part
        value = value - value[0]
        if name in ('EYX', 'EZX', 'EZY'):
            value = value - value[-1] * part
        if name[1] in 'XYZ' or angles:
            curves[name] = Curve(length * part, value * (3e-6 if name[1] in 'XYZ' else 1e-5))
    return GeometricErrors(curves, {'EC0Y': 15e-6, 'EB0Z': -22e-6, 'EA0Z': 9e-6})


BEAMS = ((0.0, 0.0), (0.03, 0.0), (0.0, 0.03))
"""Three beams (layout a); layout b uses the first and the PSD."""


def step_sights(machine: Machine, steps: int, names: Sequence[str]) -> list[Sight]:
    """Step diagonals and linear setups of two stops, as the contract lays them."""
    setups = {}
    for name in names:
        length = machine.volume['xyz'.index(name[-1])] if name in LINEAR else None
        setups[name] = Setup(name, 0.35, (0.02, 0.01), BEAMS, length, 2 if length else None)
    description = Description(machine, Plan(steps, 'XYZ', 1), setups)
    return [sight_of(description, name) for name in names]


def traced(sight: Sight, machine: Machine, misalignment: Misalignment, point: np.ndarray,
           attitude: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The contract's sensor by ray tracing: distances (n, beams), spots (n, 2) [m].

    The closed forms of :mod:`stepdiag_ros.model.sensor` are used for no distance and no spot.
    """
    triad, origin = sight.triad, sight.origin(machine.tool)
    beam = components(turned(triad, misalignment.laser))
    mirror = Plane(components(point), components(attitude @ -turned(triad, misalignment.mirror)))
    scene = Scene((Body.mirror('mirror', mirror),
                   Body.detector('detector', Plane(components(origin), components(triad[2])))))
    lengths = []
    for offset in sight.beams:
        start = components(origin + np.array(offset) @ triad[:2])
        lengths.append(scene.trace(scene.find_path(start, beam)[:1], start, beam).optical_path[0])
    begin = origin + np.array(sight.psd_offset) @ triad[:2]
    start = components(begin)
    home = stacked(scene.trace(scene.find_path(start, beam), start, beam).points[-1])
    return np.stack(lengths, axis=-1), (home - begin) @ triad[:2].T
