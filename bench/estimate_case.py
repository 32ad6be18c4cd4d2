"""The log that the benches of estimation solve: four diagonals and three lines of a machine of 0.8 × 0.6 × 0.5 m."""

import time
import tracemalloc
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from stepdiag_ros.estimate.forward import ForwardModel
from stepdiag_ros.estimate.noise import NoiseModel, whiteners
from stepdiag_ros.estimate.parameters import parameters_of
from stepdiag_ros.estimate.planned import filled, observe, planned_table
from stepdiag_ros.estimate.reduce import StopTable
from stepdiag_ros.model.description import DIAGONALS, LINEAR, Description, Machine, Plan, Setup
from stepdiag_ros.model.machine import CURVES, Curve, GeometricErrors
from stepdiag_ros.model.sensor import Misalignment

MACHINE = Machine('bench', 'FXYZ', (0.8, 0.6, 0.5), (0.01, -0.02, -0.15))


@dataclass(frozen=True)
class Case:
    description: Description
    table: StopTable
    noise: NoiseModel
    truth: GeometricErrors
    misalignments: Mapping[str, Misalignment]


def make_case(steps: int, repeats: int = 1, both_ways: bool = False, seed: int = 1) -> Case:
    """A drawn machine with misaligned lasers and mirrors, its plan run through, the noise of arrivals in it."""
    rng = np.random.default_rng(seed)
    setups = {}
    for name in (*DIAGONALS, *LINEAR):
        length = MACHINE.volume['xyz'.index(name[-1])] if name in LINEAR else None
        setups[name] = Setup(name, 0.35, (0.02, 0.01), ((0.0, 0.0),), length, 2 if length else None)
    description = Description(MACHINE, Plan(steps, 'XYZ', repeats), setups)
    curves = {}
    for name in CURVES:
        place = np.linspace(0.0, MACHINE.volume['XYZ'.index(name[2])], steps + 1)
        value = np.cumsum(rng.normal(0.0, 5e-6 / np.sqrt(steps), steps + 1))
        curves[name] = Curve(place, value - value[0])
    truth = GeometricErrors(curves, {'EC0Y': 1.1e-5, 'EB0Z': -2.3e-5, 'EA0Z': 1.7e-5})
    misalignments = {name: Misalignment(tuple(rng.uniform(-3e-4, 3e-4, 2)), tuple(rng.uniform(-3e-4, 3e-4, 2)))
                     for name in DIAGONALS}
    table = planned_table(description, directions=(1, -1) if both_ways else (1,))
    clean = observe(description, table, truth, misalignments)
    sensor = np.full(clean.shape, 5e-10)
    sensor[:, -2:] = 2e-8
    noise = NoiseModel(3e-7, 2e-7, sensor, 'given')
    parameters = parameters_of(description, table)
    arrival = ForwardModel(description, table, parameters).jacobian(np.zeros(parameters.size))[2]
    readings = clean.ravel().copy()
    for white in whiteners(table, noise, arrival, np.isfinite(clean)):
        readings[white.rows] += white.factor @ rng.standard_normal(len(white.rows))
    table = filled(table, readings.reshape(clean.shape))
    return Case(description, replace(table, displacement_scatter=sensor[:, :-2] * 10.0,
                                     spot_scatter=sensor[:, -2:] * 10.0), noise, truth, misalignments)


def peak_mb(work: Callable[[], object]) -> float:
    """Greatest memory that Python held for ``work`` [MB]."""
    tracemalloc.start()
    work()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak / 1e6


def best_of(work: Callable[[], object], times: int = 3, clock: Callable[[], float] = time.perf_counter) -> float:
    """Shortest of several runs [s] by a clock: of the wall, or of the processor."""
    spent = []
    for _ in range(times):
        begin = clock()
        work()
        spent.append(clock() - begin)
    return min(spent)
