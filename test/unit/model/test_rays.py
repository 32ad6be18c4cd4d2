"""The kernels against exact solutions: 1 pm over metres, in fifty digits."""

import mpmath as mp
import numpy as np
import pytest

from stepdiag_ros.model.rays import along, components, dot, hit_height, hit_plane, hit_sphere, reflect, refract, stacked

PICOMETRE = 1e-12


@pytest.fixture(autouse=True)
def _fifty_digits():
    with mp.workdps(50):
        yield


def exact(vector):
    return [mp.mpf(float(c)) for c in vector]


def exact_unit(vector):
    vector = exact(vector)
    length = mp.sqrt(sum(c * c for c in vector))
    return [c / length for c in vector]


def exact_dot(a, b):
    return sum(x * y for x, y in zip(a, b, strict=True))


def directions(rng, n, spread):
    """Unit vectors within about ``spread`` rad of z."""
    vector = np.column_stack([rng.normal(0, spread, (n, 2)), np.ones(n)])
    return vector / np.linalg.norm(vector, axis=1, keepdims=True)


@pytest.mark.parametrize('reach', [0.3, 3.0, 30.0])
def test_plane_distance_is_exact(reach):
    rng = np.random.default_rng(1)
    n = 60
    origin, ray = rng.normal(0, 0.3, (n, 3)), directions(rng, n, 0.3)
    point, normal = rng.normal(0, 0.3, (n, 3)) + [0, 0, reach], -directions(rng, n, 0.3) * 1.7
    t, _ = hit_plane(*(components(a) for a in (origin, ray, point, normal)))
    for i in range(n):
        o, d, p, m = exact(origin[i]), exact_unit(ray[i]), exact(point[i]), exact(normal[i])
        want = exact_dot([a - b for a, b in zip(p, o, strict=True)], m) / exact_dot(d, m)
        assert abs(float(want - mp.mpf(t[i]))) < PICOMETRE * max(1.0, reach / 10.0)


@pytest.mark.parametrize('radius', [0.5, -0.5, 20.0, -3e3, 1e7])
def test_sphere_distance_and_normal_are_exact(radius):
    rng = np.random.default_rng(2)
    n = 60
    origin = rng.normal(0, 0.03, (n, 3))
    ray, normal = directions(rng, n, 0.02), -directions(rng, n, 0.02)
    vertex = rng.normal(0, 0.03, (n, 3)) + [0.0, 0.0, 2.0]
    t, bent = hit_sphere(components(origin), components(ray), components(vertex), components(normal),
                         1.0 / radius)
    strike = stacked(along(components(origin), t, components(ray)))
    for i in range(n):
        o, d, v, m = exact(origin[i]), exact_unit(ray[i]), exact(vertex[i]), exact_unit(normal[i])
        r = 1 / mp.mpf(1.0 / radius)
        from_centre = [a - b - r * c for a, b, c in zip(o, v, m, strict=True)]
        half, rest = exact_dot(d, from_centre), exact_dot(from_centre, from_centre) - r * r
        roots = [-half + s * mp.sqrt(half * half - rest) for s in (-1, 1)]
        # The cap is the part of the sphere around the vertex: the root on the vertex's side.
        want = min(roots, key=lambda root: exact_dot(*[[a + root * b - c for a, b, c in
                                                         zip(o, d, v, strict=True)]] * 2))
        assert abs(float(want - mp.mpf(t[i]))) < PICOMETRE
        centre = vertex[i] + radius * normal[i]
        radial = (centre - strike[i]) / radius
        np.testing.assert_allclose(stacked(bent)[i], radial, atol=2e-9 if abs(radius) > 1e6 else 1e-12)


def test_a_sphere_without_curvature_is_a_plane():
    rng = np.random.default_rng(3)
    origin, ray = components(rng.normal(size=(9, 3))), components(directions(rng, 9, 0.3))
    vertex, normal = components(rng.normal(size=(9, 3)) + [0, 0, 4]), components(directions(rng, 9, 0.3))
    np.testing.assert_allclose(hit_sphere(origin, ray, vertex, normal, 0.0)[0],
                               hit_plane(origin, ray, vertex, normal)[0], rtol=1e-15)


def test_a_ray_that_misses_the_sphere_is_nan():
    t, _ = hit_sphere((0.0, 2.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, 3.0), (0.0, 0.0, 1.0), 1.0)
    assert np.isnan(t)


AXES = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def test_a_paraboloid_gathers_parallel_rays_with_equal_paths():
    """Path from a plane to the paraboloid and on to its focus is the same for every ray: exact in optics."""
    rng = np.random.default_rng(4)
    focal = 1.3
    height, gradient = (lambda x, y: -(x * x + y * y) / (4 * focal)), \
        (lambda x, y: (-x / (2 * focal), -y / (2 * focal)))
    x, y = rng.uniform(-0.4, 0.4, (2, 200))
    ray = (0.0, 0.0, 1.0)
    t, normal = hit_height((x, y, -2.0), ray, (0.0, 0.0, 0.5), AXES, height, gradient)
    strike, back = along((x, y, -2.0), t, ray), reflect(ray, normal)
    focus = (0.0, 0.0, 0.5 - focal)
    home = (focus[2] - strike[2]) / back[2]
    arrival = stacked(along(strike, home, back))
    assert np.abs(arrival - focus).max() < PICOMETRE
    assert np.abs(t + home - (2.5 + focal)).max() < PICOMETRE


def test_a_height_with_no_root_is_nan():
    # A ray along the surface's plane never comes nearer: Newton's step is infinite.
    t, _ = hit_height((np.zeros(2), np.zeros(2), np.ones(2)), (0.0, 1.0, 0.0), (0.0, 0.0, 0.0), AXES,
                      lambda x, y: 0.0 * y, lambda x, y: (0.0 * x, 0.0 * y))
    assert np.isnan(t).all()


def test_reflection_mirrors_and_keeps_the_length():
    rng = np.random.default_rng(5)
    ray, normal = directions(rng, 50, 0.7), directions(rng, 50, 0.7) * 3.0
    back = stacked(reflect(components(ray), components(normal)))
    unit = normal / 3.0
    along_normal = np.sum(ray * unit, 1, keepdims=True) * unit
    np.testing.assert_allclose(back, ray - 2 * along_normal, atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(back, axis=1), 1.0, atol=1e-15)


@pytest.mark.parametrize('sign', [1.0, -1.0])
@pytest.mark.parametrize(('before', 'after'), [(1.0, 1.5), (1.5, 1.0), (1.00027, 1.0), (1.4, 1.4)])
def test_refraction_obeys_snell_exactly(sign, before, after):
    rng = np.random.default_rng(6)
    ray, normal = directions(rng, 40, 0.1), sign * directions(rng, 40, 0.1)
    got = stacked(refract(components(ray), components(normal * 2.0), before, after))
    for i in range(40):
        d, m = exact_unit(ray[i]), exact_unit(normal[i])
        cosine = exact_dot(d, m)
        tangent = [mp.mpf(before) / mp.mpf(after) * (a - cosine * b) for a, b in zip(d, m, strict=True)]
        normal_part = mp.sign(cosine) * mp.sqrt(1 - exact_dot(tangent, tangent))
        want = [float(a + normal_part * b) for a, b in zip(tangent, m, strict=True)]
        np.testing.assert_allclose(got[i], want, atol=5e-16)


def test_total_reflection_is_nan_not_a_number():
    ray = (np.array([np.sin(0.6), np.sin(0.8)]), 0.0, np.array([np.cos(0.6), np.cos(0.8)]))
    got = refract(ray, (0.0, 0.0, -1.0), 1.5, 1.0)
    assert np.isfinite(got[2][0])
    assert np.isnan(got[2][1])


def test_components_and_stacked_are_inverse():
    vectors = np.random.default_rng(7).normal(size=(5, 3))
    np.testing.assert_array_equal(stacked(components(vectors)), vectors)
    assert all(isinstance(c, float) for c in components(vectors[0]))
    np.testing.assert_allclose(dot(components(vectors), components(vectors)), np.sum(vectors**2, 1))
