"""Readings of a cell as the methods of the literature want them: one row a stop, means over runs.

A :class:`SetupReadings` is a straight line of sight and the stops that were visited in it.
All setups come from a log (:func:`readings_of_stops`) or from the closed-form sensor (:func:`simulate`).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.reduce import StopTable
from stepdiag_ros.model.description import DIAGONALS, Description, Machine, Noise
from stepdiag_ros.model.log import NONE
from stepdiag_ros.model.machine import GeometricErrors, tool_pose
from stepdiag_ros.model.path import local_triad, setup_direction, stops
from stepdiag_ros.model.sensor import Misalignment, distance, spot, turned

ALIGNED = Misalignment()


@dataclass(frozen=True, eq=False)
class Sight:
    """A line of sight and its stops; nothing measured yet.  Two are the same only if they are one.

    ``direction`` (3,) unit vector away from the source; ``positions`` (n, 3) [m] commanded,
    ``axis`` (n,) number of the axis that moved to reach a stop (255 at the first);
    ``beams`` (k, 2), ``psd_offset`` (2,) [m] along (u, v); ``standoff`` [m].  ``kind`` of a setup with a way of its
    own (:attr:`~stepdiag_ros.model.description.Setup.kind`); empty for a short name.  ``station``, ``tool`` (3,) [m]
    where a beam follows a retroreflector from there; ``direction`` then says nothing.
    """

    name: str
    direction: np.ndarray
    positions: np.ndarray
    axis: np.ndarray
    standoff: float = 0.0
    beams: tuple[tuple[float, float], ...] = ((0.0, 0.0),)
    psd_offset: tuple[float, float] = (0.0, 0.0)
    kind: str = ''
    station: tuple[float, ...] | None = None
    tool: tuple[float, ...] | None = None

    @cached_property
    def triad(self) -> np.ndarray:
        return local_triad(self.direction)

    def called(self, name: str) -> 'Sight':
        """The same under another name."""
        return self if name == self.name else replace(self, name=name)

    def origin(self, tool: np.ndarray) -> np.ndarray:
        return self.positions[0] + np.asarray(tool) - self.standoff * self.direction


@dataclass(frozen=True)
class SetupReadings:
    """Means of one setup over its runs.

    ``displacement_m`` (n, beams) [m], zero at stop 0; ``displacement_sigma_m`` (n,) of that mean;
    ``spot_m`` (n, 2) [m] or None, ``spot_sigma_m`` (n,); ``forward_m``, ``backward_m``
    (runs, n) [m]: beam 0 of each run on its own, aligned as :func:`readings_of_stops` says.
    ``declared``: no direction was run twice, and the standard deviations are of the noise that the cell declares.
    ``zeroed``: every forward run was reset at its own first stop, so that each cycle counts from a zero of its own.
    """

    sight: Sight
    displacement_m: np.ndarray
    displacement_sigma_m: np.ndarray
    spot_m: np.ndarray | None = None
    spot_sigma_m: np.ndarray | None = None
    forward_m: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    backward_m: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    declared: bool = False
    zeroed: bool = False


@dataclass(frozen=True)
class CellReadings:
    """All setups of one machine, by name; ``steps`` an axis of a diagonal.

    ``left_out``: setups of the log that could not be used, and why.
    """

    machine: Machine
    steps: int
    setups: Mapping[str, SetupReadings]
    left_out: Mapping[str, str] = field(default_factory=dict)

    def diagonals(self, method: str, needed: int = 3) -> list[str]:
        """Names of the body diagonals at hand, in the contract's order."""
        names = [name for name in DIAGONALS if name in self.setups]
        if len(names) < needed:
            raise StepdiagError(f'{method}: needs {needed} body diagonals, the log has '
                                f'{len(names)} ({", ".join(names) or "none"}){self.why()}')
        return names

    def why(self) -> str:
        """What was left out, to end a complaint with; empty where nothing was."""
        return ''.join(f'; {name}: {text}' for name, text in self.left_out.items())

    def without(self, *names: str) -> 'CellReadings':
        return replace(self, setups={n: s for n, s in self.setups.items() if n not in names})

    def along(self, sights: Mapping[str, Sight]) -> 'CellReadings':
        """The same along ``sights``, of the same stops: what depends on those alone is computed once."""
        return replace(self, setups={n: replace(s, sight=sights.get(n, s.sight)) for n, s in self.setups.items()})


def sight_of(description: Description, name: str) -> Sight:
    """The line of sight of a setup of the cell description."""
    path, setup = stops(description, name), description.setups[name]
    return Sight(name, setup_direction(description.machine, setup), path.positions, path.axis,
                 setup.standoff, setup.beams, setup.psd_offset, '' if setup.way is None else setup.kind,
                 setup.station, setup.tool_of(description.machine) if setup.follows else None)


def face_sight(machine: Machine, plane: str, sign: str, steps: int, standoff: float = 0.0) -> Sight:
    """A face diagonal stepped one axis at a time: ``plane`` ``xy``, ``xz`` or ``yz``.

    ``sign`` ``p``: from the origin; ``n``: from the far end of the plane's first axis, back along it.
    """
    first, second = ('xyz'.index(letter) for letter in plane)
    direction, start = np.zeros(3), np.zeros(3)
    direction[first] = machine.volume[first] * (1.0 if sign == 'p' else -1.0)
    direction[second] = machine.volume[second]
    start[first] = 0.0 if sign == 'p' else machine.volume[first]
    moved = np.resize(np.array([first, second], np.uint8), 2 * steps)
    counts = np.concatenate([np.zeros((1, 3)), np.cumsum(moved[:, None] == np.arange(3), axis=0)])
    return Sight(f'{plane}_{sign}', direction / np.linalg.norm(direction),
                 start + counts / steps * direction, np.concatenate([[NONE], moved]).astype(np.uint8),
                 standoff)


Measure = Callable[[Sight, Machine, Misalignment, np.ndarray, np.ndarray],
                   tuple[np.ndarray, np.ndarray]]


def closed_form(sight: Sight, machine: Machine, misalignment: Misalignment, point: np.ndarray,
                attitude: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Absolute distances (n, beams) and spots (n, 2) [m] of the contract's sensor."""
    triad, origin = sight.triad, sight.origin(machine.tool)
    beam = turned(triad, misalignment.laser)
    normal = attitude @ -turned(triad, misalignment.mirror)
    starts = origin + np.array(sight.beams) @ triad[:2]
    lengths = np.stack([distance(point, normal, s, beam) for s in starts], axis=-1)
    start = origin + np.array(sight.psd_offset) @ triad[:2]
    return lengths, spot(point, normal, start, np.broadcast_to(beam, point.shape), triad)


def observe(sight: Sight, machine: Machine, errors: GeometricErrors,
            misalignment: Misalignment = ALIGNED,
            measure: Measure = closed_form) -> tuple[np.ndarray, np.ndarray]:
    """What a known machine shows: absolute distances (n, beams), spots (n, 2) [m]."""
    point, attitude = tool_pose(errors, sight.positions, machine.tool, machine.chain)
    return measure(sight, machine, misalignment, point, attitude)


def simulate(machine: Machine, steps: int, sights: list[Sight], errors: GeometricErrors,
             misalignments: Mapping[str, Misalignment] | None = None,
             measure: Measure = closed_form, sigma_m: float = 0.0,
             spot_zero_m: tuple[float, float] = (0.0, 0.0)) -> CellReadings:
    """Noise-free readings of a known machine; ``sigma_m`` is only declared, not added.

    ``spot_zero_m`` shifts the detector's zero: the spot is reported too large by it.
    """
    setups = {}
    for sight in sights:
        lengths, spots = observe(sight, machine, errors,
                                 (misalignments or {}).get(sight.name, ALIGNED), measure)
        n = len(lengths)
        setups[sight.name] = SetupReadings(
            sight, lengths - lengths[0], np.full(n, sigma_m), spots + np.array(spot_zero_m),
            np.full(n, sigma_m), (lengths - lengths[0])[None, :, 0])
    return CellReadings(machine, steps, setups)


def readings_of_stops(description: Description, table: StopTable) -> CellReadings:
    """Means over the runs of each setup of a reduced log.

    A traverse is one run's stops in one direction.  For the mean, every traverse is shifted to
    agree on average with the others, then stop 0 is made zero.  For the ISO tests (``forward_m``,
    ``backward_m``) the resets count: a run starts from zero at its first forward stop, a backward
    run of its own goes on from where the forward run of its repeat ended.  A setup with a
    stop that no run has is left out, with the reason.  The standard deviation of a mean is
    that of the scatter between runs of the same direction; where none was run twice, of the noise that the cell
    declares.
    """
    setups, left_out = {}, {}
    for number, name in enumerate(table.setup_names):
        rows = table.setup == number
        if not rows.any() or name not in description.setups:
            continue
        try:
            setups[name] = _setup_readings(sight_of(description, name), table.select(rows), description.noise)
        except StepdiagError as error:
            left_out[name] = str(error)
    return CellReadings(description.machine, description.plan.steps, setups, left_out)


def _setup_readings(sight: Sight, table: StopTable, noise: Noise) -> SetupReadings:
    n, beams = len(sight.positions), table.displacement.shape[1]
    # A traverse goes once along the stops; an imported table holds many in one run without a reset.
    keys, member = np.unique(np.stack([table.run, table.repeat, table.direction], axis=1),
                             axis=0, return_inverse=True)
    member = np.ravel(member)
    length, spots = np.full((len(keys), n, beams), np.nan), np.full((len(keys), n, 2), np.nan)
    for t in range(len(keys)):
        mine = np.flatnonzero((member == t) & (table.index < n))
        length[t, table.index[mine]] = table.displacement[mine]
        spots[t, table.index[mine]] = table.spot[mine]
    # A traverse without a single reading says nothing and has no mean.
    alive = np.isfinite(length).any(axis=1).all(axis=1)
    keys, length, spots = keys[alive], length[alive], spots[alive]
    missing = np.flatnonzero(np.isnan(length).all(axis=0).any(axis=1))
    if missing.size:
        raise StepdiagError(f'no run has a reading at stop {missing[0]} '
                            f'({missing.size} such stops); measure it again')
    aligned, direction = _align(length), keys[:, 2]
    mean = _mean(aligned, 0)
    forward, backward = _in_order(length[:, :, 0], keys)
    has_spots = np.isfinite(spots).any(axis=0).all()
    spot_mean = _mean(spots, 0) if has_spots else None
    sigma, spot_sigma = _sigma(aligned[:, :, 0], direction), _sigma(spots.mean(axis=2), direction)
    path = sight.standoff + (sight.positions - sight.positions[0]) @ sight.direction
    declared = sigma is None
    ahead = keys[keys[:, 2] > 0, 0]
    zeroed = len(ahead) > 1 and len(np.unique(ahead)) == len(ahead)
    if declared:
        sigma = np.full(n, np.hypot(noise.position_repeatability, noise.displacement) / np.sqrt(len(keys)))
    if spot_sigma is None:
        spot_sigma = np.hypot(2.0 * path * noise.angle_repeatability, noise.spot) / np.sqrt(len(keys))
    return SetupReadings(sight, mean - mean[0], sigma, spot_mean, spot_sigma if has_spots else None, forward,
                         backward, declared, zeroed)


def _align(length: np.ndarray) -> np.ndarray:
    """Shift runs (r, n, k) so that each agrees on average with the first, stop by stop."""
    common = length[0] if len(length) == 1 else np.nanmedian(length - _mean(length, 1)[:, None], axis=0)
    return length - _mean(length - common, 1)[:, None]


def _mean(values: np.ndarray, axis: int) -> np.ndarray:
    """Mean of what is there; NaN, and no warning, where nothing is."""
    count = np.isfinite(values).sum(axis=axis)
    return np.where(count, np.nansum(values, axis=axis), np.nan) / np.maximum(count, 1)


def _sigma(values: np.ndarray, direction: np.ndarray) -> np.ndarray | None:
    """Standard deviation (n,) of the mean over runs, pooled over the stops; None where no direction was run twice."""
    squares, freedom = 0.0, 0
    for sign in (1, -1):
        same = values[direction == sign]
        if len(same) > 1:
            spread = same - _mean(same, 0)
            squares += np.nansum(spread ** 2)
            freedom += np.isfinite(spread).sum() - np.isfinite(spread).any(axis=0).sum()
    if not freedom:
        return None
    return np.full(values.shape[1], np.sqrt(squares / freedom / len(values)))


def _in_order(length: np.ndarray, keys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Complete forward and backward traverses (f, n), (b, n) from (t, n); ``keys`` (t, 3) run, repeat,
    direction.

    What shares a run shares its reset: those readings keep their differences.  A backward
    traverse in a run of its own goes on from the end of the forward one of its repeat.
    """
    complete = np.isfinite(length).all(axis=1)
    shift: dict[int, float] = {}
    ends: dict[int, float] = {}
    forward, backward = [], []
    for t in np.flatnonzero(complete & (keys[:, 2] > 0)):
        run, repeat, _ = keys[t]
        shift.setdefault(run, length[t, 0])
        forward.append(length[t] - shift[run])
        ends.setdefault(repeat, forward[-1][-1])
    # Where the forward run of a cycle is not complete, its backward run goes on from where the others ended.
    end = float(np.mean(list(ends.values()))) if ends else 0.0
    for t in np.flatnonzero(complete & (keys[:, 2] < 0)):
        run, repeat, _ = keys[t]
        backward.append(length[t] - shift.get(run, length[t, -1] - ends.get(repeat, end)))
    n = length.shape[1]
    return np.reshape(forward, (-1, n)), np.reshape(backward, (-1, n))
