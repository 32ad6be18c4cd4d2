"""What the closed forms of the literature take, out of a log whose setups have ways of their own.

The joint estimate needs none of this: to it every way is stops and a beam.  The older methods know faces and lines by
name, from one corner or along one edge; here they are found by where a setup begins and ends, whatever it is called.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate import linear_lines, multilateration, regulated_beam, three_face
from stepdiag_ros.estimate.linear_lines import Lines
from stepdiag_ros.estimate.noise import FLOOR_M
from stepdiag_ros.estimate.readings import CellReadings, SetupReadings
from stepdiag_ros.estimate.solution import Solution
from stepdiag_ros.estimate.stepwise import travel_signs
from stepdiag_ros.model.description import DIAGONALS, LINEAR
from stepdiag_ros.model.machine import AXES, Curve, GeometricErrors, tool_pose

SAME_M = 1e-6
LEVEL_M = 1e-3
"""By how much a station may stand out of the plane of a rectangle that a plane method evaluates."""
TURN_RAD = 1e-6
"""By how much an axis is turned to see its arm."""


def of_kind(cell: CellReadings, *kinds: str) -> list[str]:
    """Names of the setups with ways of their own of these ``kinds`` (``Setup.kind`` of the description)."""
    return [name for name, setup in cell.setups.items() if setup.sight.kind in kinds]


def with_mirror(cell: CellReadings) -> list[SetupReadings]:
    """The setups whose beam stands still."""
    return [setup for setup in cell.setups.values() if setup.sight.station is None]


def stations_lack(cell: CellReadings) -> str | None:
    """What multilateration misses in a log, in words."""
    if _one_grid(cell):
        return None
    have = sum(1 for setup in cell.setups.values() if setup.sight.station is not None and _grid_of(setup))
    return ('distances to one and the same grid from three stations in the plane XY, or from four in space '
            f'(has {have} of some grid)')


def _grid_of(setup: SetupReadings) -> tuple[tuple[float, ...], ...] | None:
    """The coordinates along each axis of the grid that a setup goes over as a whole; None where it does not."""
    found = tuple(tuple(np.unique(np.round(column, 9)).tolist()) for column in setup.sight.positions.T)
    visited = len(np.unique(np.round(setup.sight.positions, 9), axis=0))
    several = [len(part) for part in found if len(part) > 1]
    return found if len(several) > 1 and visited == np.prod(several) == len(setup.sight.positions) else None


def _one_grid(cell: CellReadings) -> list[SetupReadings]:
    """The setups that followed the same grid from enough stations, of several grids the one in space; else none.

    A position that a single station saw is none that distances tell, so that unlike grids do not mix here."""
    by_grid: dict[tuple[tuple[float, ...], ...], list[SetupReadings]] = {}
    for setup in cell.setups.values():
        grid = _grid_of(setup) if setup.sight.station is not None else None
        if grid:
            by_grid.setdefault(grid, []).append(setup)
    for grid, group in sorted(by_grid.items(), key=lambda item: (len(item[0][2]) == 1, -len(item[1]))):
        wanted = 4 if len(grid[2]) > 1 else 3
        if len(group) >= wanted and min(len(grid[0]), len(grid[1])) > 1:
            return group
    return []


def multilaterated(cell: CellReadings) -> Solution:
    """Multilateration of a log, by the closed problem of stations and dead paths: in the plane XY or in space."""
    own = _one_grid(cell)
    points = [setup.sight.positions for setup in own]
    readings, stations = [setup.displacement_m[:, 0] for setup in own], np.array([s.sight.station for s in own])
    tools = np.array([setup.sight.tool for setup in own])
    sigma = _sigma_of(own)
    if np.ptp(np.concatenate(points)[:, 2]) > SAME_M:
        return _settled(multilateration.evaluate(points, readings, stations, tools, sigma, cell.machine.chain))
    # The plane of the method holds the retroreflector: its own coordinates begin at the tool.
    places = (stations - tools)[:, :2]
    return _settled(multilateration.evaluate_plane([place[:, :2] for place in points], readings, places, sigma))


def _sigma_of(own: Sequence[SetupReadings]) -> float:
    """Standard deviation [m] of the mean readings of these setups, taken together."""
    return max(FLOOR_M, float(np.sqrt(np.mean([np.mean(setup.displacement_sigma_m**2) for setup in own]))))


def _settled(solution: Solution) -> Solution:
    """``solution``, unless its iteration came to no end: then its numbers are none."""
    if solution.status != 'ok':
        raise StepdiagError(f'{solution.method}: the iteration came to no end; check where the stations stand')
    return solution


def rectangle_lacks(cell: CellReadings) -> str | None:
    """What the rectangular path with the regulated beam misses in a log, in words."""
    if _rectangle(cell) is None:
        return 'a way around a rectangle of the plane XY at the origin, followed from a station in its plane'
    missing = [name for name in ('EXX', 'EYY') if name not in edges(cell)]
    return None if not missing else \
        f'lines along the edges from the origin for {", ".join(missing)}, at the plan\'s positions'


def _rectangle(cell: CellReadings) -> SetupReadings | None:
    """The setup that was followed around the face XY at the origin at the plan's positions, from its plane."""
    for setup in cell.setups.values():
        sight, plan = setup.sight, [np.linspace(0.0, length, cell.steps + 1) for length in cell.machine.volume]
        if sight.station is None or len(sight.positions) != 4 * cell.steps + 1:
            continue
        on_plan = all(len(found) == cell.steps + 1 and np.allclose(found, plan[axis], atol=SAME_M)
                      for axis, found in enumerate(np.unique(np.round(sight.positions[:, k], 9)) for k in range(2)))
        level = np.ptp(sight.positions[:, 2]) < SAME_M and abs(sight.tool[2] - sight.station[2]) < LEVEL_M
        if on_plan and level and np.abs(sight.positions[0]).max() < SAME_M and np.hypot(*sight.tool[:2]) < SAME_M:
            return setup
    return None


def regulated(cell: CellReadings) -> Solution:
    """Two lines and a rectangular path of a log, by the problem of the regulated beam in the plane XY."""
    around, found = _rectangle(cell), edges(cell)
    x, y = (np.linspace(0.0, length, cell.steps + 1) for length in cell.machine.volume[:2])
    far = np.array([[-2.0 * x[-1], 0.0], [0.0, -2.0 * y[-1]]])
    test = regulated_beam.Test(x, y, 0.0, 0.0, np.concatenate([far, [around.sight.station[:2]]]),
                               around.sight.positions[:, :2])
    # The table of the paper is that of a rotary axis; a station has none.
    known = regulated_beam.Budget.of_readings(_sigma_of([around]))
    readings = [x + found['EXX'], y + found['EYY'], around.displacement_m[:, 0]]
    return _settled(regulated_beam.evaluate(test, readings, known))


def faces(cell: CellReadings) -> CellReadings:
    """The step diagonals of the faces at the origin alone, named by plane and sign as ``xy_p``, ``xz_n``."""
    found: dict[str, SetupReadings] = {}
    for name in of_kind(cell, 'face step diagonal'):
        setup, volume = cell.setups[name], np.array(cell.machine.volume)
        start, end = setup.sight.positions[0], setup.sight.positions[-1]
        axes = np.flatnonzero(np.abs(end - start) > SAME_M)
        corner = np.zeros(3)
        corner[axes[0]] = 0.0 if end[axes[0]] > start[axes[0]] else volume[axes[0]]
        far = corner.copy()
        far[axes] = volume[axes] - corner[axes]
        far[axes[1]] = volume[axes[1]]
        label = ''.join('xyz'[axis] for axis in axes) + ('_p' if corner[axes[0]] == 0.0 else '_n')
        whole = np.allclose(start, corner, atol=SAME_M) and np.allclose(end, far, atol=SAME_M)
        if whole and len(setup.sight.positions) == 2 * cell.steps + 1 and label not in found:
            found[label] = replace(setup, sight=setup.sight.called(label))
    return replace(cell, setups=found)


def short_names(cell: CellReadings, straight: bool = False) -> dict[str, str]:
    """Names of the setups whose ways are those of a short name, by that: ``ppp`` → ``ppp`` or ``corner_to_corner``.

    ``straight``: diagonals in one motion, which have the stops of none, count where no stepped one is there.
    """
    volume, found = np.array(cell.machine.volume), {name: name for name in cell.setups if name in (*DIAGONALS, *LINEAR)}
    kinds = ('body step diagonal', *(('body diagonal',) if straight else ()))
    for kind in kinds:
        for name in of_kind(cell, kind):
            sight = cell.setups[name].sight
            corner = volume * [sign < 0.0 for sign in travel_signs(sight)]
            whole = np.allclose(sight.positions[0], corner, atol=SAME_M) and np.allclose(
                sight.positions[-1], volume - corner, atol=SAME_M)
            stepped = kind == 'body diagonal' or (len(sight.positions) == 3 * cell.steps + 1 and np.allclose(
                np.unique(np.round(sight.positions / volume * cell.steps, 6)), np.arange(cell.steps + 1), atol=1e-5))
            if whole and stepped and corner[2] == 0.0:
                found.setdefault(''.join('n' if at else 'p' for at in corner), name)
    for name in of_kind(cell, 'line'):
        sight = cell.setups[name].sight
        if np.abs(sight.positions[0]).max() < SAME_M and travel_signs(sight).sum() > 0.0:
            found.setdefault(f'lin_{"xyz"[int(np.argmax(travel_signs(sight)))]}', name)
    return found


def by_short_names(cell: CellReadings, straight: bool = False) -> CellReadings:
    """The setups of :func:`short_names` under these, for methods that look for no others."""
    found = short_names(cell, straight)
    return replace(cell, setups={short: replace(cell.setups[name], sight=cell.setups[name].sight.called(short))
                                 for short, name in found.items()})


def edges(cell: CellReadings) -> dict[str, np.ndarray]:
    """EXX, EYY, EZZ (steps + 1,) [m] at the plan's positions, of lines along the edges that meet in the origin."""
    found = {}
    for setup in with_mirror(cell):
        positions = setup.sight.positions
        axes = np.flatnonzero(np.ptp(positions, axis=0) > SAME_M)
        if len(axes) != 1 or np.abs(positions[0]).max() > SAME_M:
            continue
        plan = np.linspace(0.0, cell.machine.volume[axes[0]], cell.steps + 1)
        nearest = np.argmin(np.abs(positions[:, axes[0], None] - plan), axis=0)
        if np.allclose(positions[nearest, axes[0]], plan, atol=SAME_M):
            found[f'E{AXES[axes[0]] * 2}'] = setup.displacement_m[nearest, 0] - plan
    return found


def three_faces_lack(cell: CellReadings) -> str | None:
    """What the three-face step diagonal misses in a log, in words."""
    missing = [plane for plane in three_face.FACES if f'{plane}_p' not in faces(cell).setups]
    if missing:
        return (f'step diagonals of the faces {", ".join(missing)} from the origin (from, to, moves), in the plan\'s '
                'steps')
    missing = [name for name in ('EXX', 'EYY', 'EZZ') if name not in edges(cell)]
    return None if not missing else \
        f'lines along the edges from the origin for {", ".join(missing)}, at the plan\'s positions'


def three_faces(cell: CellReadings) -> Solution:
    """The three-face step diagonal of a log, with tilts where every face has spots."""
    found = faces(cell)
    found = replace(found, setups={name: found.setups[name] for name in (f'{p}_p' for p in three_face.FACES)})
    return three_face.evaluate(found, edges(cell), all(s.spot_m is not None for s in found.setups.values()))


def parallel(cell: CellReadings) -> Mapping[str, Lines]:
    """Lines of each axis that at least three setups measured at the same positions, by letter."""
    found = {}
    for axis, letter in enumerate(AXES):
        group = [s for s in with_mirror(cell)
                 if np.array_equal(np.flatnonzero(np.ptp(s.sight.positions, axis=0) > SAME_M), [axis])
                 and travel_signs(s.sight)[axis] > 0.0]
        group = [s for s in group if len(s.sight.positions) == len(group[0].sight.positions)
                 and np.allclose(s.sight.positions[:, axis], group[0].sight.positions[:, axis], atol=SAME_M)]
        if len(group) < 3:
            continue
        position = group[0].sight.positions[:, axis]
        arms = np.array([_arm(cell, s, axis) for s in group])
        try:
            linear_lines.evaluate({letter: Lines(position, arms, np.zeros((len(group), len(position))))})
        except StepdiagError:
            continue    # offsets in one line
        found[letter] = Lines(position, arms,
                              np.array([s.displacement_m[:, 0] - (position - position[0]) for s in group]),
                              float(np.sqrt(np.mean([np.mean(s.displacement_sigma_m**2) for s in group]))))
    return found


def _arm(cell: CellReadings, setup: SetupReadings, axis: int) -> np.ndarray:
    """From the axis's carriage to the tool point on a line (3,) [m]: what a turn of the axis moves it by."""
    machine, place, arm = cell.machine, setup.sight.positions[:1], np.zeros(3)
    nothing, _ = tool_pose(GeometricErrors({}, {}), place, machine.tool, machine.chain)
    for turn in range(3):
        errors = GeometricErrors({f'E{"ABC"[turn]}{AXES[axis]}': Curve(np.zeros(1), np.full(1, TURN_RAD))}, {})
        moved = (tool_pose(errors, place, machine.tool, machine.chain)[0] - nothing)[0] / TURN_RAD
        # e_k × l gives l along the next two axes.
        arm[(turn + 2) % 3] = moved[(turn + 1) % 3] * -1.0
        arm[(turn + 1) % 3] = moved[(turn + 2) % 3]
    return arm
