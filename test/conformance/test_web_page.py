"""The page of `stepdiag web` in a real browser, on a live run: it fits a desk and a telephone, and builds as it is
measured.

Needs a headless Chromium (`apt-get install chromium`); skipped, saying so, without.
"""

import re
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from browser import CHROMIUM, SIZES, Browser, fits

from stepdiag_ros.nodes import environment

environment.prepare()

#: With a fifth of the samples, for the browser wants the processor too, and each setup once there and back.
DEMO = re.sub(r'(interferometer|psd): 1000\.0', r'\1: 200.0',
              (Path(__file__).resolve().parents[2] / 'cells' / 'demo.yaml').read_text(encoding='utf-8')
              .replace('repeats: 2 ', 'repeats: 1 '))
EVIL = '<img src=x onerror=alert(1)><b>'
OPEN_CURVES = "[...document.querySelectorAll('.curve figcaption')].filter(c => c.textContent.endsWith('open')).length"

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(CHROMIUM is None, reason='no Chromium here (apt-get install chromium)'),
]


@pytest.fixture(scope='module')
def live(module_domain, tmp_path_factory):
    """The demo's cell, its page's address, and the calibration that runs in a thread."""
    from stepdiag_ros.nodes.bringup import Bringup
    folder = tmp_path_factory.mktemp('web')
    (folder / 'demo.yaml').write_text(DEMO, encoding='utf-8')
    with Bringup(folder / 'demo.yaml', bag_folder=folder, runtime=folder / 'run') as cell:
        web = subprocess.Popen([sys.executable, '-m', 'stepdiag_ros.cli.main', 'web', '/demo', '--port', '0'],
                               stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        address = re.match(r'stepdiag: (http://\S+)', web.stdout.readline())[1]
        cell.operator.set_parameters('gap_monitor', {'period': 1.0})
        cell.operator.new_log(str(folder / 'today'))
        outcome: list = []
        run = threading.Thread(target=lambda: outcome.append(cell.operator.calibrate()))
        run.start()
        yield cell, address, run, outcome
        run.join()
        web.send_signal(signal.SIGINT)
        said = web.communicate(timeout=60)[0]
        assert web.returncode == 0 and 'Traceback' not in said, said


@pytest.mark.timeout(900)
def test_a_run_is_seen_as_it_is_measured(live, tmp_path):
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
    cell, address, run, outcome = live
    stranger = cell.operator.node.create_publisher(DiagnosticArray, '/diagnostics', 10)
    with Browser(tmp_path) as browser:
        browser.size(*SIZES['desk'])
        browser.open(address)
        browser.until("document.querySelectorAll('.mirror').length === 1")
        assert browser.value("document.querySelectorAll('.ray').length") == 1
        browser.until("document.querySelector('.card.chosen').textContent.includes('stops')")

        # The scene moves with the machine, streams grow, curves come out of the open one after another.
        where = browser.value("document.querySelector('.mirror').getAttribute('points')")
        browser.until(f"document.querySelector('.mirror').getAttribute('points') !== '{where}'")
        browser.until("[...document.querySelectorAll('.stream path')].filter(p => p.getAttribute('d').length > 200)"
                      ".length === 3")
        browser.until("document.querySelectorAll('.curve').length === 18")
        assert browser.value("document.getElementById('state').textContent") == 'so far'
        at_first = browser.value(OPEN_CURVES)
        fits(browser, 'desk', tmp_path / 'desk_live.png')
        fits(browser, 'telephone', tmp_path / 'telephone_live.png')
        browser.until(f'{OPEN_CURVES} < {at_first}')
        assert run.is_alive() and browser.value("document.getElementById('state').textContent") == 'so far'

        browser.until(f'{OPEN_CURVES} <= 9', 600.0)
        fits(browser, 'desk', tmp_path / 'desk_half.png')

        # A stranger's name is a text.
        for level in (b'\x00', b'\x02'):
            stranger.publish(DiagnosticArray(status=[DiagnosticStatus(name=f'demo/{EVIL}', message=EVIL, level=level)]))
        browser.until("document.getElementById('troubles').textContent.includes('<img src=x')")
        assert browser.value("document.querySelectorAll('main img, main li b').length") == 0
        fits(browser, 'telephone', tmp_path / 'telephone_name.png')

        run.join()
        assert outcome[0].succeeded, outcome[0].message
        browser.until("document.getElementById('state').textContent === 'complete: ok'", 300.0)
        assert browser.value(OPEN_CURVES) == 0
        # What is written is what the solver found, with its uncertainty.
        found = cell.operator.evaluate()['errors']
        low, high = min(found['EXX']['value']), max(found['EXX']['value'])
        text = browser.value("document.querySelector('.curve figcaption').lastChild.textContent")
        shown, U, _ = re.split(r' ± |\s', text)
        assert float(shown) == pytest.approx(1e6 * (high - low), abs=0.06)
        assert float(U) == pytest.approx(2e6 * max(found['EXX']['sigma']), abs=0.06)

        browser.until("document.querySelector('#gap h2') !== null", 300.0)
        assert browser.value("document.querySelectorAll('#reports a').length") == 0    # the bag is still open
        cell.operator.bring('recorder', 'inactive')
        browser.until("document.querySelector('#reports a')?.textContent === 'today'")
        fits(browser, 'desk', tmp_path / 'desk_done.png')
        fits(browser, 'telephone', tmp_path / 'telephone_done.png')
        browser.open(browser.value("document.querySelector('#reports a').href"))
        browser.until("document.querySelector('h1')?.textContent.includes('(95 %)') && "
                      "document.title.includes('today')", 300.0)
        assert browser.value("document.querySelectorAll('svg').length") >= 1
        assert browser.complaints == []


@pytest.mark.timeout(300)
def test_a_machine_that_does_not_run_is_said_on_the_page(live, tmp_path):
    _, address, _, _ = live
    with Browser(tmp_path) as browser:
        browser.open(f'{address}#%2Fnowhere')
        browser.until("document.getElementById('trouble').textContent === "
                      "'no machine /nowhere runs; choose one of /demo'")
        browser.value("document.querySelector('.card').click()")
        browser.until("document.getElementById('trouble').hidden && !document.getElementById('detail').hidden")
        assert browser.complaints == []
