"""The page on the effects is what the effects say of themselves."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]


def test_the_page_is_up_to_date():
    result = subprocess.run([sys.executable, str(ROOT / 'tools' / 'effects_table.py'), '--check'],
                            capture_output=True, text=True, timeout=120)
    assert result.returncode == 0, result.stderr


def test_the_example_of_the_guide_works(tmp_path):
    from stepdiag_ros.effects import effects_in_file

    text = (ROOT / 'docs' / 'how-to' / 'add_an_effect.md').read_text(encoding='utf-8')
    path = tmp_path / 'spindle_growth.py'
    path.write_text(text.split('```python\n')[1].split('```')[0], encoding='utf-8')
    (kind,) = effects_in_file(str(path))
    assert kind.name == 'spindle_growth'
    assert kind(amp=1e-5, tau=500.0).amp == 1e-5


def test_the_two_faces_of_the_example_say_the_same_size(bench, tmp_path):
    """Counted from the first dwell in place of the log's beginning, the size is wrong by exp(lead/τ)."""
    from dataclasses import replace

    import numpy as np

    from stepdiag_ros.effects import effects_in_file

    text = (ROOT / 'docs' / 'how-to' / 'add_an_effect.md').read_text(encoding='utf-8')
    path = tmp_path / 'spindle_growth.py'
    path.write_text(text.split('```python\n')[1].split('```')[0], encoding='utf-8')
    (kind,) = effects_in_file(str(path))
    tau, amp = bench.view.lead, 1e-5
    acting = bench.with_effect(kind(amp=amp, tau=tau))
    change = acting.view.reading - bench.view.reading
    form = next(f for f in kind().appearance(acting.view) if 'tau_s' in f.shape).at({'tau_s': tau})
    found, left = bench.fitted(form, change)
    assert tau > 10.0 and left < 0.02
    np.testing.assert_allclose(found, amp, rtol=0.02)
    # The check can fail: from the first dwell on the same form says another size.
    late = replace(acting.view, lead=0.0)
    other, _ = bench.fitted(next(f for f in kind().appearance(late) if 'tau_s' in f.shape).at({'tau_s': tau}), change)
    np.testing.assert_allclose(other, amp / np.e, rtol=0.05)
