"""Frames of a machine and what stands in them, nominal: for viewers, not for evaluations.

Everything is seen from the workpiece, as the contract's machine frame is.  Axes of frames follow REP 103, x forward,
y left, z up: of the laser x is the beam's direction ``d``, y is ``u``, z is ``v``; of the mirror x is its outward
normal ``−d``.  A chain's axes follow each other from the workpiece to the tool, each shifted by its own coordinate;
an axis that carries the workpiece looks the same from there.
"""

from dataclasses import dataclass

import numpy as np

from stepdiag_ros.model.description import Description
from stepdiag_ros.model.machine import AXES
from stepdiag_ros.model.path import stops
from stepdiag_ros.model.sensor import station

BASE, SPINDLE, MIRROR, LASER, PSD = 'base_link', 'spindle', 'mirror', 'laser', 'psd'
MIRROR_LEAST_M = 0.01
"""Half size of the smallest mirror that is shown."""
MIRROR_SPARE = 1.1


@dataclass(frozen=True)
class Frame:
    """``name`` in ``parent``: ``origin`` (3,) [m], and ``axes`` (3, 3), its x, y, z as rows, in the parent."""

    name: str
    parent: str
    origin: np.ndarray
    axes: np.ndarray

    @property
    def quaternion(self) -> np.ndarray:
        """The turn from parent to frame, (x, y, z, w) of unit length."""
        m = self.axes.T
        # The largest component first, so that nothing is divided by what may be zero.
        squares = np.array([1.0 + m[0, 0] - m[1, 1] - m[2, 2], 1.0 - m[0, 0] + m[1, 1] - m[2, 2],
                            1.0 - m[0, 0] - m[1, 1] + m[2, 2], 1.0 + np.trace(m)])
        products = np.array([[squares[0], m[0, 1] + m[1, 0], m[0, 2] + m[2, 0], m[2, 1] - m[1, 2]],
                             [m[0, 1] + m[1, 0], squares[1], m[1, 2] + m[2, 1], m[0, 2] - m[2, 0]],
                             [m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], squares[2], m[1, 0] - m[0, 1]],
                             [m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], squares[3]]])
        chosen = products[int(np.argmax(squares))]
        return chosen / np.linalg.norm(chosen)


def axis_frames(chain: str, position: np.ndarray) -> list[Frame]:
    """The axes at a commanded ``position`` (3,) [m], from the workpiece to the tool."""
    frames, parent = [], BASE
    for letter in chain.replace('F', ''):
        number = AXES.index(letter)
        frames.append(Frame(f'{letter.lower()}_axis', parent, np.eye(3)[number] * position[number], np.eye(3)))
        parent = frames[-1].name
    return frames


class View:
    """One setup of a description as it is looked at; lengths [m], machine frame.

    ``path`` (n, 3): the mirror's reference point at the stops; ``corner``, ``volume`` (3,): what it can reach;
    ``triad`` (3, 3): rows u, v, d; ``origin`` (3,): the base unit; ``starts`` (k, 3): of the beams; ``psd_start`` (3,).
    ``mirror_centre``, ``mirror_half`` (2,): along u and v from the reference point, of the smallest mirror that every
    beam meets at every stop.
    """

    def __init__(self, description: Description, setup: str):
        machine, given = description.machine, description.setups[setup]
        base = station(machine, given)
        self.setup, self.chain = setup, machine.chain
        self.tool = np.array(machine.tool)
        self.corner, self.volume = self.tool, np.array(machine.volume)
        self.path = stops(description, setup).positions + self.tool
        self.triad, self.origin = base.triad, base.origin
        self.starts = base.beam_origins(np.array(given.beams))
        self.psd_start = base.beam_origins(np.array(given.psd_offset))[0]
        met = (np.array([*self.starts, self.psd_start])[:, None] - self.path) @ self.triad[:2].T
        low, high = met.min(axis=(0, 1)), met.max(axis=(0, 1))
        self.mirror_centre = (low + high) / 2.0
        self.mirror_half = np.maximum(MIRROR_SPARE * (high - low) / 2.0, MIRROR_LEAST_M)

    def strikes(self, position: np.ndarray) -> np.ndarray:
        """Where the beams, the detector's last, meet the mirror at a commanded position: (k + 1, 3)."""
        d, point = self.triad[2], np.asarray(position, float) + self.tool
        starts = np.array([*self.starts, self.psd_start])
        return starts + ((point - starts) @ d)[:, None] * d

    def fixed_frames(self) -> list[Frame]:
        """What does not move while this setup is measured: spindle, mirror, laser, detector."""
        u, v, d = self.triad
        last = f'{self.chain.replace("F", "")[-1].lower()}_axis'
        detector = np.array([d, u, v]) @ (self.psd_start - self.origin)
        return [Frame(SPINDLE, last, np.zeros(3), np.eye(3)),
                Frame(MIRROR, SPINDLE, self.tool, np.array([-d, -u, v])),
                Frame(LASER, BASE, self.origin, np.array([d, u, v])),
                Frame(PSD, LASER, detector, np.eye(3))]
