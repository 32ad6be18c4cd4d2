"""The full kinematic model of a log and its analytic Jacobian.

Predicts the distance of every beam and the spot at every stop from the unknowns
of :mod:`stepdiag_ros.estimate.parameters`; nothing is linearised.  What a stop reads of the
pose is its setup's observation: a beam that stands still and meets a mirror, or one that follows a
retroreflector from a station.  Derivatives are carried forward along the 18 motions of the three axes and
what is unknown of a setup (four angles of one with a mirror, three coordinates of a station) and then
spread over the unknowns, of which each stop meets only a few.
"""

import numpy as np
from scipy import sparse

from stepdiag_ros.estimate.level import Heights
from stepdiag_ros.estimate.parameters import OF_SETUPS, Parameters, curve_matrices
from stepdiag_ros.estimate.reduce import StopTable
from stepdiag_ros.model.description import Description
from stepdiag_ros.model.machine import chain_from_tool, rotation
from stepdiag_ros.model.sensor import distance, station

DIRECTIONS = 18 + len(OF_SETUPS)
OF_STATION = slice(22, 25)


class ForwardModel:
    """Predictions for the stops of one table.

    Channels of a stop are its beams, then spot x, spot y: ``beams + 2``.  Predictions are
    absolute distances; the reset offset of a run is one of the unknowns and is added.  ``believed``: unknowns (size,)
    from which level stations have what the machine is off across their planes (:mod:`stepdiag_ros.estimate.level`),
    those that a prediction is asked for when not given.
    """

    def __init__(self, description: Description, table: StopTable, parameters: Parameters,
                 believed: np.ndarray | None = None):
        self.parameters = parameters
        self.chain = description.machine.chain
        self.commanded = table.commanded
        self.beams = table.displacement.shape[1]
        self._curves = curve_matrices(parameters, table.commanded)
        n = len(table)
        self.size = n
        stations = {s: station(description.machine, description.setups[s])
                    for s in parameters.setups}
        names = np.array(table.setup_names, dtype=object)[table.setup]
        self.tool = np.array([description.setups[s].tool_of(description.machine) for s in names]).reshape(-1, 3)
        self.follows = np.array([description.setups[s].follows for s in names], bool)
        self.places = np.array([description.setups[s].station or np.zeros(3) for s in names]).reshape(-1, 3)
        self._heights = Heights.of_stops(description, names[self.follows])
        self._across: np.ndarray | None = None
        self._triad = np.array([stations[s].triad for s in names])
        starts = {s: stations[s].beam_origins(np.array(
            (*description.setups[s].beams[:self.beams], description.setups[s].psd_offset)))
            for s in parameters.setups}
        self._origin = np.moveaxis(np.array([starts[s] for s in names]), 1, 0)
        columns = {s: [parameters.setup_first[s] + parameters.unknowns[s].index(what)
                       if what in parameters.unknowns[s] else -1 for what in OF_SETUPS] for s in parameters.setups}
        self._setup_column = np.array([columns[s] for s in names]).reshape(-1, len(OF_SETUPS))
        self._offset_column = (parameters.offset_first + table.run[:, None] * self.beams
                               + np.arange(self.beams))
        if believed is not None:
            self._across = self.across(believed)

    # ---- geometry ---------------------------------------------------------------------------

    def motions(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Shifts and turns of the three axes at each stop: two (3, n, 3) [m], [rad]."""
        values = np.stack([matrix @ theta for matrix in self._curves])
        both = np.moveaxis(values.reshape(3, 2, 3, self.size), 2, 3)
        shifts = both[:, 0].copy()
        for axis in range(3):
            shifts[axis, :, axis] += self.commanded[:, axis]
        return shifts, both[:, 1]

    def _pose(self, shifts: np.ndarray, turns: np.ndarray, derivative: bool):
        """Point, attitude and their derivatives along the 18 motions, (18, n, 3), (18, n, 3, 3)."""
        matrices = rotation(turns)
        point = np.broadcast_to(self.tool, (self.size, 3))
        attitude = np.broadcast_to(np.eye(3), (self.size, 3, 3))
        d_point = np.zeros((18, self.size, 3))
        d_attitude = np.zeros((18, self.size, 3, 3))
        generators = rotation(np.eye(3)) - np.eye(3)
        for axis, carries_workpiece in chain_from_tool(self.chain):
            turn, six = matrices[axis], slice(6 * axis, 6 * axis + 3)
            turned = slice(6 * axis + 3, 6 * axis + 6)
            arm = shifts[axis] + point if carries_workpiece else point
            if derivative:
                d_point = np.einsum('nij,dnj->dni', turn, d_point)
                d_attitude = turn @ d_attitude
                if carries_workpiece:
                    d_point[six] = np.moveaxis(turn, 2, 0)
                else:
                    d_point[six] = np.eye(3)[:, None, :]
                d_point[turned] = np.einsum('kij,nj->kni', generators, arm)
                d_attitude[turned] = np.einsum('kij,njl->knil', generators, attitude)
            point = np.einsum('nij,nj->ni', turn, arm) + (0.0 if carries_workpiece else shifts[axis])
            attitude = turn @ attitude
        return point, attitude, d_point, d_attitude

    def _directions(self, theta: np.ndarray):
        """Beam and un-turned mirror normal of each stop, and their derivatives by their two angles."""
        angles = self._of_setups(theta)
        beam, d_beam = _turned(self._triad, angles[:, :2])
        normal, d_normal = _turned(self._triad, angles[:, 2:4])
        return beam, d_beam, -normal, -d_normal

    def _of_setups(self, theta: np.ndarray) -> np.ndarray:
        """What each stop's setup has (n, 7) of :data:`OF_SETUPS`, zero where it has none of it."""
        return np.where(self._setup_column >= 0, theta[self._setup_column], 0.0)

    @property
    def has_level_stations(self) -> bool:
        """Whether a station may stand in the plane of its targets."""
        return bool(np.any((self._heights.axis >= 0) & self._heights.level))

    def across(self, theta: np.ndarray) -> np.ndarray:
        """What the machine is off (k,) [m] across the plane of its targets, at the k stops that follow."""
        point, *_ = self._pose(*self.motions(theta), derivative=False)
        return self._heights.errors(point[self.follows] - self.places[self.follows])

    def _followed(self, theta: np.ndarray, point: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Of the k stops that follow a retroreflector: lengths (k,) [m], their derivatives (k, 3) by its place, and
        (k, 3) by what is unknown of the station."""
        own, heights = self.follows, self._heights
        unknown = self._of_setups(theta)[own, 4:]
        rows = np.flatnonzero(heights.axis >= 0)
        across, moved, up = heights.axis[rows], unknown.copy(), np.zeros(len(unknown))
        up[rows], moved[rows, across] = unknown[rows, across], 0.0
        arms = point[own] - self.places[own] - moved
        believed = heights.errors(arms) if self._across is None else self._across
        length, by_place, by_height = heights.lengths(arms, up, believed)
        by_station = -by_place
        by_station[rows, across] = by_height[rows]
        return length, by_place, by_station

    def station(self, theta: np.ndarray, covariance: np.ndarray, setup: str) -> tuple[np.ndarray, np.ndarray]:
        """How far a station stands from where it is said to stand (3,) [m], and its standard uncertainty (3,) [m]."""
        first = self.parameters.setup_first[setup]
        columns = slice(first, first + 3)
        found, sigma = theta[columns].copy(), np.sqrt(np.diag(covariance)[columns])
        stop = np.flatnonzero(self._setup_column[self.follows, 4] == first)[:1]
        heights = Heights(*(part[stop] for part in (self._heights.axis, self._heights.stated, self._heights.unit)))
        axis = int(heights.axis[0])
        if axis >= 0:
            off = found[axis:axis + 1]
            sigma[axis] = heights.sigma(off, sigma[axis:axis + 1])[0]
            found[axis] = heights.moved(off)[0]
        return found, sigma

    # ---- predictions ------------------------------------------------------------------------

    def predict(self, theta: np.ndarray) -> np.ndarray:
        """Readings (n, beams + 2) [m] for the unknowns ``theta``."""
        point, attitude, _, _ = self._pose(*self.motions(theta), derivative=False)
        beam, _, mounted, _ = self._directions(theta)
        normal = np.einsum('nij,nj->ni', attitude, mounted)
        readings = np.empty((self.size, self.beams + 2))
        for k in range(self.beams):
            readings[:, k] = distance(point, normal, self._origin[k], beam)
        readings[:, self.beams:] = self._spot(point, normal, beam)
        if self.follows.any():
            readings[self.follows] = 0.0
            readings[self.follows, 0] = self._followed(theta, point)[0]
        readings[:, :self.beams] += theta[self._offset_column]
        return readings

    def _spot(self, point, normal, beam):
        # spot() projects on one triad; here each stop has its own.
        d = self._triad[:, 2]
        cosine = np.sum(beam * normal, -1)
        out = np.sum((point - self._origin[-1]) * normal, -1) / cosine
        back = beam - (2.0 * cosine / np.sum(normal * normal, -1))[:, None] * normal
        home = -out * np.sum(beam * d, -1) / np.sum(back * d, -1)
        path = out[:, None] * beam + home[:, None] * back
        return np.einsum('nki,ni->nk', self._triad[:, :2], path)

    def local_derivatives(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Readings (n, c), their derivatives by the 25 directions (25, n, c), and by a turn of the
        mirror about its reference point along (u, v) and a shift along the axes (5, n, c)."""
        point, attitude, d_point, d_attitude = self._pose(*self.motions(theta), derivative=True)
        beam, d_beam, mounted, d_mounted = self._directions(theta)
        normal = np.einsum('nij,nj->ni', attitude, mounted)
        n, zero = self.size, np.zeros((2, self.size, 3))
        turns = np.moveaxis(self._triad[:, :2], 1, 0)
        nothing = np.zeros((3, n, 3))
        point_by = np.concatenate([d_point, zero, zero, nothing, zero,
                                   np.broadcast_to(np.eye(3)[:, None], (3, n, 3))])
        normal_by = np.concatenate([np.einsum('dnij,nj->dni', d_attitude, mounted), zero,
                                    np.einsum('nij,dnj->dni', attitude, d_mounted), nothing,
                                    np.cross(turns, normal), nothing])
        beam_by = np.concatenate([np.zeros((18, n, 3)), d_beam, zero, nothing, zero, nothing])
        derivative = np.empty((DIRECTIONS + 5, n, self.beams + 2))
        readings = np.empty((n, self.beams + 2))
        for k in range(self.beams):
            readings[:, k], derivative[:, :, k] = _distance_by(
                point, normal, beam, self._origin[k], point_by, normal_by, beam_by)
        readings[:, self.beams:], derivative[:, :, self.beams:] = _spot_by(
            point, normal, beam, self._origin[-1], self._triad, point_by, normal_by, beam_by)
        if self.follows.any():
            own = self.follows
            length, by_place, by_station = self._followed(theta, point)
            readings[own], derivative[:, own] = 0.0, 0.0
            readings[own, 0] = length
            derivative[:, own, 0] = np.einsum('dni,ni->dn', point_by[:, own], by_place)
            derivative[OF_STATION, own, 0] = by_station.T
        readings[:, :self.beams] += theta[self._offset_column]
        return readings, derivative[:DIRECTIONS], derivative[DIRECTIONS:]

    def jacobian(self, theta: np.ndarray) -> tuple[np.ndarray, sparse.csr_array, np.ndarray]:
        """Readings (n, c), the sparse Jacobian (n·c, size), rows [stop, channel], and the five
        derivatives by arrival errors of :meth:`local_derivatives`."""
        readings, local, arrival = self.local_derivatives(theta)
        n, channels = readings.shape
        rows, columns, values = [], [], []
        row = np.arange(n)[:, None] * channels + np.arange(channels)
        for place, matrix in enumerate(self._curves):
            coo = matrix.tocoo()
            rows.append(row[coo.row].ravel())
            columns.append(np.repeat(coo.col, channels))
            values.append((coo.data[:, None] * local[place][coo.row]).ravel())
        for k in range(len(OF_SETUPS)):
            own = self._setup_column[:, k] >= 0
            rows.append(row[own].ravel())
            columns.append(np.repeat(self._setup_column[own, k], channels))
            values.append(local[18 + k][own].ravel())
        for k in range(self.beams):
            rows.append(row[:, k])
            columns.append(self._offset_column[:, k])
            values.append(np.ones(n))
        matrix = sparse.csr_array(
            (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))),
            shape=(n * channels, self.parameters.size))
        return readings, matrix, arrival


def _turned(triad: np.ndarray, angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """``d`` turned by (n, 2) angles about u, v, unit length (n, 3); derivatives (2, n, 3)."""
    u, v, d = triad[:, 0], triad[:, 1], triad[:, 2]
    raw = d - angles[:, :1] * v + angles[:, 1:] * u
    length = np.linalg.norm(raw, axis=1, keepdims=True)
    unit = raw / length
    by = np.stack([-v, u])
    return unit, (by - unit * np.sum(by * unit, -1, keepdims=True)) / length


def _distance_by(point, normal, beam, origin, point_by, normal_by, beam_by):
    """Distance (n,) and its derivatives (d, n) along the given ones of point, normal and beam."""
    cosine = np.sum(beam * normal, -1)
    arm = point - origin
    length = np.sum(arm * normal, -1) / cosine
    lateral = arm - length[:, None] * beam
    by = (np.einsum('dni,ni->dn', point_by, normal) + np.einsum('dni,ni->dn', normal_by, lateral)
          - length * np.einsum('dni,ni->dn', beam_by, normal)) / cosine
    return length, by


def _spot_by(point, normal, beam, origin, triad, point_by, normal_by, beam_by):
    """Spot (n, 2) and its derivatives (d, n, 2) along the given ones of point, normal and beam."""
    d = triad[:, 2]
    out, out_by = _distance_by(point, normal, beam, origin, point_by, normal_by, beam_by)
    square = np.sum(normal * normal, -1)
    factor = 2.0 * np.sum(beam * normal, -1) / square
    factor_by = (2.0 * (np.einsum('dni,ni->dn', beam_by, normal)
                        + np.einsum('dni,ni->dn', normal_by, beam))
                 - 2.0 * factor * np.einsum('dni,ni->dn', normal_by, normal)) / square
    back = beam - factor[:, None] * normal
    back_by = beam_by - factor_by[..., None] * normal - factor[:, None] * normal_by
    forth_d, back_d = np.sum(beam * d, -1), np.sum(back * d, -1)
    home = -out * forth_d / back_d
    home_by = (-out_by * forth_d - out * np.einsum('dni,ni->dn', beam_by, d)
               - home * np.einsum('dni,ni->dn', back_by, d)) / back_d
    path = out[:, None] * beam + home[:, None] * back
    path_by = (out_by[..., None] * beam + out[:, None] * beam_by
               + home_by[..., None] * back + home[:, None] * back_by)
    across = triad[:, :2]
    return np.einsum('nki,ni->nk', across, path), np.einsum('nki,dni->dnk', across, path_by)
