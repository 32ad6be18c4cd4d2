"""The pages in a real browser: they show something, complain about nothing, ask nobody.

Needs a headless Chromium (`apt-get install chromium`); skipped, saying so, without.
"""

import http.server
import shutil
import subprocess
import threading
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest

from stepdiag_ros.cli import main as cli

ROOT = Path(__file__).resolve().parents[2]
BROWSERS = ('chromium', 'chromium-browser', 'google-chrome')
CHROMIUM = next((path for name in BROWSERS if (path := shutil.which(name))), None)

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(CHROMIUM is None, reason='no Chromium here (apt-get install chromium)'),
]


class Handler(http.server.SimpleHTTPRequestHandler):
    """Serves files and notes what was asked for."""

    def do_GET(self) -> None:
        self.server.asked.append(self.path)
        super().do_GET()

    def log_message(self, *_: object) -> None:
        return None


@pytest.fixture(scope='module')
def pages(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the page of an evaluation and that of a diagnosis of a simulated log."""
    folder = tmp_path_factory.mktemp('pages')
    bag = folder / 'log'
    assert cli.main(['simulate', str(ROOT / 'cells' / 'demo.yaml'), '--out', str(bag)]) == 0
    assert cli.main(['report', str(bag), '--out', str(folder / 'report')]) == 0
    assert cli.main(['gap', str(bag), '--out', str(folder / 'gap')]) == 0
    return folder


@pytest.fixture
def server(pages: Path) -> Iterator[http.server.ThreadingHTTPServer]:
    """Serves the pages on a free port of the loopback interface."""
    with http.server.ThreadingHTTPServer(('127.0.0.1', 0), partial(Handler, directory=str(pages))) as server:
        server.asked = []
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield server
        server.shutdown()
        thread.join()


def browse(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """One run of the browser, which may reach nothing but this machine."""
    command = [CHROMIUM, '--headless', '--no-sandbox', '--disable-gpu', '--disable-dev-shm-usage', '--no-first-run']
    command += ['--disable-background-networking', '--disable-component-update', '--disable-extensions']
    command += ['--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1', f'--user-data-dir={folder / "profile"}']
    command += ['--enable-logging=stderr', '--virtual-time-budget=5000', '--window-size=1280,4000', '--hide-scrollbars']
    return subprocess.run([*command, *arguments], capture_output=True, text=True, timeout=240)


@pytest.mark.timeout(600)
@pytest.mark.parametrize('page', ['report/index.html', 'gap/log/index.html'])
def test_page(server: http.server.ThreadingHTTPServer, tmp_path: Path, page: str) -> None:
    address = f'http://127.0.0.1:{server.server_address[1]}/{page}'
    picture = tmp_path / 'page.png'
    result = browse(tmp_path, f'--screenshot={picture}', address)
    assert result.returncode == 0, result.stderr
    complaints = [line for line in result.stderr.splitlines() if ':CONSOLE' in line and 'favicon' not in line]
    assert not complaints

    pixels = np.asarray(matplotlib.image.imread(picture))[..., :3]
    assert pixels.shape[:2] == (4000, 1280)
    painted = np.abs(pixels - pixels[0, 0]).max(axis=2) > 0.1
    assert painted.mean() > 0.01, 'the page is blank'
    assert painted[:, -8:].mean() < 0.5, 'something runs over the right edge'

    # All that is asked for lies in the page's own folder.
    own = f'/{page.rpartition("/")[0]}/'
    assert all(path.startswith(own) or path == '/favicon.ico' for path in server.asked), server.asked


@pytest.mark.timeout(600)
def test_page_of_a_diagnosis_says_its_verdict(server: http.server.ThreadingHTTPServer, tmp_path: Path) -> None:
    address = f'http://127.0.0.1:{server.server_address[1]}/gap/log/index.html'
    result = browse(tmp_path, '--dump-dom', address)
    assert result.returncode == 0, result.stderr
    assert '<h1' in result.stdout and 'noise' in result.stdout.lower()
