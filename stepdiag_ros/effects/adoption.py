"""What an effect's guess of its physical parameters is made from, and what several guesses share.

A form is what an effect leaves in a log, to first order and broad; the physical face is narrow on purpose.
:meth:`~stepdiag_ros.effects.base.Effect.guess` says roughly with which parameters it does what was fitted; from there
they are refined along the log's own moves.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from stepdiag_ros.effects.base import Form, StopView

TAUS = np.geomspace(0.02, 50.0, 60)
"""Time constants tried, in lengths of the log; the longest is a straight line."""


@dataclass(frozen=True)
class Fitted:
    """What a log was fitted with of one effect.

    ``view``: the log at the errors found; ``nominal``: at those without any effect.  ``whole`` (n, c) [m]: what all
    forms of the effect add to the readings.  ``forms`` and ``coefficients``, (k,) of each, the form first found first.
    ``solve``: coefficients (k,) of columns (k, n, c) that come nearest to ``whole`` beside the errors, and the
    share of its square that they miss.
    """

    view: StopView
    nominal: StopView
    whole: np.ndarray
    forms: tuple[Form, ...]
    coefficients: tuple[np.ndarray, ...]
    solve: Callable[[np.ndarray], tuple[np.ndarray, float]]

    @property
    def values(self) -> dict[str, float]:
        """Coefficients of the first form by name."""
        return {n: float(v) for n, v in zip(self.forms[0].names, self.coefficients[0], strict=True)}

    def exponential(self, signature: np.ndarray, since: np.ndarray) -> tuple[np.ndarray, float]:
        """Amounts (m,) of 1 − exp(−t/τ) times ``signature`` (m, n, c), reached in the end; τ [s]."""
        def tried(tau: float) -> tuple[float, np.ndarray]:
            grown = 1.0 - np.exp(-since / tau)
            sizes, missed = self.solve(grown[None, :, None] * signature)
            return missed, sizes

        shape = self.forms[0].shape
        span = max(float(since.max()), 1.0)
        tau = float(shape['tau_s']) if len(self.forms) == 1 and 'tau_s' in shape else \
            min((tried(span * f)[0], span * f) for f in TAUS)[1]
        return tried(tau)[1], float(tau)

    def profile(self, signature: np.ndarray) -> Mapping[str, object]:
        """``amp`` and ``tau`` of a signature (m, n, c) that grows from the log's first dwell on."""
        time = self.nominal.time
        sizes, tau = self.exponential(signature, time - time.min())
        return {'amp': sizes.tolist(), 'tau': tau}
