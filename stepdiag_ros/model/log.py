"""A whole calibration log as arrays: what a bag holds, freed from files and messages.

Readers in :mod:`stepdiag_ros.bag` and the solver node fill it; estimation and
gap diagnosis read it.  Times are integer nanoseconds since the epoch, so that
nothing is lost to rounding and replay is bit-identical.
"""

from dataclasses import dataclass, field

import numpy as np

from stepdiag_ros.model.description import Description

MOVE, DWELL, DONE, NONE = 0, 1, 2, 255
STOOD = 254
"""Axis of a stop that only goes on standing where the one before it stood: nothing moved."""
STEADY_S = 5.0
"""Air, scales and workpiece stay as they are for so long."""


@dataclass(frozen=True)
class StepEvents:
    """``sequencer/step`` in order of time; ``m`` events.

    ``time_ns`` (m,) int64; ``run`` (m,) index into ``run_ids``; ``setup`` (m,) index
    into ``setup_names``; ``repeat``, ``direction``, ``index``, ``axis``, ``phase`` (m,);
    ``commanded`` (m, 3) [m].
    """

    time_ns: np.ndarray
    run_ids: tuple[str, ...]
    run: np.ndarray
    setup_names: tuple[str, ...]
    setup: np.ndarray
    repeat: np.ndarray
    direction: np.ndarray
    index: np.ndarray
    axis: np.ndarray
    commanded: np.ndarray
    phase: np.ndarray

    def __len__(self) -> int:
        return len(self.time_ns)


@dataclass(frozen=True)
class Samples:
    """Samples of one sensor, blocks laid end to end in order of time; ``n`` samples.

    ``time_ns`` (n,) int64: stamp of the block plus index times sample period.
    ``values`` (n, k): displacement [m] of each beam, or spot x, y [m].
    ``health`` (n,): signal quality 0..100 of the interferometer, or sum signal [V] of the PSD.
    ``refractive_index`` (n,): what the interferometer divided out (1.0: none); ones for a PSD.
    ``setup`` (n,) index into ``setup_names`` (the blocks' frame_id).
    ``block`` (n,): number of the block that a sample came in.
    ``uncertainty_ns`` (n,): by how much each time can be off at most, where the log says so (−1: it does not);
    None: it says so of none.
    """

    time_ns: np.ndarray
    values: np.ndarray
    health: np.ndarray
    refractive_index: np.ndarray
    setup_names: tuple[str, ...]
    setup: np.ndarray
    block: np.ndarray
    uncertainty_ns: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.time_ns)

    @classmethod
    def empty(cls, columns: int) -> 'Samples':
        return cls(np.zeros(0, np.int64), np.zeros((0, columns)), np.zeros(0), np.zeros(0), (),
                   np.zeros(0, np.intp), np.zeros(0, np.intp))


@dataclass(frozen=True)
class ScalarSeries:
    """One environment quantity: ``time_ns`` (n,), ``value`` (n,) [°C, Pa or 0..1], ``variance`` (n,).

    ``later``: readings have come that :meth:`during` left out, so that none before them is on its way.
    """

    time_ns: np.ndarray
    value: np.ndarray
    variance: np.ndarray
    later: bool = field(default=False, compare=False)

    def during(self, begin_ns: int, end_ns: int) -> 'ScalarSeries':
        """The readings from ``begin_ns`` to ``end_ns``, and the one before where the next is more than STEADY_S off.

        Whoever listens was there from the beginning to the end; how long before and after is chance, and must not
        change what is evaluated.  All readings where none came before ``end_ns``.
        """
        first, last = np.searchsorted(self.time_ns, (begin_ns, end_ns + 1))
        if not last:
            return self
        if first and (first == last or self.time_ns[first] > begin_ns + 1e9 * STEADY_S):
            first -= 1
        kept = slice(first, last)
        return ScalarSeries(self.time_ns[kept], self.value[kept], self.variance[kept],
                            self.later or last < len(self.time_ns))

    def at(self, time_ns: np.ndarray) -> np.ndarray:
        """The quantity at ``time_ns`` (k,), smoothed over a few readings so that sensor noise stays out.

        Before the first and after the last reading it stays as it was there.
        """
        good = np.isfinite(self.value)
        time, value = (self.time_ns[good] - self.time_ns[0]) * 1e-9, self.value[good]
        if len(value) >= 15:
            kernel = np.hanning(13)[1:-1]
            padded = np.concatenate([2 * value[0] - value[5:0:-1], value, 2 * value[-1] - value[-2:-7:-1]])
            value = np.convolve(padded, kernel / kernel.sum(), mode='valid')
        return np.interp((np.asarray(time_ns, np.int64) - self.time_ns[0]) * 1e-9, time, value)


@dataclass(frozen=True)
class CalibrationLog:
    """A log.

    ``environment`` maps ``air_temperature``, ``air_pressure``, ``humidity``,
    ``scale_temperature/x`` (``/y``, ``/z``, ``/workpiece``) to series; absent keys were not logged.
    ``clocks`` maps ``sequencer``, ``interferometer``, ``psd`` to the name of the clock that stamped them, where known.
    ``beam_angle``: azimuth and elevation [rad] of a regulated beam, where they were measured.
    ``warnings`` say what the reader repaired or left out; ``namespace`` is the machine's.
    """

    description: Description
    steps: StepEvents
    displacement: Samples
    spot: Samples
    environment: dict[str, ScalarSeries] = field(default_factory=dict)
    source: str = 'log'
    namespace: str = ''
    warnings: tuple[str, ...] = ()
    clocks: dict[str, str] = field(default_factory=dict)
    beam_angle: Samples = field(default_factory=lambda: Samples.empty(2))
