"""How the noise of a virtual cell is distributed: heavy tails, correlation, steps, gaps, outliers.

A cell's ``noise`` states standard deviations; its ``noise_law`` (:class:`NoiseLaw` for each sensor, :class:`Spread`
for what an arrival brings) states how such numbers are distributed.  Without one, noise is normal and white.  Every
draw is addressed by sample or arrival number (:mod:`~stepdiag_ros.virtual.draw`), so the servers of a live cell and
``simulate`` draw from the same law whatever the size of their blocks.
"""

from dataclasses import dataclass

import numpy as np

from stepdiag_ros.virtual.draw import normals, uniforms


@dataclass(frozen=True)
class Spread:
    """The law of numbers with standard deviation 1.

    ``dof``: degrees of freedom of Student's t, above 2, ``inf``: normal; ``correlation`` of the normal scores of
    neighbours, an AR(1) process, −1 < ρ < 1.
    """

    dof: float = np.inf
    correlation: float = 0.0


@dataclass(frozen=True)
class NoiseLaw(Spread):
    """What one sensor's samples suffer.

    ``quantum`` [m]: readings are multiples of it; ``dropouts``: share of samples without signal, in bursts of
    ``burst`` samples; ``spikes``: share of samples that are off by ``spike_size`` standard deviations to either
    side; ``duplicates``: share that repeats the reading before; ``late``: share that shows where the machine was
    up to ``delay`` [s] before its stamp.
    """

    quantum: float = 0.0
    dropouts: float = 0.0
    burst: int = 1
    spikes: float = 0.0
    spike_size: float = 20.0
    duplicates: float = 0.0
    late: float = 0.0
    delay: float = 0.002


@dataclass(frozen=True)
class NoiseLaws:
    """The laws of a cell: both sensors' samples, and the axes' errors and turns at arrivals."""

    displacement: NoiseLaw = NoiseLaw()
    spot: NoiseLaw = NoiseLaw()
    position: Spread = Spread()
    angle: Spread = Spread()


class Numbers:
    """A stream of numbers with standard deviation 1 under a law, addressed by index."""

    def __init__(self, spread: Spread, seed: int, stream: str):
        self._spread, self._seed, self._stream = spread, seed, stream
        self._next = 0                       # index that the chain goes on with
        self._last: np.ndarray | None = None   # its normal scores before that

    def draw(self, first: int, count: int, columns: int = 1) -> np.ndarray:
        """(count, columns) numbers for the indices ``first … first + count - 1``.

        The chain begins at index 0; going on where the last call ended costs nothing, an index before it
        begins anew.
        """
        score = self._chain(first, count, columns) if self._spread.correlation else \
            normals(self._seed, self._stream, first, count, columns)
        dof = self._spread.dof
        if not np.isfinite(dof):
            return score
        # By the lower tail, where probabilities keep their digits; t has the variance ν / (ν − 2).
        from scipy.special import ndtr, stdtrit  # slow to import; most cells' noise is normal
        return -np.sign(score) * stdtrit(dof, ndtr(-np.abs(score))) * np.sqrt((dof - 2.0) / dof)

    def _chain(self, first: int, count: int, columns: int) -> np.ndarray:
        from scipy.signal import lfilter  # slow to import; most cells need none of it
        rho = self._spread.correlation
        scale = np.sqrt(1.0 - rho**2)
        if self._last is None or first < self._next or len(self._last) != columns:
            self._next, self._last = 0, None
        fresh = normals(self._seed, self._stream, self._next, first + count - self._next, columns)
        if self._last is None:
            fresh[0] /= scale   # the chain is stationary from its first number on
            state = np.zeros((1, columns))
        else:
            state = rho * self._last[None]
        scores, _ = lfilter([scale], [1.0, -rho], fresh, axis=0, zi=state)
        self._next, self._last = first + count, scores[-1]
        return scores[len(scores) - count:]


class SensorNoise:
    """What a sensor adds to the truth, sample by sample.

    ``sigma`` [m] is its standard deviation; ``stream`` names its draws.
    """

    def __init__(self, law: NoiseLaw, sigma: float, seed: int, stream: str):
        self.law, self._sigma, self._seed, self._stream = law, sigma, seed, stream
        self._numbers = Numbers(law, seed, stream)
        self._before: np.ndarray | None = None

    def delays_ns(self, first: int, count: int) -> np.ndarray:
        """(count,) [ns]: how much before its stamp each sample was taken."""
        if not self.law.late:
            return np.zeros(count, np.int64)
        drawn = self._uniforms('late', first, count, 2)
        return np.where(drawn[:, 0] < self.law.late, np.rint(drawn[:, 1] * self.law.delay * 1e9), 0).astype(np.int64)

    def dark(self, first: int, count: int) -> np.ndarray:
        """(count,) bool: samples without signal."""
        if not self.law.dropouts:
            return np.zeros(count, bool)
        burst = self.law.burst
        low, high = first // burst, (first + count - 1) // burst
        off = self._uniforms('dropout', low, high - low + 1)[:, 0] < self.law.dropouts
        return off[(first + np.arange(count)) // burst - low]

    def readings(self, truth: np.ndarray, first: int, zero: np.ndarray | float = 0.0) -> np.ndarray:
        """Readings (n, k) [m] of samples number ``first`` and following whose truth is (n, k) [m].

        ``truth`` and what is returned count from ``zero`` (k,) [m]; a quantum counts from 0.
        """
        count, columns = truth.shape
        result = truth + self._sigma * self._numbers.draw(first, count, columns)
        if self.law.spikes:
            drawn = self._uniforms('spike', first, count, 1 + columns)
            side = np.where(drawn[:, 1:] < 0.5, -1.0, 1.0)
            result += np.where(drawn[:, :1] < self.law.spikes, self.law.spike_size * self._sigma * side, 0.0)
        if self.law.quantum:
            result = np.rint((result + zero) / self.law.quantum) * self.law.quantum - zero
        if self.law.duplicates:
            result = self._repeated(result, first)
        return result

    def _repeated(self, result: np.ndarray, first: int) -> np.ndarray:
        again = self._uniforms('duplicate', first, len(result))[:, 0] < self.law.duplicates
        own = np.where(again, -1, np.arange(len(result)))
        source = np.maximum.accumulate(own)   # −1: of the call before
        before = result[0] if self._before is None or len(self._before) != result.shape[1] else self._before
        repeated = np.where(source[:, None] < 0, before, result[np.maximum(source, 0)])
        self._before = repeated[-1].copy()
        return repeated

    def forget(self) -> None:
        """What comes next repeats nothing of what was: another run, counted from another zero."""
        self._before = None

    def _uniforms(self, what: str, first: int, count: int, columns: int = 1) -> np.ndarray:
        return uniforms(self._seed, f'{self._stream}/{what}', first, count, columns)
