"""Which readings of the environment belong to a log: those that everybody has who listened while it was made."""

import numpy as np
import pytest

from stepdiag_ros.model.log import ScalarSeries

BEGIN, END = 100.0, 160.0


def _read(*times_s: float) -> ScalarSeries:
    return ScalarSeries(np.int64(1e9 * np.array(times_s)), np.array(times_s), np.zeros(len(times_s)))


@pytest.mark.parametrize(('every_s', 'before_s'), [(1.0, (10.0, 0.3)), (4.0, (60.0, 3.0)), (10.0, (100.0, 12.0))])
def test_how_long_before_and_after_somebody_listened_leaves_no_trace(every_s, before_s):
    """As long as an idle listener has heard the reading before the first step where readings are rare."""
    times = np.arange(0.0, 300.0, every_s) + 0.9
    logs = [_read(*times[(times > BEGIN - before) & (times < END + after)]).during(int(1e9 * BEGIN), int(1e9 * END))
            for before in (*before_s, 50.0) for after in (0.0, 70.0)]
    at = np.int64(1e9 * np.linspace(BEGIN, END, 50))
    for one in logs[1:]:
        np.testing.assert_array_equal(one.at(at), logs[0].at(at))


def test_rare_readings_are_kept_on_both_sides_of_the_first_step():
    assert list(_read(40.0, 90.0, 140.0, 190.0).during(int(1e9 * BEGIN), int(1e9 * END)).value) == [90.0, 140.0]
    assert list(_read(40.0, 90.0).during(int(1e9 * BEGIN), int(1e9 * END)).value) == [90.0]
    assert list(_read(99.0, 101.0, 103.0).during(int(1e9 * BEGIN), int(1e9 * END)).value) == [101.0, 103.0]


def test_what_was_read_only_afterwards_is_better_than_nothing():
    assert list(_read(170.0, 180.0).during(int(1e9 * BEGIN), int(1e9 * END)).value) == [170.0, 180.0]


def test_a_later_reading_is_known_to_have_come():
    assert _read(110.0, 170.0).during(int(1e9 * BEGIN), int(1e9 * END)).later
    assert not _read(110.0, 150.0).during(int(1e9 * BEGIN), int(1e9 * END)).later
