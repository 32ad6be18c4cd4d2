"""An array that is made when it is looked at is an array to NumPy."""

import numpy as np

from stepdiag_ros.effects.made import Made, Product, Split, joined


def outer(a, b):
    return a[:, None] * b


def test_it_is_taken_wherever_an_array_is():
    a, b = np.arange(3.0), np.arange(1.0, 5.0)
    made, written = Made((3, 4), outer, a, b), outer(a, b)
    assert made.shape == written.shape and len(made) == 3 and made.ndim == 2
    np.testing.assert_array_equal(made, written)
    np.testing.assert_array_equal(made * 2.0 + made, 3.0 * written)
    np.testing.assert_array_equal(made[:, [0, 2]], written[:, [0, 2]])
    np.testing.assert_array_equal(np.concatenate([made, written]), np.concatenate([written, written]))
    np.testing.assert_array_equal(np.tensordot(a, made, axes=1), a @ written)
    np.testing.assert_array_equal(made.reshape(3, -1), written)
    assert made.any() and made.sum() == written.sum() and made.T.shape == (4, 3)
    np.testing.assert_array_equal(joined([made, written]), np.concatenate([written, written]))


def test_what_is_made_alike_of_the_same_is_the_same():
    a, b = np.arange(3.0), np.arange(1.0, 5.0)
    made = Made((3, 4), outer, a, b)
    assert made.same(Made((3, 4), outer, a.copy(), b))
    assert not made.same(Made((3, 4), outer, a + 1.0, b))
    assert not made.same(Made((3, 4), np.outer, a, b)) and not made.same(outer(a, b))


def test_nothing_is_kept():
    made, calls = Made((1,), lambda: calls.append(1) or np.zeros(1)), []
    np.asarray(made), np.asarray(made)
    assert len(calls) == 2


def test_a_product_is_each_function_times_each_row():
    rng = np.random.default_rng(1)
    functions, signature, course = rng.random((2, 5)), rng.random((3, 5, 4)), rng.random((5, 6))
    at_stops, inside = Product(functions, signature), Product(functions, signature, course)
    assert at_stops.shape == np.asarray(at_stops).shape == (6, 5, 4)
    assert inside.shape == np.asarray(inside).shape == (6, 5, 6, 4)
    np.testing.assert_array_equal(at_stops[4], functions[1][:, None] * signature[1])
    np.testing.assert_array_equal(inside[4], (functions[1][:, None] * signature[1])[:, None] * course[:, :, None])


def test_split_columns_are_had_of_some_stops_as_of_all():
    rng = np.random.default_rng(2)
    columns, group = rng.standard_normal((2, 7, 3)), np.array([4, 4, 0, 0, 2, 2, 4])
    split = Split(columns, group, np.array([0, 4]), np.eye(2, 3, dtype=bool))
    whole = np.asarray(split)
    assert whole.shape == split.shape == (2 * 2 * 2, 7, 3)
    np.testing.assert_array_equal(whole[2], (columns[0] * [0.0, 1.0, 0.0]) * (group == 0)[:, None])
    for stops in ([1, 6], [2, 4], [4], [0, 3, 5]):
        there, part = split.at(np.array(stops))
        np.testing.assert_array_equal(part, whole[there][:, stops])
        assert not np.delete(whole, there, axis=0)[:, stops].any()
