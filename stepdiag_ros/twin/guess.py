"""Where to begin: rough parameters of an effect's physical face, from the forms that a log was fitted with.

What an effect makes of them its class says (:meth:`~stepdiag_ros.effects.base.Effect.guess`); they are refined along
the log's own moves (:mod:`stepdiag_ros.twin.physical`).
"""

import numpy as np

from stepdiag_ros.effects.adoption import Fitted
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.gap.diagnosis import Diagnosis
from stepdiag_ros.gap.inference.joint import Active

Values = dict[str, object]


def guess(diagnosis: Diagnosis, active: list[Active]) -> Values:
    """Parameters by name, as far as the effect's forms tell them; the others are left to the fit."""
    space, effect = diagnosis.joint.parity, active[0].effect
    whole = sum(a.contribution for a in active)
    wanted = space.stop_part(whole[None])[:, 0]

    def solve(columns: np.ndarray) -> tuple[np.ndarray, float]:
        design = space.stop_part(columns)
        scale = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
        coefficients = np.linalg.lstsq(design / scale, wanted, rcond=1e-10)[0] / scale
        left = wanted - design @ coefficients
        return coefficients, float(left @ left / max(wanted @ wanted, 1e-300))

    values = effect.guess(Fitted(diagnosis.joint.observation.view, diagnosis.nominal.view, whole,
                                 tuple(a.form for a in active), tuple(a.coefficients for a in active), solve))
    unknown = sorted(set(values) - {p.name for p in effect.parameters})
    if unknown:
        raise StepdiagError(f'{effect.file}: {type(effect).__name__}.guess gives {unknown[0]!r}, which is none of its '
                            f'parameters; they are {", ".join(p.name for p in effect.parameters)}')
    return dict(values)
