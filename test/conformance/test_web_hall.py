"""The page of `stepdiag web` in a real browser on a live hall: two machines, one laser, its queue, at a desk and a
telephone.

Needs a headless Chromium (`apt-get install chromium`); skipped, saying so, without.
"""

import re
import signal
import subprocess
import sys

import pytest
from browser import CHROMIUM, SIZES, Browser, fits

from stepdiag_ros.nodes import environment

environment.prepare()

CELL = """
schema: 1
seed: 7
machine: {name: tiny, chain: FXYZ, volume: [0.10, 0.08, 0.06], tool: [0.0, 0.0, -0.10]}
plan: {steps: 2, order: XYZ, repeats: 3}
setups:
  ppp: {standoff: 0.20, psd_offset: [0.02, 0.0]}
  lin_x: {standoff: 0.20, psd_offset: [0.02, 0.0], length: 0.10, stops: 3}
motion: {feed: 0.5, acceleration: 8.0, jerk: 800.0, in_position: 5.0e-8, settling: 0.002, dwell: 0.5}
sampling: {interferometer: 200.0, psd: 200.0, block: 0.05}
client: {lease: 60.0}
"""
NAMES = ('left_mill', 'right_mill')
LIGHTS = "document.getElementById('lights').textContent"

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(CHROMIUM is None, reason='no Chromium here (apt-get install chromium)'),
]


@pytest.fixture
def hall(ros_domain, tmp_path):
    """Two machines that are up, and the page's address."""
    from stepdiag_ros.nodes.hall import MACHINE_NODES, Hall
    (tmp_path / 'tiny.yaml').write_text(CELL, encoding='utf-8')
    machines = ''.join(f'  - {{cell: tiny.yaml, name: {name}, seed: {n}}}\n' for n, name in enumerate(NAMES))
    file = tmp_path / 'hall.yaml'
    file.write_text(f'schema: 1\nlease: 20.0\nmachines:\n{machines}', encoding='utf-8')
    nodes = tuple(name for name in MACHINE_NODES if name != 'gap_monitor')
    with Hall(file, bag_folder=tmp_path / 'bags', runtime=tmp_path / 'run', nodes=nodes):
        web = subprocess.Popen([sys.executable, '-m', 'stepdiag_ros.cli.main', 'web', '--port', '0'],
                               stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        yield re.match(r'stepdiag: (http://\S+)', web.stdout.readline())[1]
        web.send_signal(signal.SIGINT)
        said = web.communicate(timeout=60)[0]
        assert web.returncode == 0 and 'Traceback' not in said, said


@pytest.mark.long
@pytest.mark.timeout(600)
def test_who_has_the_laser_and_who_waits_is_seen(hall, tmp_path):
    with Browser(tmp_path) as browser:
        browser.size(*SIZES['desk'])
        browser.open(hall)
        browser.until(f"document.querySelectorAll('.card').length === {len(NAMES)}")
        browser.until(f"{LIGHTS}.includes('nobody has the light') && {LIGHTS}.includes('nobody waits')")
        command = subprocess.Popen([sys.executable, '-m', 'stepdiag_ros.cli.main', 'calibrate', '--all', '--json'],
                                   stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path)
        try:
            # Whoever has it, the other waits with its place and the time to go.
            browser.until("document.getElementById('machines').textContent.includes('stops') && "
                          f"/_mill has the light/.test({LIGHTS}) && /1\\. \\w+_mill in about \\d+ s/.test({LIGHTS})",
                          180.0)
            fits(browser, 'desk', tmp_path / 'hall_desk.png')
            fits(browser, 'telephone', tmp_path / 'hall_telephone.png')
            for name in NAMES:
                browser.until(f"{LIGHTS}.includes('{name} has the light')", 180.0)
            # The other machine is a click away.
            browser.value("[...document.querySelectorAll('.card')].find(c => !c.classList.contains('chosen')).click()")
            browser.until("document.querySelectorAll('.card.chosen').length === 1 && "
                          "document.querySelectorAll('.mirror').length === 1")
            out, err = command.communicate(timeout=300)
        finally:
            command.kill()
        assert command.returncode == 0, (out, err)
        browser.until(f"{LIGHTS}.includes('nobody has the light')", 60.0)
        assert browser.complaints == []
