"""What the log of a regulated beam says besides its lengths: how well it was held, and whether its angles agree.

The lengths alone find the station.  Where azimuth and elevation of the beam were measured they are a second way to it:
from the station found to where the machine says that the retroreflector is there is a direction at every stop, and the
measured angles must be these directions, up to a turn of the steering's base, three angles that nobody measures.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from stepdiag_ros.estimate.reduce import StopTable, dwell_means
from stepdiag_ros.model.log import CalibrationLog
from stepdiag_ros.model.regulation import angles_of, missed, steering_frame

FAR_M = 1e-3
"""Angles that put the retroreflector farther than this from where lengths and machine have it do not agree."""
LEAST = 3
"""Stops from which a turn of the base can be told."""


def held_beams(log: CalibrationLog, table: StopTable, stations: Mapping[str, Mapping[str, Any]]
               ) -> tuple[dict[str, dict[str, float | list[float] | None]], list[str]]:
    """By setup ``spot_rms_m`` over its dwells, ``angle_rms_rad`` by which the measured angles differ from the
    directions and ``turn_rad`` of the base (3,), both None where angles were not measured; and what does not agree,
    in words."""
    found, warnings = {}, []
    for name, setup in log.description.setups.items():
        if not setup.regulated or name not in stations:
            continue
        mine = table.setup == table.setup_names.index(name)
        arm = table.commanded[mine] + np.array(setup.tool_of(log.description.machine)) - stations[name]['position_m']
        spot = dwell_means(log.spot, table, name)[mine]
        beam = dwell_means(log.beam_angle, table, name)[mine]
        # The beam points where the mirrors turn it; the retroreflector is where the spot says beside it.
        seen = beam + missed(spot, beam[:, 1], np.linalg.norm(arm, axis=1))
        rms, turn = _agreement(steering_frame(log.description.machine, setup), arm, seen)
        found[name] = {'spot_rms_m': float(np.sqrt(np.nanmean(spot ** 2))) if np.isfinite(spot).any() else None,
                       'angle_rms_rad': rms, 'turn_rad': turn}
        off = 0.0 if rms is None else rms * float(np.linalg.norm(arm, axis=1).mean())
        if off > FAR_M:
            warnings.append(f'{log.source}: setup {name}: the measured angles of the beam put the retroreflector '
                            f'{1e3 * off:.2g} mm (rms) from where lengths and machine have it; check psd/beam_angle '
                            '(azimuth first, in rad), and where the station is said to stand')
    return found, warnings


def _agreement(frame: np.ndarray, arm: np.ndarray, angles: np.ndarray) -> tuple[float | None, list[float] | None]:
    good = np.isfinite(angles).all(axis=1)
    if good.sum() < LEAST:
        return None, None
    arm, difference = arm[good], angles[good] - angles_of(frame, arm[good])
    # A base turned by w sees the arm turned back by it.
    turned = [angles_of(frame, arm - 1e-6 * np.cross(axis, arm)) - angles_of(frame, arm) for axis in np.eye(3)]
    columns = np.stack([t.ravel() for t in turned], axis=1) * 1e6
    turn, *_ = np.linalg.lstsq(columns, difference.ravel(), rcond=None)
    rest = difference.ravel() - columns @ turn
    return float(np.sqrt(np.sum(rest ** 2) / (len(rest) - 3))), turn.tolist()
