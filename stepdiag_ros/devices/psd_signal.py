"""From photocurrents to a spot: the arithmetic of a two-dimensional PSD and back.

A duo-lateral detector of edge length L has two electrodes along x and two along y, and
the whole photocurrent flows through each pair:
``x = (L/2)(I2 − I1)/(I1 + I2)``, ``y = (L/2)(I4 − I3)/(I3 + I4)``.
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class SpotOptics:
    """How a detector is built and mounted.

    ``length`` [m] of its edge; ``rotation`` [rad] from its x to the setup's u; ``gain``
    multiplies its x and y; ``zero`` [m] in its own axes is taken off first; below
    ``dark_V`` [V] of sum signal there is no spot.
    """

    length: float = 0.010
    rotation: float = 0.0
    gain: tuple[float, float] = (1.0, 1.0)
    zero: tuple[float, float] = (0.0, 0.0)
    dark_V: float = 0.05

    def spot(self, volts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n, 4) [V] of I1…I4 → spot (n, 2) [m] along u and v, and sum signal (n,) [V].

        Spots without light are NaN.
        """
        volts = np.asarray(volts, float)
        pair = np.stack([volts[:, 0] + volts[:, 1], volts[:, 2] + volts[:, 3]], axis=1)
        intensity = pair.mean(axis=1)
        lit = (pair > self.dark_V).all(axis=1)
        share = np.full((len(volts), 2), np.nan)
        share[lit, 0] = (volts[lit, 1] - volts[lit, 0]) / pair[lit, 0]
        share[lit, 1] = (volts[lit, 3] - volts[lit, 2]) / pair[lit, 1]
        own = (0.5 * self.length * share - np.array(self.zero)) * np.array(self.gain)
        return own @ self._turn().T, intensity

    def volts(self, spot: np.ndarray, intensity: np.ndarray) -> np.ndarray:
        """The inverse: spot (n, 2) [m], sum signal (n,) [V] → (n, 4) [V]; dark beyond the edge."""
        own = np.asarray(spot, float) @ self._turn() / np.array(self.gain) + np.array(self.zero)
        share = own / (0.5 * self.length)
        light = np.where((np.abs(share) <= 1.0).all(axis=1), intensity, 0.0)
        share = np.clip(share, -1.0, 1.0)
        half = 0.5 * light[:, None]
        return np.stack([half[:, 0] * (1.0 - share[:, 0]), half[:, 0] * (1.0 + share[:, 0]),
                         half[:, 0] * (1.0 - share[:, 1]), half[:, 0] * (1.0 + share[:, 1])], axis=1)

    def _turn(self) -> np.ndarray:
        cosine, sine = np.cos(self.rotation), np.sin(self.rotation)
        return np.array([[cosine, -sine], [sine, cosine]])
