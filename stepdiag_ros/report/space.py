"""A machine volume drawn in space: parallel projection, box with names and lengths of the axes.

The projection is our own instead of matplotlib's: lengths along an axis stay comparable, nothing is cut
off at a frame, what covers what is decided here, and a vector picture holds lines, no rendered image.
"""

from itertools import combinations, product

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Polygon

INK, FAINT, BOX = '#22303c', '#8a97a3', '#b9c3cc'


class Camera:
    """Parallel projection, a little from above, with ``direction`` running from left to right; m in, mm out."""

    def __init__(self, direction: np.ndarray):
        heading = np.arctan2(direction[1], direction[0]) if np.hypot(*direction[:2]) > 1e-6 else np.radians(-8.0)
        side, rise = heading - np.radians(62.0), np.radians(21.0)
        self.eye = np.array([np.cos(side) * np.cos(rise), np.sin(side) * np.cos(rise), np.sin(rise)])
        right = np.array([-np.sin(side), np.cos(side), 0.0])
        self.screen = np.stack([right, np.cross(self.eye, right)])

    def __call__(self, points: np.ndarray) -> np.ndarray:
        return points @ self.screen.T * 1e3


def draw_box(axes: Axes, camera: Camera, corner: np.ndarray, volume: np.ndarray, width: float, behind: bool) -> None:
    """A volume [m] from ``corner``: edges behind everything and the floor, or the edges before it and the names."""
    unit = np.array(list(product((0.0, 1.0), repeat=3)))
    corners = np.asarray(corner) + unit * volume
    hidden = int(np.argmin(unit @ camera.eye))
    for a, b in combinations(range(8), 2):
        if np.count_nonzero(unit[a] != unit[b]) == 1 and (hidden in (a, b)) == behind:
            axes.plot(*camera(corners[[a, b]]).T, color=BOX, linewidth=1.0 * width, zorder=1 if behind else 7,
                      linestyle=(0, (4, 3)) if behind else '-')
    if behind:
        axes.add_patch(Polygon(camera(corners[[0, 2, 6, 4]]), facecolor='#f1f4f7', edgecolor='none', zorder=0))
        return
    # Name each axis at the edge of the outline nearest to the eye: floor edges for X and Y, the left one for Z.
    flat = camera(corners)
    middle = flat.mean(axis=0)
    for axis, name in enumerate('XYZ'):
        edges = [(a, b) for a, b in combinations(range(8), 2)
                 if unit[a, axis] != unit[b, axis] and np.count_nonzero(unit[a] != unit[b]) == 1]
        score = (lambda e: flat[list(e), 0].sum()) if axis == 2 else (lambda e: flat[list(e), 1].sum())
        edge = flat[list(min(edges, key=score))]
        along = (edge[1] - edge[0]) / np.linalg.norm(edge[1] - edge[0])
        out = np.array([-along[1], along[0]])
        out = out if out @ (edge.mean(axis=0) - middle) > 0 else -out
        slope = np.degrees(np.arctan2(along[1], along[0]))
        axes.annotate(f'{name}  {volume[axis] * 1e3:.0f} mm', edge.mean(axis=0), tuple(13.0 * width * out),
                      textcoords='offset points', ha='center', va='center', fontsize=10 * width, color=INK,
                      rotation=90.0 - (90.0 - slope) % 180.0, rotation_mode='anchor')
