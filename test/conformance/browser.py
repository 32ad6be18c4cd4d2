"""A headless Chromium that a test steers by the DevTools protocol: opens pages, evaluates, waits, takes pictures."""

import base64
import json
import os
import shutil
import subprocess
import time
from pathlib import Path
from typing import Any

from stepdiag_ros.nodes.patience import Patience

BROWSERS = ('chromium', 'chromium-browser', 'google-chrome')
CHROMIUM = next((path for name in BROWSERS if (path := shutil.which(name))), None)
OPTIONS = ('--headless', '--no-sandbox', '--disable-gpu', '--disable-dev-shm-usage', '--no-first-run',
           '--disable-background-networking', '--disable-component-update', '--disable-extensions', '--hide-scrollbars',
           '--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1', '--remote-debugging-pipe')
ANSWER_S = 120.0
SIZES = {'desk': (1400, 900), 'telephone': (390, 844)}
STEADY = 'document.documentElement.scrollWidth <= innerWidth'


class Browser:
    """One tab; a context manager.  ``complaints``: what the page wrote to its console and what failed in it."""

    def __init__(self, folder: Path):
        self._folder, self._number, self._session, self._rest = folder, 0, '', b''
        self.complaints: list[str] = []

    def __enter__(self) -> 'Browser':
        theirs, self._to = os.pipe()
        self._from, back = os.pipe()
        command = [CHROMIUM, *OPTIONS, f'--user-data-dir={self._folder / "profile"}']
        self._process = subprocess.Popen(['bash', '-c', f'exec "$0" "$@" 3<&{theirs} 4>&{back}', *command],
                                         pass_fds=(theirs, back), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        os.close(theirs)
        os.close(back)
        target = self._ask('Target.createTarget', url='about:blank')['targetId']
        self._session = self._ask('Target.attachToTarget', targetId=target, flatten=True)['sessionId']
        for domain in ('Page', 'Runtime', 'Log'):
            self._ask(f'{domain}.enable')
        return self

    def __exit__(self, *_exception) -> None:
        self._session = ''
        try:
            self._ask('Browser.close')
        except (OSError, EOFError):
            pass
        self._process.wait(60)
        os.close(self._to)
        os.close(self._from)

    def _ask(self, method: str, **parameters: Any) -> dict[str, Any]:
        self._number += 1
        said = {'id': self._number, 'method': method, 'params': parameters}
        if self._session:
            said['sessionId'] = self._session
        os.write(self._to, json.dumps(said).encode() + b'\0')
        while True:
            heard = self._next()
            if heard.get('id') == self._number:
                assert 'error' not in heard, heard
                return heard['result']
            self._note(heard)

    def _next(self) -> dict[str, Any]:
        while b'\0' not in self._rest:
            part = os.read(self._from, 1 << 20)
            if not part:
                raise EOFError('the browser has ended')
            self._rest += part
        one, _, self._rest = self._rest.partition(b'\0')
        return json.loads(one)

    def _note(self, event: dict[str, Any]) -> None:
        if event.get('method') in ('Runtime.exceptionThrown', 'Log.entryAdded') or (
                event.get('method') == 'Runtime.consoleAPICalled' and event['params']['type'] in ('error', 'warning')):
            self.complaints.append(json.dumps(event['params'])[:500])

    def size(self, width: int, height: int) -> None:
        """The window's size in CSS pixels; below 500 as a telephone has it."""
        self._ask('Emulation.setDeviceMetricsOverride', width=width, height=height, deviceScaleFactor=1,
                  mobile=width < 500)

    def open(self, address: str) -> None:
        """Go to a page and wait until it is there."""
        self._ask('Page.navigate', url='about:blank')    # else a page with another fragment would not be loaded anew
        self._ask('Page.navigate', url=address)
        self.until("location.href !== 'about:blank' && document.readyState === 'complete'")

    def value(self, expression: str) -> Any:
        """What a JavaScript expression is on the page."""
        answer = self._ask('Runtime.evaluate', expression=expression, returnByValue=True, awaitPromise=True)
        assert 'exceptionDetails' not in answer, answer
        return answer['result'].get('value')

    def until(self, expression: str, seconds: float = ANSWER_S) -> Any:
        """Wait until an expression is true on the page; its value."""
        patience = Patience(seconds)
        while not (value := self.value(expression)):
            assert not patience.over(), f'{expression} did not come true: {self.value("document.body.innerText")}'
            time.sleep(0.1)
        return value

    def picture(self, path: Path) -> None:
        """The whole page as a PNG, not the window alone."""
        answer = self._ask('Page.captureScreenshot', format='png', captureBeyondViewport=True)
        path.write_bytes(base64.b64decode(answer['data']))


def fits(browser: Browser, size: str, picture: Path) -> None:
    """Nothing runs over the right edge, at once and after a message more."""
    browser.size(*SIZES[size])
    browser.until(f'innerWidth === {SIZES[size][0]} && {STEADY}', 10.0)
    beyond = browser.value("[...document.querySelectorAll('main *')].filter(e => e.getBoundingClientRect().right > "
                           "innerWidth + 1).map(e => e.tagName + e.className).slice(0, 5)")
    assert beyond == []
    browser.picture(picture)
    if 'STEPDIAG_PICTURES' in os.environ:    # for looking at them
        shutil.copy(picture, os.environ['STEPDIAG_PICTURES'])
