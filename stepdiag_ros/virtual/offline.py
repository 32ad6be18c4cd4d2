"""A whole calibration on a virtual clock: cell in, log out, no sockets and no waiting.

It runs the plan as the sequencer does: setup by setup, for each repeat a forward and
a backward run; each run resets the interferometer at its first stop.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from stepdiag_ros.effects.base import Effect
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.guard import limits
from stepdiag_ros.model.cycle import Traverse, cycle
from stepdiag_ros.model.log import (
    DONE,
    DWELL,
    MOVE,
    CalibrationLog,
    Samples,
    ScalarSeries,
    StepEvents,
)
from stepdiag_ros.model.regulation import PERIOD_S
from stepdiag_ros.virtual.air import environment
from stepdiag_ros.virtual.cell import Cell, Motion
from stepdiag_ros.virtual.draw import normals
from stepdiag_ros.virtual.held import hold_beams
from stepdiag_ros.virtual.history import History
from stepdiag_ros.virtual.motion import Profile, point_to_point, settling_time, tabulate
from stepdiag_ros.virtual.world import Reading, World

START_NS = 1_780_000_000_000_000_000
COMMAND_DELAY_NS = 2_000_000
"""From the end of a dwell to the next move: the sequencer's time to say so."""
RESET_NS = 20_000_000
"""From in position at a run's first stop to its dwell: the interferometer is reset meanwhile."""
SENSOR_SIGMA = {'air_temperature': 0.01, 'air_pressure': 5.0, 'humidity': 0.005,
                'scale_temperature': 0.01}
"""Standard deviations [°C, Pa, 1, °C] of the environment's readings."""
DARK_V = 0.001
"""What each of a detector's inputs shows without light [V]."""


@dataclass(frozen=True)
class Run:
    """One run: its place in the plan, its stops and its events' times [ns], (stops,) each."""

    setup: str
    repeat: int
    traverse: Traverse
    move_ns: np.ndarray
    dwell_ns: np.ndarray
    done_ns: np.ndarray

    @property
    def run_id(self) -> str:
        return f'{self.setup}/{self.repeat}/{self.traverse.name}'


@dataclass(frozen=True)
class Visit:
    """How a setup is measured otherwise than the cell says, all [s].

    ``wait``: the cell is left alone so long before mirror and base unit are mounted; ``mount``: from mounting to the
    first move, None: as the cell says; ``watch``: the first dwell is so much longer; ``again``: left standing so long
    and measured as often again, None: not.
    """

    wait: float = 0.0
    mount: float | None = None
    watch: float = 0.0
    again: float | None = None


class Progress:
    """Adds up what is done, in nanoseconds of the machine's time, and tells ``progress`` in seconds."""

    def __init__(self, total_ns: int, progress: Callable[[int, int], None]):
        self._ns, self._total_ns, self._progress = 0, total_ns, progress

    def done(self, ns: int) -> None:
        self._ns += ns
        self._progress(self._ns // 10 ** 9, self._total_ns // 10 ** 9)


def simulate_log(cell: Cell, start_ns: int = START_NS, setups: tuple[str, ...] | None = None,
                 rate: float | None = None, in_motion: bool | None = None,
                 effects: Sequence[Effect] | None = None,
                 visits: Mapping[str, Visit] | None = None,
                 progress: Callable[[int, int], None] = lambda _done, _total: None) -> CalibrationLog:
    """The log of a calibration of ``cell``.

    ``setups``: which, in which order (all); ``rate`` [Hz] of both sensors and ``in_motion``
    override the cell's sampling; ``effects`` act instead of those that the cell names; ``visits``: setups
    that are measured otherwise than the cell says; ``progress(done, total)`` is told of it in seconds.
    The same cell gives the same log, bit by bit.
    """
    history = History()
    runs = execute(cell, history, start_ns, setups or cell.setup_names, visits)
    moving = cell.sampling.in_motion if in_motion is None else in_motion
    spans = [(run, *span) for run in runs for span in _spans(run, moving)]
    held = [(run.setup, int(run.move_ns[0]), int(run.done_ns[-1])) for run in runs
            if cell.description.setups[run.setup].regulated]
    sampled_ns, held_ns = (sum(end - begin for *_, begin, end in parts) for parts in (spans, held))
    _refuse_too_many(cell, 1e-9 * max(sampled_ns * (rate or max(cell.sampling.interferometer, cell.sampling.psd)),
                                      held_ns / PERIOD_S))
    world = World(cell, history, start_ns, effects)
    made = Progress(2 * sampled_ns + held_ns, progress)
    hold_beams(world, held, made.done)
    memory: dict = {}
    displacement = _displacement(world, spans, rate or cell.sampling.interferometer, memory, made.done)
    spot = _spot(world, spans, rate or cell.sampling.psd, memory, made.done)
    return CalibrationLog(cell.description, _events(cell, runs), displacement, spot,
                          _environment(world, start_ns, int(runs[-1].done_ns[-1])),
                          source=f'simulated from {cell.source}',
                          namespace=f'/{cell.description.machine.name}', beam_angle=_angles(world, spans))


def execute(cell: Cell, history: History, start_ns: int, setups: tuple[str, ...],
            visits: Mapping[str, Visit] | None = None) -> list[Run]:
    """Move through the plan, filling ``history``; returns the runs."""
    stops = sum(cell.description.repeats_of(setup) * sum(len(part.visits) for part in cycle(cell.description, setup))
                for setup in setups)
    _refuse_too_many(cell, stops * cell.motion.dwell * max(cell.sampling.interferometer, cell.sampling.psd))
    now, place, runs = start_ns, np.zeros(3), []
    rest = point_to_point(0.0, 1.0, 1.0, 1.0)
    # Power-up and each mounting of the mirror count as arrivals, as they do for the control.
    history.append(now, place, place, rest, -1)
    for setup in setups:
        parts = cycle(cell.description, setup)
        number, visit = cell.setup_names.index(setup), (visits or {}).get(setup, Visit())
        now += COMMAND_DELAY_NS + round(visit.wait * 1e9)
        history.append(now, place, place, rest, number)
        now += int((cell.motion.mount if visit.mount is None else visit.mount) * 1e9)
        repeats, motion = cell.description.repeats_of(setup), cell.motion_in(setup)
        for repeat in range(repeats if visit.again is None else 2 * repeats):
            if repeat == repeats:
                now += int(visit.again * 1e9)
            for part in parts:
                watch = visit.watch if repeat == 0 and part is parts[0] else 0.0
                run = _run(motion, history, now, place, part, number, setup, repeat, watch)
                runs.append(run)
                now, place = int(run.done_ns[-1]) + COMMAND_DELAY_NS, part.visits[-1].position
    return runs


def _run(motion: Motion, history: History, now: int, place: np.ndarray, traverse: Traverse,
         number: int, setup: str, repeat: int, watch: float) -> Run:
    times = np.zeros((3, len(traverse.visits)), np.int64)
    for i, visit in enumerate(traverse.visits):
        times[0, i] = now
        if visit.beyond is not None:
            now, place = _go(motion, history, now, place, visit.beyond, number) + COMMAND_DELAY_NS, visit.beyond
        dwell = _go(motion, history, now, place, visit.position, number) + (RESET_NS if i == 0 else 0)
        times[1:, i] = dwell, dwell + round((motion.dwell + (0.0 if i else watch)) * 1e9)
        now, place = int(times[2, i]) + COMMAND_DELAY_NS, visit.position
    return Run(setup, repeat, traverse, *times)


def _go(motion: Motion, history: History, now: int, place: np.ndarray, target: np.ndarray, number: int) -> int:
    """Append a move; returns when it is in position [ns]."""
    profile, settled = move(motion, float(np.linalg.norm(target - place)))
    history.append(now, place, target, profile, number)
    return now + round(settled * 1e9)


@lru_cache(maxsize=4096)
def move(motion: Motion, distance: float) -> tuple[Profile, float]:
    """A move over ``distance`` [m] and the seconds until it is in position."""
    profile = point_to_point(distance, motion.feed, motion.acceleration, motion.jerk)
    table = tabulate(profile.duration[None], profile.jerk[None], np.zeros(1), np.zeros(1))
    return profile, float(settling_time(table, motion.settling, motion.in_position)[0])


def _spans(run: Run, moving: bool) -> list[tuple[int, int]]:
    """Spans of time [ns] in which a run is sampled: after its reset, and nowhere before."""
    if moving:
        return [(int(run.dwell_ns[0]), int(run.done_ns[-1]))]
    return list(zip(run.dwell_ns.tolist(), run.done_ns.tolist(), strict=True))


def _grid(world: World, begin: int, end: int, rate: float) -> tuple[np.ndarray, np.ndarray]:
    """Sample times (n,) [ns] and number of the block within the span (n,)."""
    period = 1.0 / rate
    per_block = max(1, round(world.cell.sampling.block * rate))
    count = max(1, int((end - begin) * 1e-9 * rate))
    block = np.arange(count) // per_block
    stamp = begin + np.rint(block * per_block * period * 1e9).astype(np.int64)
    inside = np.rint((np.arange(count) % per_block) * period * 1e9).astype(np.int64)
    return stamp + inside, block


def _refuse_too_many(cell: Cell, samples: float) -> None:
    """Refuse a log of so many samples of one sensor: before the moves are made, and when they are known."""
    if samples > limits.SIMULATED_SAMPLES:
        raise StepdiagError(f'{cell.source}: one sensor would have {samples:.2g} samples, more than '
                            f'{limits.SIMULATED_SAMPLES:.0g}; shorten the dwells, lower the sample rate, take fewer '
                            'steps or repeats, or let the axes move faster (feed, acceleration, jerk)')


def _collect(world: World, spans: list, rate: float, columns: int, look, done: Callable[[int], None]) -> Samples:
    """Lay the samples of all spans end to end; ``look(times, run, first)`` gives values, health, index."""
    names = world.cell.setup_names
    parts, first, blocks = [], 0, 0
    for run, begin, end in spans:
        done(end - begin)
        times, block = _grid(world, begin, end, rate)
        values, health, index = look(times, run, first)
        padded = np.full((len(times), columns), np.nan)
        padded[:, :values.shape[1]] = values
        parts.append((times, padded, health, index,
                      np.full(len(times), names.index(run.setup)), block + blocks))
        first += len(times)
        blocks += int(block[-1]) + 1
    times, values, health, index, setup, block = (np.concatenate(p) for p in zip(*parts, strict=True))
    return Samples(times, values, health, index, names, setup, block)


def _displacement(world: World, spans: list, rate: float, memory: dict, done: Callable[[int], None]) -> Samples:
    setups = world.cell.description.setups
    beams = max(len(s.beams) for s in setups.values())
    late_ns = round(world.clock_offset('interferometer') * 1e9)
    zero: dict[str, np.ndarray] = {}

    def look(times, run, first):
        delays = world.displacement.delays_ns(first, len(times))
        reading = _read(world, times - late_ns - delays, run.setup, memory)
        # A run is sampled from its first dwell on, which begins with the reset.
        if run.run_id not in zero:
            zero[run.run_id] = reading.length[:1]
            world.displacement.forget()
        begin = zero[run.run_id]
        values = world.displacement.readings(reading.length - begin, first, begin)
        quality = np.where(world.displacement.dark(first, len(times)), 0.0, np.rint(reading.quality))
        return values, quality, reading.index
    return _collect(world, spans, rate, beams, look, done)


def _spot(world: World, spans: list, rate: float, memory: dict, done: Callable[[int], None]) -> Samples:
    late_ns = round(world.clock_offset('psd') * 1e9)
    setups = world.cell.description.setups
    spans = [span for span in spans if setups[span[0].setup].sees_spot]
    if not spans:
        return Samples.empty(2)

    def look(times, run, first):
        reading = _read(world, times - late_ns - world.spot.delays_ns(first, len(times)), run.setup, memory)
        dark = world.spot.dark(first, len(times))
        if setups[run.setup].regulated:
            # A beam that is lost goes beside the detector, which does not move with a mirror.
            dark |= (np.abs(reading.spot) > 0.5 * world.cell.instruments.detector.length).any(axis=1)
        return (np.where(dark[:, None], np.nan, world.spot.readings(reading.spot, first)),
                np.where(dark, 2.0 * DARK_V, reading.intensity), np.ones(len(times)))
    return _collect(world, spans, rate, 2, look, done)


def _angles(world: World, spans: list) -> Samples:
    """The beam's angles once a period, where they are measured."""
    names, setups = world.cell.setup_names, world.cell.description.setups
    times, setup = [np.zeros(0, np.int64)], [np.zeros(0, np.intp)]
    if world.steering is not None and world.cell.instruments.detector.steering.inputs:
        for run, begin, end in spans:
            if setups[run.setup].regulated:
                times.append(np.arange(begin, end, round(PERIOD_S * 1e9)))
                setup.append(np.full(len(times[-1]), names.index(run.setup)))
    time = np.concatenate(times)
    values = world.steering.angles(time) if len(time) else np.zeros((0, 2))
    return Samples(time, values, np.ones(len(time)), np.ones(len(time)), names, np.concatenate(setup),
                   np.arange(len(time)))


def _read(world: World, times: np.ndarray, setup: str, memory: dict) -> Reading:
    """What both sensors see, traced once when they sample at the same times."""
    key = (setup, times.tobytes())
    if key in memory:
        return memory.pop(key)
    memory[key] = reading = world.read(times, setup)
    return reading


def _events(cell: Cell, runs: list[Run]) -> StepEvents:
    columns: dict[str, list] = {key: [] for key in ('time', 'run', 'setup', 'repeat', 'direction',
                                                    'index', 'axis', 'commanded', 'phase')}
    for number, run in enumerate(runs):
        visits = run.traverse.visits
        n = len(visits)
        repeated = {'run': number, 'setup': cell.setup_names.index(run.setup), 'repeat': run.repeat}
        for key, value in repeated.items():
            columns[key].append(np.full(3 * n, value))
        columns['time'].append(np.stack([run.move_ns, run.dwell_ns, run.done_ns], 1).ravel())
        for key, values in (('direction', [v.direction for v in visits]), ('index', [v.index for v in visits]),
                            ('axis', [v.axis for v in visits]), ('commanded', [v.position for v in visits])):
            columns[key].append(np.repeat(np.array(values), 3, axis=0))
        columns['phase'].append(np.tile([MOVE, DWELL, DONE], n))
    c = {key: np.concatenate(parts) for key, parts in columns.items()}
    return StepEvents(c['time'], tuple(run.run_id for run in runs), c['run'], cell.setup_names,
                      c['setup'], c['repeat'], c['direction'], c['index'], c['axis'],
                      c['commanded'], c['phase'])


def _environment(world: World, begin: int, end: int) -> dict[str, ScalarSeries]:
    cell = world.cell
    period_ns = int(cell.air.period * 1e9)
    if (readings := (end - begin) // period_ns) > limits.SIMULATED_READINGS:
        raise StepdiagError(f'{cell.source}: each sensor of the air would be read {readings:.2g} times, more often '
                            f'than {limits.SIMULATED_READINGS:.0g}; lengthen air.period, or shorten motion.mount and '
                            'the dwells')
    times = np.arange(begin, end + 1, period_ns, dtype=np.int64)
    seen = environment(cell.air, (times - begin) * 1e-9, world.effects)
    topics = {'temperature': ['air_temperature'], 'pressure': ['air_pressure'], 'humidity': ['humidity'],
              'scale': [f'scale_temperature/{axis}' for axis in 'xyz']}
    series = {topic: seen[topic] for sensor in topics if sensor in cell.air.sensors
              for topic in topics[sensor]}
    out = {}
    for name, value in series.items():
        sigma = SENSOR_SIGMA[name.split('/')[0]]
        noise = sigma * normals(cell.seed, f'environment/{name}', 0, len(times))[:, 0]
        reading = np.clip(value + noise, 0.0, 1.0) if name == 'humidity' else value + noise
        out[name] = ScalarSeries(times, reading, np.full(len(times), sigma ** 2))
    return out
