"""What the causes change of the volumetric error: where the tool is predicted to be without and with them."""

from dataclasses import dataclass

import numpy as np

from stepdiag_ros.estimate.prediction import volumetric_map
from stepdiag_ros.estimate.solution import Solution
from stepdiag_ros.model.description import Machine

PER_AXIS = 5


@dataclass(frozen=True)
class VolumeChange:
    """The ``largest`` change [m] of the predicted deviation, its ``sigma`` [m] with the causes taken out, ``at`` (3,)
    [m] where it is; ``rms`` [m] over the volume."""

    largest: float
    sigma: float
    at: tuple[float, float, float]
    rms: float

    def to_json_dict(self) -> dict:
        return {'largest_m': self.largest, 'sigma_m': self.sigma, 'at_m': list(self.at), 'rms_m': self.rms}


def volume_change(before: Solution, after: Solution, machine: Machine) -> VolumeChange:
    """Change from a solution that holds the causes to one freed of them."""
    old, new = (volumetric_map(solution, machine, PER_AXIS).prediction for solution in (before, after))
    change = new.deviation_m - old.deviation_m
    size = np.linalg.norm(change, axis=1)
    worst = int(np.argmax(size))
    unit = change[worst] / max(size[worst], 1e-300)
    sigma = float(np.sqrt(max(unit @ new.covariance_m2[worst] @ unit, 0.0)))
    return VolumeChange(float(size[worst]), sigma, tuple(new.points[worst].tolist()), float(np.sqrt(np.mean(size**2))))
