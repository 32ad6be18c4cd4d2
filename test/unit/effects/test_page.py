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
