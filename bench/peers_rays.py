"""The same two beams and one mirror through batoid, optiland and rayoptics, each as fast as it goes.

Runs in the peers' own environment (requirements/bench.txt) and imports nothing of ours.  Argument: an .npz
with ``point``, ``normal`` (n, 3) of the mirror, ``beam`` (3,), ``psd_start`` (3,), all in the base unit's
frame; the detector is the plane z = 0.  Results go to the second argument: for each peer seconds,
distance (k,) and spot (k, 2) over its first k poses.

No optical system is built and no aperture, coating or wavelength is asked for: each peer's lowest public
layer traces two rays against a plane whose pose changes from pose to pose.
"""

import sys
import time
from importlib.metadata import version

import numpy as np

BEST_OF = 3


def mirror_frames(normal):
    """Rotations (n, 3, 3) whose third column is the normal."""
    x = np.cross([0.0, 1.0, 0.0], normal)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return np.stack([x, np.cross(normal, x), normal], axis=2)


def best(function, *arguments):
    times = []
    for _ in range(BEST_OF):
        start = time.perf_counter()
        result = function(*arguments)
        times.append(time.perf_counter() - start)
    return min(times), *result


def batoid_one_by_one(scene, k):
    import batoid

    frames, point = mirror_frames(scene['normal'][:k]), scene['point'][:k]
    bx, by, bz = scene['beam']
    sx, sy, _ = scene['psd_start']
    pair = batoid.RayVector([0.0, sx], [0.0, sy], [0.0, 0.0], [bx, bx], [by, by], [bz, bz])
    plane, home = batoid.Plane(), batoid.CoordSys()

    def run():
        distance, spot = np.empty(k), np.empty((k, 2))
        for i in range(k):
            rays = pair.copy()
            batoid.reflect(plane, rays, batoid.CoordSys(point[i], frames[i]))
            distance[i] = rays.t[0]
            batoid.intersect(plane, rays, home)
            spot[i] = rays.x[1] - sx, rays.y[1] - sy
        return distance, spot
    return best(run)


def batoid_by_hand(scene, k):
    """Not the mirror moves but the rays: NumPy turns every pose's rays into the mirror's frame, one call traces all."""
    import batoid

    point, normal = scene['point'][:k], scene['normal'][:k]

    def run():
        frames = mirror_frames(normal)
        beam = np.einsum('nji,j->ni', frames, scene['beam'])
        first = np.einsum('nji,nj->ni', frames, -point)
        second = np.einsum('nji,nj->ni', frames, scene['psd_start'] - point)
        start, ray = np.concatenate([first, second]), np.concatenate([beam, beam])
        rays = batoid.RayVector(*start.T.copy(), *ray.T.copy())
        plane = batoid.Plane()
        batoid.reflect(plane, rays)
        distance = rays.t[:k].copy()
        strike = np.einsum('nij,nj->ni', frames, rays.r[k:]) + point
        back = np.einsum('nij,nj->ni', frames, rays.v[k:])
        rays = batoid.RayVector(*strike.T.copy(), *back.T.copy())
        batoid.intersect(plane, rays)
        return distance, rays.r[:, :2] - scene['psd_start'][:2]
    return best(run)


def optiland_one_by_one(scene, k):
    from optiland.coordinate_system import CoordinateSystem
    from optiland.geometries import Plane
    from optiland.interactions.refractive_reflective_model import RefractiveReflectiveModel
    from optiland.materials import IdealMaterial
    from optiland.rays import RealRays
    from optiland.surfaces.standard_surface import Surface

    def surface(before, reflective):
        made = Surface(previous_surface=before, material_post=IdealMaterial(1.0), geometry=Plane(CoordinateSystem()),
                       interaction_model=RefractiveReflectiveModel(parent_surface=None, is_reflective=reflective))
        made.interaction_model.parent_surface = made
        return made
    space = surface(None, False)
    mirror = surface(space, True)
    detector = surface(mirror, False)
    place = mirror.geometry.cs
    point, normal = scene['point'][:k], scene['normal'][:k]
    bx, by, bz = scene['beam']
    sx, sy, _ = scene['psd_start']
    # The frame's z after a turn about x and then about y, as its globalize() does it.
    turn_x, turn_y = np.arcsin(normal[:, 1]), np.arctan2(normal[:, 0], normal[:, 2])

    def run():
        distance, spot = np.empty(k), np.empty((k, 2))
        for i in range(k):
            rays = RealRays([0.0, sx], [0.0, sy], [0.0, 0.0], [bx, bx], [by, by], [bz, bz], [1.0, 1.0], [1.0, 1.0])
            place.x, place.y, place.z = point[i]
            place.rx, place.ry = -turn_x[i], turn_y[i]
            mirror.trace(rays, record=False)
            distance[i] = rays.opd[0]
            detector.trace(rays, record=False)
            spot[i] = rays.x[1] - sx, rays.y[1] - sy
        return distance, spot
    return best(run)


def rayoptics_one_by_one(scene, k):
    from rayoptics.elem.profiles import Spherical
    from rayoptics.elem.surface import Surface
    from rayoptics.raytr.raytrace import trace_raw

    def plane(mode):
        return Surface(profile=Spherical(c=0.0), interact_mode=mode)
    start, mirror, detector = plane('dummy'), plane('reflect'), plane('dummy')
    frames, point = mirror_frames(-scene['normal'][:k]), scene['point'][:k]
    beam, psd, zero = scene['beam'], scene['psd_start'], np.zeros(3)

    def run():
        distance, spot = np.empty(k), np.empty((k, 2))
        for i in range(k):
            # Interface, gap, transform to the next, index, direction along z.
            way = ((start, None, (frames[i].T, point[i]), 1.0, 1.0),
                   (mirror, None, (frames[i], -frames[i].T @ point[i]), 1.0, -1.0),
                   (detector, None, None, 1.0, -1.0))
            ray, *_ = trace_raw(iter(way[:2]), zero, beam, 550.0, intersect_obj=False)
            distance[i] = ray[0][2]
            ray, *_ = trace_raw(iter(way), psd, beam, 550.0, intersect_obj=False)
            spot[i] = ray[-1][0][:2] - psd[:2]
        return distance, spot
    return best(run)


PEERS = {'batoid': (batoid_one_by_one, 'batoid', 4000), 'optiland': (optiland_one_by_one, 'optiland', 400),
         'rayoptics': (rayoptics_one_by_one, 'rayoptics', 1500),
         'batoid, rays moved by hand': (batoid_by_hand, 'batoid', None)}


def main() -> None:
    scene = dict(np.load(sys.argv[1]))
    out = {}
    for name, (trace, package, count) in PEERS.items():
        k = min(count or len(scene['point']), len(scene['point']))
        seconds, distance, spot = trace(scene, k)
        out |= {f'{name}/seconds': seconds, f'{name}/distance': distance, f'{name}/spot': spot,
                f'{name}/version': version(package)}
    np.savez(sys.argv[2], **{key.replace('/', '|'): value for key, value in out.items()})


if __name__ == '__main__':
    main()
