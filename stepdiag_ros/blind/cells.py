"""Machines, plans, set-ups and conditions of the sealed world.

Two kinds: ``varied`` draws everything, ``field`` keeps to the plan of the usual log (four
diagonals of eight steps, three linear runs of two stops, two repeats, FXYZ, 50 Hz).
"""

from dataclasses import dataclass, replace

import numpy as np

from stepdiag_ros.model.description import (
    DIAGONALS,
    LINEAR,
    Description,
    Machine,
    Noise,
    Plan,
    Setup,
)
from stepdiag_ros.model.machine import AXES, CURVES, Curve, GeometricErrors
from stepdiag_ros.model.sensor import Misalignment
from stepdiag_ros.virtual.cell import Air, Cell, Detector, Instruments, Motion, Sampling
from stepdiag_ros.virtual.noise import NoiseLaw, NoiseLaws, Spread

KINDS = ('varied', 'field')
CHAINS = ('XFYZ', 'YFXZ', 'XYFZ', 'FYXZ', 'FZXY')
NAME = 'cell1'
"""All machines have the same name: a name must not tell one log from another."""
IN_POSITION_M = 2e-11
"""The control waits so long that nothing of its own creeping in is left: that would be an effect."""
MOST_WALK_M = 2.5e-3
"""Misalignments are held to spots of this size: beyond, an operator would have aligned better."""


@dataclass(frozen=True)
class Conditions:
    """What a cell file does not say: what the log's maker believes of his noise (the truth times
    ``belief`` (4,)), noise of intensity [V] and quality, start of the log."""

    belief: np.ndarray
    intensity_sigma: float
    quality: float
    quality_sigma: float
    start_ns: int


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def draw_cell(rng: np.random.Generator, kind: str, small: bool = False) -> tuple[Cell, Conditions]:
    """A cell without effects, and the conditions of its log.  ``small``: three steps at 25 Hz."""
    field = kind == 'field'
    longest = rng.uniform(0.4, 1.3) if field else _log_uniform(rng, 0.2, 3.0)
    volume = longest * np.array([1.0, rng.uniform(0.6, 1.0), rng.uniform(0.4, 0.9)])
    if not field:
        volume = rng.permutation(volume)
    volume = tuple(float(v) for v in np.round(volume, 3))
    tool = (0.0, 0.0, -round(rng.uniform(0.05, 0.25), 3))
    if not field and rng.random() < 0.3:
        tool = (round(rng.uniform(-0.1, 0.1), 3), round(rng.uniform(-0.1, 0.1), 3), tool[2])
    chain = 'FXYZ' if field or rng.random() < 0.75 else str(rng.choice(CHAINS))
    machine = Machine(NAME, chain, volume, tool)
    steps = 8 if field else int(rng.integers(5, 13))
    repeats = 2 if field or rng.random() < 0.75 else 3
    if small:
        steps, repeats = 3, 2
    order = 'XYZ' if field or rng.random() < 0.8 else ''.join(rng.permutation(list('XYZ')))
    setups = _setups(rng, field, machine)
    noise = Noise(3e-9 if field else _log_uniform(rng, 2e-9, 2e-8), _log_uniform(rng, 5e-8, 5e-7),
                  _log_uniform(rng, 3e-8, 1e-6), _log_uniform(rng, 3e-8, 5e-7))
    if field:
        noise = Noise(5e-9, 2e-7, 3e-7, 2e-7)
    description = Description(machine, Plan(steps, order, repeats), setups, noise)
    rate = 50.0 if field else float(rng.choice([20.0, 40.0, 50.0, 80.0, 100.0, 200.0],
                                               p=[0.2, 0.2, 0.25, 0.15, 0.15, 0.05]))
    moving = bool(field or rng.random() < 0.6)
    if small:
        rate = 25.0
    motion = Motion(feed=0.4 if small else float(rng.choice([0.1, 0.15, 0.25])), dwell=0.6 if field else round(
        rng.uniform(0.3, 1.0), 2), mount=float(round(rng.uniform(60.0, 600.0))),
        settling=rng.uniform(0.002, 0.008), in_position=IN_POSITION_M)
    cell = Cell(source=NAME, seed=int(rng.integers(1 << 40)), description=description,
                geometry=_geometry(rng, description), misalignments=_misalignments(rng, description),
                psd_zero=dict.fromkeys(setups, (0.0, 0.0)), air=_air(rng), motion=motion,
                instruments=Instruments(detector=Detector(sum_voltage=round(rng.uniform(1.0, 9.0), 2))),
                sampling=Sampling(rate, rate, 1.0, moving))
    conditions = Conditions(np.ones(4) if field else np.exp(np.clip(rng.normal(0.0, 0.3, 4), -0.7, 0.7)),
                            _log_uniform(rng, 2e-4, 4e-3), round(rng.uniform(75.0, 97.0)),
                            rng.uniform(0.0, 1.5),
                            1_700_000_000_000_000_000 + int(rng.integers(60_000_000)) * 1_000_000_000)
    return cell, conditions


def untidy_law(rng: np.random.Generator, noise: Noise) -> NoiseLaws:
    """Noise as instruments have it: tails, correlation, steps, dropouts, spikes, duplicates, late samples."""
    def sensor(sigma: float) -> NoiseLaw:
        return NoiseLaw(
            dof=_log_uniform(rng, 3.0, 10.0) if rng.random() < 0.5 else np.inf,
            correlation=float(rng.uniform(0.2, 0.8)) if rng.random() < 0.4 else 0.0,
            quantum=float(sigma * rng.uniform(0.3, 2.0)) if rng.random() < 0.4 else 0.0,
            dropouts=_log_uniform(rng, 0.005, 0.1) if rng.random() < 0.4 else 0.0, burst=int(rng.integers(1, 11)),
            spikes=_log_uniform(rng, 1e-4, 3e-3) if rng.random() < 0.3 else 0.0,
            spike_size=_log_uniform(rng, 8.0, 100.0),
            duplicates=float(rng.uniform(0.01, 0.1)) if rng.random() < 0.3 else 0.0,
            late=float(rng.uniform(0.05, 0.5)) if rng.random() < 0.3 else 0.0, delay=_log_uniform(rng, 5e-4, 5e-3))

    def arrivals() -> Spread:
        return Spread(dof=_log_uniform(rng, 3.0, 8.0) if rng.random() < 0.5 else np.inf,
                      correlation=float(rng.uniform(0.2, 0.7)) if rng.random() < 0.4 else 0.0)
    return NoiseLaws(sensor(noise.displacement), sensor(noise.spot), arrivals(), arrivals())


def _setups(rng: np.random.Generator, field: bool, machine: Machine) -> dict[str, Setup]:
    standoff = round(rng.uniform(0.15, 0.5), 3)
    offset, beams = (0.02, 0.0), ((0.0, 0.0),)
    names = DIAGONALS + LINEAR
    if not field:
        offset = (round(rng.uniform(-0.03, 0.03), 4), round(rng.uniform(0.012, 0.03), 4))
        if rng.random() < 0.12:
            beams = ((0.0, 0.0), (0.014, 0.0), (0.0, 0.014))
        if rng.random() < 0.12:
            names = DIAGONALS
    many = 2 if field or rng.random() < 0.7 else int(rng.integers(3, 6))
    setups = {}
    for name in names:
        own = standoff if field else round(standoff + rng.uniform(-0.05, 0.1), 3)
        linear = {'length': machine.volume['xyz'.index(name[-1])], 'stops': many} \
            if name in LINEAR else {}
        setups[name] = Setup(name, own, offset, beams, **linear)
    return setups


def _geometry(rng: np.random.Generator, description: Description) -> GeometricErrors:
    """Random walks and smooth waves, zero at the origin."""
    size = {'linear': _log_uniform(rng, 3e-6, 2.5e-5), 'straight': _log_uniform(rng, 1e-6, 1e-5),
            'angle': _log_uniform(rng, 3e-6, 5e-5)}
    curves = {}
    for name in CURVES:
        axis = AXES.index(name[2])
        place = np.linspace(0.0, 1.0, description.plan.steps + 1)
        kind = 'linear' if name[1] == name[2] else 'straight' if name[1] in 'XYZ' else 'angle'
        walk = np.cumsum(rng.standard_normal(len(place))) / np.sqrt(len(place))
        wave = rng.normal() * np.sin(np.pi * rng.uniform(0.5, 3.0) * place + rng.uniform(0.0, 6.0)) \
            + rng.normal() * place
        mixed = rng.uniform(0.2, 1.0) * walk + wave
        curves[name] = Curve(place * description.machine.volume[axis],
                             size[kind] * 0.6 * (mixed - mixed[0]))
    square = dict(zip(('EC0Y', 'EB0Z', 'EA0Z'), rng.normal(0.0, 1.5e-5, 3).tolist(), strict=True))
    return GeometricErrors(curves, square)


def _misalignments(rng: np.random.Generator, description: Description) -> dict[str, Misalignment]:
    largest = _log_uniform(rng, 5e-5, 1e-3)
    reach = float(np.linalg.norm(description.machine.volume)) + 0.5
    largest = min(largest, MOST_WALK_M / (2.0 * reach))
    turns = {}
    for name in description.setups:
        laser, mirror = rng.uniform(-largest, largest, (2, 2))
        turns[name] = Misalignment(tuple(laser.tolist()), tuple(mirror.tolist()))
    return turns


def _air(rng: np.random.Generator) -> Air:
    """Weather that the instrument takes out as it should; half of the logs hold the topics."""
    # The instrument measures air and divides: a change of weather is no effect.
    calm = rng.random() < 0.5
    drift = np.zeros(3) if calm else rng.normal(0.0, [0.5, 100.0, 0.02])
    scales = rng.uniform(19.0, 24.0, 3)
    sensors: tuple[str, ...] = ()
    if rng.random() < 0.5:
        sensors = ('temperature', 'pressure', 'humidity', 'scale')
        if rng.random() < 0.3:
            sensors = sensors[:3]
    return Air(temperature=rng.uniform(18.0, 25.0), pressure=rng.uniform(9.3e4, 1.03e5),
               humidity=rng.uniform(0.3, 0.6), temperature_drift=float(drift[0]),
               pressure_drift=float(drift[1]), humidity_drift=float(drift[2]), sensors=sensors,
               scale_temperature=tuple(scales.tolist()), period=float(rng.choice([5.0, 10.0])))


def without_weather(cell: Cell) -> Cell:
    """The cell with an instrument that keeps to one index of air."""
    return replace(cell, air=replace(cell.air, temperature_drift=0.0, pressure_drift=0.0,
                                     humidity_drift=0.0))


def without_sensor_noise(cell: Cell) -> Cell:
    """The cell with sensors that read the truth; arrivals err as they do."""
    noise = replace(cell.description.noise, displacement=0.0, spot=0.0)
    return replace(cell, description=replace(cell.description, noise=noise))
