"""Work side by side: what fails keeps nothing else from its end, and is named."""

import pytest

from stepdiag_ros.blind.pool import side_by_side


def test_one_that_fails_is_named_at_the_end(capsys: pytest.CaptureFixture[str]) -> None:
    ended = []
    with pytest.raises(ZeroDivisionError) as raised:
        for name, result in side_by_side(divmod, {'one': (7, 2), 'two': (7, 0), 'three': (9, 2)}, 1, 'divided'):
            ended.append((name, result))
    assert sorted(ended) == [('one', (3, 1)), ('three', (4, 1))]
    assert raised.value.__notes__ == ['while working on two']
    assert 'divided 2 of 3, 1 failed' in capsys.readouterr().err
