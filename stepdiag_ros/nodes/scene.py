"""Frames and markers of what a machine does: ``tf``, ``tf_static`` and ``scene``, for RViz, Foxglove and the like.

They follow the stops, not the samples: a frame at the begin and at the end of each move, between which viewers
interpolate, and once a second at rest for those who come later; the markers when the machine stands.  So a bag holds a
few kilobytes a stop of them.  Frames bear the machine's namespace, ``demo/base_link``, and the topics stand below it.
"""

from collections.abc import Sequence

import numpy as np
from geometry_msgs.msg import Point, Quaternion, Transform, TransformStamped, Vector3
from rclpy.lifecycle import LifecycleNode
from std_msgs.msg import ColorRGBA, Header
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import Marker, MarkerArray

from stepdiag_ros.bag.shown import FIXED_FRAMES, FRAMES, SCENE
from stepdiag_ros.devices.hostclock import HOST
from stepdiag_ros.model.description import Description
from stepdiag_ros.model.frames import BASE, LASER, MIRROR, Frame, View, axis_frames
from stepdiag_ros.model.log import DWELL, MOVE
from stepdiag_ros.nodes.base import overridable, reliable
from stepdiag_ros.nodes.stamps import stamp_of

DEPTH = 100
#: Colours of the pages, red, green, blue.
BOX, PATH, BODY, GLASS, BEAM, SPOT = ((0.55, 0.6, 0.65), (0.09, 0.41, 0.54), (0.45, 0.5, 0.55), (0.18, 0.5, 0.71),
                                      (0.82, 0.19, 0.29), (0.88, 0.56, 0.04))
LINE_M, THICK_M = 0.002, 0.01
LETTERS_M = 0.03


class SceneTopics:
    """Publishes the scene of the machine whose sequencer ``node`` is."""

    def __init__(self, node: LifecycleNode):
        def publisher(kind: type, topic: str, depth: int, latched: bool):
            return node.create_lifecycle_publisher(kind, topic, reliable(depth, latched=latched),
                                                   qos_overriding_options=overridable())
        self._frames = publisher(TFMessage, FRAMES, DEPTH, False)
        self._fixed = publisher(TFMessage, FIXED_FRAMES, 1, True)
        self._scene = publisher(MarkerArray, SCENE, 1, True)
        self._prefix = f'{node.get_namespace().strip("/")}/'.lstrip('/')
        self._view: View | None = None
        self._run = ''
        self._position: np.ndarray | None = None    # where the machine stands; None: it moves, or nobody knows
        self._last: np.ndarray | None = None
        node.every(1.0, self._at_rest)

    def announce(self, description: Description, run_id: str, setup: str, position: Sequence[float], phase: int,
                 time_ns: int) -> None:
        """The machine begins to move to a commanded ``position`` [m], or stands there (the sequencer's thread)."""
        if phase not in (MOVE, DWELL):
            return
        if run_id != self._run or self._view is None:
            self._run, self._view = run_id, View(description, setup)
            self._publish(self._fixed, self._view.fixed_frames(), time_ns)
        if phase == MOVE:
            self._position = None
            if self._last is not None:
                self._publish(self._frames, axis_frames(self._view.chain, self._last), time_ns)
            return
        self._last = np.array(position, float)
        self._publish(self._frames, axis_frames(self._view.chain, self._last), time_ns)
        self._scene.publish(MarkerArray(markers=markers(self._view, self._last, run_id, self._prefix, time_ns)))
        self._position = self._last

    def forget(self) -> None:
        """Nobody knows where the machine stands."""
        self._view = self._position = self._last = None
        self._run = ''

    def _at_rest(self) -> None:
        position, view = self._position, self._view
        if position is not None and view is not None:
            self._publish(self._frames, axis_frames(view.chain, position), HOST.now_ns())

    def _publish(self, publisher, frames: Sequence[Frame], time_ns: int) -> None:
        publisher.publish(TFMessage(transforms=[_transform(frame, self._prefix, time_ns) for frame in frames]))


def markers(view: View, position: np.ndarray, run_id: str, prefix: str, time_ns: int) -> list[Marker]:
    """The scene at a stop: volume, path, base unit, mirror, beams, and which run it is."""
    header = {name: Header(stamp=stamp_of(time_ns), frame_id=prefix + name) for name in (BASE, LASER, MIRROR)}
    strikes = view.strikes(position)
    beams = [point for both in zip(view.starts, strikes[:-1], strict=True) for point in both]
    size = max(0.04, 0.06 * float(np.linalg.norm(view.volume)))
    (cu, cv), (hu, hv) = view.mirror_centre, view.mirror_half
    return [
        _marker(header[BASE], 'volume', Marker.LINE_LIST, BOX, 0.8, (LINE_M, 0.0, 0.0),
                _edges(view.corner, view.volume)),
        _marker(header[BASE], 'path', Marker.LINE_STRIP, PATH, 0.8, (LINE_M, 0.0, 0.0), view.path),
        _marker(header[LASER], 'laser', Marker.CUBE, BODY, 1.0, (2.0 * size, size, size), at=(-size, 0.0, 0.0)),
        _marker(header[MIRROR], 'mirror', Marker.CUBE, GLASS, 0.7, (THICK_M, 2.0 * hu, 2.0 * hv),
                at=(-THICK_M / 2.0, -cu, cv)),
        _marker(header[BASE], 'beam', Marker.LINE_LIST, BEAM, 1.0, (2.0 * LINE_M, 0.0, 0.0), beams),
        _marker(header[BASE], 'psd_beam', Marker.LINE_STRIP, SPOT, 1.0, (LINE_M, 0.0, 0.0),
                (view.psd_start, strikes[-1])),
        _marker(header[BASE], 'run', Marker.TEXT_VIEW_FACING, PATH, 1.0, (0.0, 0.0, LETTERS_M), text=run_id,
                at=view.corner + (0.0, 0.0, view.volume[2] + 2.0 * LETTERS_M))]


def _marker(header: Header, name: str, kind: int, colour: Sequence[float], opacity: float, scale: Sequence[float],
            points: Sequence[np.ndarray] = (), at: Sequence[float] = (0.0, 0.0, 0.0), text: str = '') -> Marker:
    # Locked to its frame: it moves with it, and a viewer may look at it at any time.
    marker = Marker(header=header, ns=name, type=kind, action=Marker.ADD, frame_locked=True, text=text,
                    scale=_vector(scale), points=[Point(**_xyz(p)) for p in points],
                    color=ColorRGBA(**dict(zip('rgb', map(float, colour), strict=True)), a=opacity))
    marker.pose.position = Point(**_xyz(at))
    return marker


def _edges(corner: np.ndarray, size: np.ndarray) -> list[np.ndarray]:
    """The twelve edges of a box, two points each."""
    ends = []
    for axis in range(3):
        for other in np.ndindex(2, 2):
            low = np.insert(np.array(other, float), axis, 0.0)
            ends += [corner + low * size, corner + (low + np.eye(3)[axis]) * size]
    return ends


def _xyz(values: Sequence[float]) -> dict[str, float]:
    return dict(zip('xyz', map(float, values), strict=True))


def _vector(values: Sequence[float]) -> Vector3:
    return Vector3(**_xyz(values))


def _transform(frame: Frame, prefix: str, time_ns: int) -> TransformStamped:
    x, y, z, w = map(float, frame.quaternion)
    return TransformStamped(
        header=Header(stamp=stamp_of(time_ns), frame_id=prefix + frame.parent), child_frame_id=prefix + frame.name,
        transform=Transform(translation=_vector(frame.origin), rotation=Quaternion(x=x, y=y, z=z, w=w)))
