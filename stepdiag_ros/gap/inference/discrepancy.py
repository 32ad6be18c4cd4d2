"""The discrepancy of a form: what reality may do beside it, as columns of known size.

No form is right to the last part.  What an effect truly does is taken to be what its form does, times one plus a
random function g of standard deviation δ, ``DISCREPANCY_SHARE`` (Kennedy and O'Hagan, Bayesian calibration of
computer models, J. R. Stat. Soc. B 63, 2001, with a discrepancy in proportion to the effect).  g may differ from setup
to setup, from run to run, with the direction, along each axis and slowly with time, each of these being as likely as
the others.  With the contribution c of a form at its coefficients the readings' covariance grows by

    δ² · P diag(c) K diag(c) Pᵀ = D Dᵀ,   K = Φᵀ Φ,

Φ (m, n) being :func:`modulations`, P the way into parity space.  Of an effect near the noise D is nothing; of one of
hundreds of standard deviations it is all that matters: by how much a wrong form falls behind saturates at what the
share allows, however large the effect, and what a further effect explains must exceed what the first may leave over.
"""

from dataclasses import dataclass

import numpy as np

from stepdiag_ros.effects.base import StopView
from stepdiag_ros.gap.constants import DISCREPANCY_SHARE
from stepdiag_ros.gap.inference.joint import Joint, unexplained
from stepdiag_ros.gap.inference.parity import Parity

LEAST = 1.0
"""A discrepancy of less than this many standard deviations in all is left out: it changes no evidence by a half."""
WAVES_IN_TIME, WAVES_IN_PLACE = 6, 3


def modulations(view: StopView) -> np.ndarray:
    """Functions Φ (m, n) over the stops whose random sum has variance one on the average of the stops."""
    place = view.commanded / np.array(view.description.machine.volume)
    span = max(float(np.ptp(view.time)), 1e-9)
    time = (view.time - view.time.min()) / span
    families = [
        np.stack([(view.setup == s).astype(float) for s in np.unique(view.setup)]),
        np.stack([(view.run == r).astype(float) for r in np.unique(view.run)]),
        view.direction[None].astype(float),
        np.stack([np.cos(np.pi * k * place[:, a]) / k for a in range(3) for k in range(1, WAVES_IN_PLACE + 1)]),
        np.stack([np.cos(np.pi * k * time) / k for k in range(1, WAVES_IN_TIME + 1)]),
    ]
    families = [f / np.sqrt(max(np.mean(np.sum(f**2, axis=0)), 1e-12)) for f in families]
    return np.concatenate(families) / np.sqrt(len(families))


def columns(space: Parity, contribution: np.ndarray, inside: np.ndarray | None, functions: np.ndarray) -> np.ndarray:
    """The discrepancy D (N, m) of what an effect adds to the stops (n, c) [m] and inside the dwells (n, b, c) [m], None
    where nothing happens there, by the ``functions`` (m, n) of :func:`modulations`; each column of size one."""
    functions = DISCREPANCY_SHARE * functions
    result = np.zeros((space.size, len(functions)))
    result[:space.stops] = space.stop_part(functions[:, :, None] * contribution)
    if inside is not None:
        result[space.stops:] = space.bin_part(functions[:, :, None, None] * inside)
    return result


@dataclass(frozen=True)
class Likeliest:
    """What the discrepancies of a joint fit's forms are likeliest to do: ``added`` (n, c) [m] to the stops, white and
    projected ``white`` (N,); ``price``: by how much less likely it is than nothing, ½ hᵀh + ½ ln|1 + DᵀD|."""

    added: np.ndarray
    white: np.ndarray
    price: float

    @classmethod
    def of(cls, joint: Joint) -> 'Likeliest':
        space, active, view = joint.parity, joint.active, joint.observation.view
        if not active:
            return cls(np.zeros(view.reading.shape), np.zeros(space.size), 0.0)
        functions = modulations(view)
        whole = np.concatenate([columns(space, a.contribution, None if a.form.inside is None else a.inside, functions)
                                for a in active], axis=1)
        normal = whole.T @ whole + np.eye(whole.shape[1])
        sizes = np.linalg.solve(normal, whole.T @ unexplained(space, active))
        by_form = DISCREPANCY_SHARE * sizes.reshape(len(active), -1) @ functions
        return cls(sum(share[:, None] * a.contribution for share, a in zip(by_form, active, strict=True)),
                   whole @ sizes, 0.5 * float(sizes @ sizes + np.linalg.slogdet(normal)[1]))


def residual(joint: Joint) -> np.ndarray:
    """White residuals (N,) of a joint fit, freed of what the discrepancies of its forms are likeliest to do."""
    return unexplained(joint.parity, joint.active) - Likeliest.of(joint).white
