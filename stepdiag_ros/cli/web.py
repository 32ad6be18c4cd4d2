"""Serve a page that shows what runs: the hall with its laser's queue, each calibration live, finished reports.

Only reads: nothing on the page moves or changes anything.  Served on this computer alone unless --host says otherwise;
there is no password.  Ctrl-C ends it.

  stepdiag web
  stepdiag web /demo --port 8350
"""

import argparse
import signal
import socket
import sys
import threading
import time

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.guard.show import escaped

NAME = 'web'
HELP = 'serve a page that shows what runs, live'
PORT = 8350
LOOK_S = 6.0
CLIENTS = 64
LOOPBACK = ('127.0.0.1', 'localhost')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('machines', metavar='MACHINE', nargs='*',
                        help='namespaces to show (default: all that run, also those that come later)')
    parser.add_argument('--host', default=LOOPBACK[0],
                        help='address to serve at; any but loopback lets others read along (default: %(default)s)')
    parser.add_argument('--port', type=_port, default=PORT, help='TCP port, 0: a free one (default: %(default)s)')


def _port(text: str) -> int:
    value = int(text)
    if not 0 <= value <= 65535:
        raise argparse.ArgumentTypeError(f'{value} is not between 0 and 65535')
    return value


def run(args: argparse.Namespace) -> int:
    import uvicorn
    import wsproto  # noqa: F401 - uvicorn would miss it later, in its own words

    from stepdiag_ros.nodes.observer import Observer
    from stepdiag_ros.web.app import application
    from stepdiag_ros.web.reports import Reports
    asked = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda _number, _frame: asked.set())
    with _bound(args.host, args.port) as listening, Observer(args.machines) as observer, Reports(observer) as reports:
        _look_for(observer, args.machines, asked)
        open_to_all = not _is_loopback(listening)
        server = uvicorn.Server(uvicorn.Config(
            application(observer, reports, ['*'] if open_to_all else LOOPBACK), ws='wsproto', lifespan='off',
            log_level='critical', access_log=False, limit_concurrency=CLIENTS, timeout_graceful_shutdown=2,
            server_header=False, proxy_headers=False))
        thread = threading.Thread(target=server.run, kwargs={'sockets': [listening]}, name='server', daemon=True)
        thread.start()
        host, port = listening.getsockname()[:2]
        if open_to_all:
            _say(f'WARNING: the page is OPEN at {host}, as --host says: whoever reaches this computer sees all that '
                 'is measured. There is no password and nothing is encrypted')
        _say(f'http://{host if ":" not in host else f"[{host}]"}:{port}/   (only shows; Ctrl-C ends)')
        while not asked.wait(0.2):
            if not thread.is_alive():
                raise StepdiagError(f'the server at {host}:{port} has ended')
        server.should_exit = True
        thread.join(10.0)
    return 0


def _say(text: str) -> None:
    print(escaped(f'stepdiag: {text}'), flush=True)
    sys.stdout.flush()


def _bound(host: str, port: int) -> socket.socket:
    """A socket at the address; :class:`StepdiagError` where it cannot be had."""
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        listening = socket.socket(family, kind, protocol)
    except OSError as error:
        raise StepdiagError(f'--host {host}: is no address of this computer: {error.strerror}') from None
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind(address)
        listening.listen()
    except OSError as error:
        listening.close()
        raise StepdiagError(f'{host}:{port} cannot be served: {error.strerror}; choose another --host or '
                            '--port') from None
    return listening


def _is_loopback(listening: socket.socket) -> bool:
    host = listening.getsockname()[0]
    return host == '::1' or host.startswith('127.')


def _look_for(observer, names: list[str], asked: threading.Event) -> None:
    """Wait until every named machine has said something; :class:`StepdiagError` names one that does not run."""
    end = time.monotonic() + LOOK_S
    wanted = {'/' + name.strip('/') for name in names}
    while not asked.is_set():
        absent = sorted(wanted - {machine.name for machine in observer.overview().machines})
        if not absent:
            return
        if time.monotonic() > end:
            with_all = ', '.join(observer.machines_that_run()) or 'none'
            raise StepdiagError(f'no machine {absent[0]} runs; those that run: {with_all}')
        time.sleep(0.1)
