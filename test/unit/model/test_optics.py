"""Scenes: the order of surfaces, exact paths through several of them, rays that get lost."""

import mpmath as mp
import numpy as np
import pytest

from stepdiag_ros.model.optics import Body, Plane, Scene, Sphere
from stepdiag_ros.model.rays import components, stacked

FORWARD = (0.0, 0.0, 1.0)
ORIGIN = (0.0, 0.0, 0.0)


def plate(name, front, thickness, index, normal=(0.0, 0.0, 1.0)):
    unit = np.array(normal) / np.linalg.norm(normal)
    return Body.glass(name, index, Plane((0.0, 0.0, front), tuple(-unit)),
                      Plane(tuple(np.array([0.0, 0.0, front]) + thickness * unit), tuple(unit)))


def actions(scene, path):
    return [(scene.bodies[m.body].name, m.surface, m.action) for m in path]


def test_path_is_found_without_being_told_the_order():
    scene = Scene((Body.detector('detector', Plane(ORIGIN, FORWARD)),
                   Body.mirror('mirror', Plane((0.0, 0.0, 2.0), (0.0, 0.0, -1.0))),
                   plate('window', 0.5, 0.01, 1.5)))
    assert actions(scene, scene.find_path(ORIGIN, FORWARD)) == [
        ('window', 0, 'refract'), ('window', 1, 'refract'), ('mirror', 0, 'reflect'),
        ('window', 1, 'refract'), ('window', 0, 'refract'), ('detector', 0, 'stop')]


def test_a_window_adds_its_optical_thickness():
    scene = Scene((plate('window', 0.5, 0.01, 1.5), Body.detector('end', Plane((0.0, 0.0, 2.0), FORWARD))),
                  ambient=1.00027)
    trace = scene.trace(scene.find_path(ORIGIN, FORWARD), ORIGIN, FORWARD)
    assert trace.optical_path[-1] == pytest.approx(1.00027 * 1.99 + 1.5 * 0.01, abs=1e-15)


def test_a_tilted_plate_shifts_the_beam_by_the_textbook_amount():
    tilt, index, thickness = 0.3, 1.5, 0.02
    body = plate('plate', 0.5, thickness, index, (np.sin(tilt), 0.0, np.cos(tilt)))
    scene = Scene((body, Body.detector('end', Plane((0.0, 0.0, 1.0), FORWARD))))
    trace = scene.trace(scene.find_path(ORIGIN, FORWARD), ORIGIN, FORWARD)
    inner = np.arcsin(np.sin(tilt) / index)
    shift = thickness * np.sin(tilt - inner) / np.cos(inner)
    assert abs(trace.points[-1][0]) == pytest.approx(shift, abs=1e-15)
    np.testing.assert_allclose(stacked(trace.direction), FORWARD, atol=1e-15)


def test_a_hollow_corner_cube_returns_every_ray_antiparallel_with_equal_path():
    """Path out and back to the start's wavefront is twice the distance to the apex, for any ray."""
    rng = np.random.default_rng(1)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    diagonal = turn @ np.ones(3) / np.sqrt(3.0)
    ray = -diagonal + rng.normal(0, 0.05, 3)
    ray /= np.linalg.norm(ray)
    apex = np.array([0.1, -0.2, 0.3])
    start = apex - 2.5 * ray
    mirrors = [Body.mirror(f'm{k}', Plane(tuple(apex), tuple(turn[:, k]))) for k in range(3)]
    side = np.cross(ray, [1.0, 0.0, 0.0])
    scene = Scene((*mirrors, Body.detector('end', Plane(tuple(start), tuple(ray)))))
    origin = start + 0.004 * side
    path = scene.find_path(components(origin), components(ray))
    assert [m.action for m in path] == ['reflect', 'reflect', 'reflect', 'stop']
    trace = scene.trace(path, components(origin), components(ray))
    assert trace.optical_path[-1] == pytest.approx(5.0, abs=1e-14)
    np.testing.assert_allclose(stacked(trace.direction), -ray, atol=2e-15)


def test_rays_from_a_hollow_spheres_centre_come_home():
    rng = np.random.default_rng(2)
    ray = rng.normal(size=(200, 3)) * [0.1, 0.1, 0.0] + [0.0, 0.0, 1.0]
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    radius = 1.7
    cap = Sphere((0.0, 0.0, radius), (0.0, 0.0, -1.0), 1.0 / radius)
    scene = Scene((Body.mirror('cap', cap), Body.detector('end', Plane(ORIGIN, FORWARD))))
    trace = scene.trace(scene.find_path(ORIGIN, FORWARD)[:1], ORIGIN, components(ray))
    assert np.abs(trace.optical_path[-1] - radius).max() < 1e-15 * 4
    np.testing.assert_allclose(stacked(trace.direction), -ray, atol=1e-15)


def test_total_reflection_in_a_prism():
    """A 45° prism turns the beam by 90° at its long side and lengthens nothing else."""
    size, index = 0.02, 1.5
    slope = 1.0 / np.sqrt(2.0)
    prism = Body.glass('prism', index, Plane((0.0, 0.0, 0.5), (0.0, 0.0, -1.0)),
                       Plane((0.0, 0.0, 0.5 + size), (-slope, 0.0, slope)),
                       Plane((2 * size, 0.0, 0.5 + size), (1.0, 0.0, 0.0)))
    scene = Scene((prism, Body.detector('end', Plane((0.3, 0.0, 0.0), (-1.0, 0.0, 0.0)))))
    path = scene.find_path(ORIGIN, FORWARD)
    assert [m.action for m in path] == ['refract', 'reflect', 'refract', 'stop']
    trace = scene.trace(path, ORIGIN, FORWARD)
    assert trace.optical_path[-1] == pytest.approx(0.5 + index * 3 * size + 0.3 - 2 * size, abs=1e-15)


def exact_path(origin, ray, surfaces, indices, mirror):
    """Fifty-digit path through planes and spheres (centre, radius), reflecting at number ``mirror``."""
    def dot(a, b):
        return sum(x * y for x, y in zip(a, b, strict=True))
    position = [mp.mpf(float(c)) for c in origin]
    ray = [mp.mpf(float(c)) for c in ray]
    ray = [c / mp.sqrt(dot(ray, ray)) for c in ray]
    total = mp.mpf(0)
    for number, (vertex, normal, curvature) in enumerate(surfaces):
        vertex, normal = [mp.mpf(float(c)) for c in vertex], [mp.mpf(float(c)) for c in normal]
        normal = [c / mp.sqrt(dot(normal, normal)) for c in normal]
        if curvature == 0.0:
            t = dot([a - b for a, b in zip(vertex, position, strict=True)], normal) / dot(ray, normal)
            bent = normal
        else:
            radius = 1 / mp.mpf(curvature)
            centre = [a + radius * b for a, b in zip(vertex, normal, strict=True)]
            away = [a - b for a, b in zip(position, centre, strict=True)]
            half, rest = dot(away, ray), dot(away, away) - radius * radius
            root = mp.sqrt(half * half - rest)
            t = min((-half - root, -half + root), key=lambda t: dot(
                *[[p + t * r - v for p, r, v in zip(position, ray, vertex, strict=True)]] * 2))
            bent = [(a + t * b) / radius for a, b in zip(away, ray, strict=True)]
        position = [a + t * b for a, b in zip(position, ray, strict=True)]
        total += mp.mpf(indices[number]) * t
        cosine = dot(ray, bent)
        if number == mirror:
            ray = [a - 2 * cosine * b for a, b in zip(ray, bent, strict=True)]
        elif number + 1 < len(indices):
            ratio = mp.mpf(indices[number]) / mp.mpf(indices[number + 1])
            tangent = [ratio * (a - cosine * b) for a, b in zip(ray, bent, strict=True)]
            rest = mp.sign(cosine) * mp.sqrt(1 - dot(tangent, tangent))
            ray = [a + rest * b for a, b in zip(tangent, bent, strict=True)]
    return total, position


def test_a_whole_scene_is_right_to_a_picometre_over_metres():
    """Window, weak lens, curved mirror 2.5 m away, and back: path and spot against fifty digits."""
    rng = np.random.default_rng(3)
    n = 40
    air, glass = 1.00027, 1.5168
    tilt = np.array([0.02, -0.01, 1.0]) / np.linalg.norm([0.02, -0.01, 1.0])
    window = [((0.0, 0.0, 0.2), -tilt, 0.0), (np.array([0.0, 0.0, 0.2]) + 0.006 * tilt, tilt, 0.0)]
    lens = [((0.0, 0.0, 0.4), (0.0, 0.0, -1.0), -1 / 3.0), ((0.0, 0.0, 0.405), (0.0, 0.0, 1.0), -1 / 50.0)]
    normal = -np.column_stack([rng.normal(0, 1e-3, (n, 2)), np.ones(n)])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    vertex = rng.normal(0, 0.02, (n, 3)) + [0.0, 0.0, 2.5]
    origin, ray = (0.003, -0.002, 0.0), np.array([7e-4, 1e-3, 1.0]) / np.linalg.norm([7e-4, 1e-3, 1.0])

    def optical(surface):
        point, direction, curvature = surface
        if curvature == 0.0:
            return Plane(components(point), components(direction))
        return Sphere(components(point), components(direction), curvature)
    scene = Scene((Body.glass('window', glass, *map(optical, window)),
                   Body.glass('lens', glass, *map(optical, lens)),
                   Body.mirror('mirror', optical((vertex, normal, 1e-4))),
                   Body.detector('detector', Plane(ORIGIN, FORWARD))), air)
    path = scene.find_path(components(origin), components(ray))
    assert len(path) == 10
    trace = scene.trace(path, components(origin), components(ray))
    ends = stacked(trace.points[-1])
    with mp.workdps(50):
        for i in range(n):
            way = [*window, *lens, (vertex[i], normal[i], 1e-4), *lens[::-1], *window[::-1],
                   (ORIGIN, FORWARD, 0.0)]
            indices = [air, glass, air, glass, air, air, glass, air, glass, air]
            total, end = exact_path(origin, ray, way, indices, mirror=4)
            assert abs(float(total - mp.mpf(trace.optical_path[-1][i]))) < 1e-13
            assert max(abs(float(a - mp.mpf(b))) for a, b in zip(end, ends[i], strict=True)) < 1e-13


def test_a_pose_that_cannot_follow_the_path_is_nan_and_the_others_are_not():
    normal = (np.array([0.0, 0.8, 0.0]), np.zeros(3), np.array([-1.0, -0.6, -1.0]))
    point = (0.0, 0.0, np.array([1.0, 1.0, -1.0]))
    scene = Scene((Body.mirror('mirror', Plane(point, normal)), Body.detector('end', Plane(ORIGIN, FORWARD))))
    trace = scene.trace(scene.find_path(ORIGIN, FORWARD), ORIGIN, FORWARD)
    np.testing.assert_array_equal(np.isnan(trace.optical_path[-1]), [False, True, True])
    assert trace.optical_path[-1][0] == 2.0


def test_an_aperture_stops_what_misses_it():
    mirror = Plane((np.array([0.0, 0.02]), 0.0, 1.0), (0.0, 0.0, -1.0), aperture=0.01)
    scene = Scene((Body.mirror('mirror', mirror), Body.detector('end', Plane(ORIGIN, FORWARD))))
    assert scene.find_path(ORIGIN, FORWARD, pose=1) == ()
    trace = scene.trace(scene.find_path(ORIGIN, FORWARD, pose=0), ORIGIN, FORWARD)
    np.testing.assert_array_equal(np.isnan(trace.optical_path[-1]), [False, True])
    np.testing.assert_array_equal(np.isnan(trace.points[-1][2]), [False, True])


def test_a_trapped_ray_is_an_error_and_not_an_endless_loop():
    scene = Scene((Body.mirror('a', Plane((0.0, 0.0, 1.0), (0.0, 0.0, -1.0))),
                   Body.mirror('b', Plane((0.0, 0.0, -1.0), FORWARD))))
    with pytest.raises(ValueError, match='100 surfaces'):
        scene.find_path(ORIGIN, FORWARD)


def test_light_runs_the_same_way_backwards():
    scene = Scene((plate('plate', 0.5, 0.02, 1.5, (0.1, -0.2, 1.0)),
                   Body.detector('end', Plane((0.0, 0.0, 1.0), FORWARD))))
    trace = scene.trace(scene.find_path(ORIGIN, FORWARD), ORIGIN, FORWARD)
    back = Scene((scene.bodies[0], Body.detector('start', Plane(ORIGIN, FORWARD))))
    reverse = tuple(-c for c in trace.direction)
    home = back.trace(back.find_path(trace.points[-1], reverse), trace.points[-1], reverse)
    np.testing.assert_allclose(stacked(home.points[-1]), ORIGIN, atol=1e-15)
    assert home.optical_path[-1] == pytest.approx(trace.optical_path[-1], abs=2e-16 * 4)
