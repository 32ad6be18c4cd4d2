"""The server of the page: a few files, a websocket that tells what is new, reports of finished bags.

Nothing that a browser sends does anything but choose what it is shown.  On loopback only requests that name this
computer are answered, so that no page from elsewhere reads along (DNS rebinding), and a websocket only to pages of
this server.
"""

import asyncio
from collections.abc import Sequence
from html import escape
from importlib.resources import files
from urllib.parse import urlsplit

from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.requests import Request
from starlette.responses import HTMLResponse, PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.guard.jsontext import to_json
from stepdiag_ros.guard.show import escaped
from stepdiag_ros.nodes.observer import Observer
from stepdiag_ros.report.page import page
from stepdiag_ros.web.reports import Reports
from stepdiag_ros.web.state import Story

PERIOD_S = 0.25
FILES = {'/': ('page.html', 'text/html'), '/page.js': ('page.js', 'text/javascript'),
         '/page.css': ('page.css', 'text/css')}
#: Only what comes from here; no inline script, whatever a name holds.
POLICY = ("default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src data:; "
          "base-uri 'none'; form-action 'none'")
#: A report has no script at all; its pictures and its style stand in it.
REPORT_POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; base-uri 'none'; form-action 'none'"
HEADERS = {'X-Content-Type-Options': 'nosniff', 'X-Frame-Options': 'DENY', 'Referrer-Policy': 'no-referrer',
           'Cache-Control': 'no-store'}


def application(observer: Observer, reports: Reports, hosts: Sequence[str]) -> Starlette:
    """The ASGI application; ``hosts``: names by which it may be asked, ``*``: any."""

    async def file(request: Request) -> Response:
        name, kind = FILES[request.url.path]
        return Response(files('stepdiag_ros.web').joinpath(name).read_text(encoding='utf-8'), media_type=kind,
                        headers=HEADERS | {'Content-Security-Policy': POLICY})

    async def report(request: Request) -> Response:
        headers = HEADERS | {'Content-Security-Policy': REPORT_POLICY}
        try:
            made = await reports.page(request.path_params['key'])
        except StepdiagError as error:
            return HTMLResponse(page('no report', f'<p>{escape(escaped(str(error)))}</p>'), 500, headers)
        if made is None:
            return PlainTextResponse('no such report; the page lists those that there are\n', 404, headers)
        return HTMLResponse(made, headers=headers)

    async def live(socket: WebSocket) -> None:
        origin = socket.headers.get('origin')
        if origin is not None and urlsplit(origin).netloc != socket.headers.get('host'):
            await socket.close(1008)
            return
        await socket.accept()
        story = Story(observer, socket.query_params.get('machine', ''))
        gone = asyncio.ensure_future(_until_gone(socket))
        try:
            while not gone.done():
                await socket.send_text(to_json(story.next(reports.listed()), indent=None))
                await asyncio.wait([gone], timeout=PERIOD_S)
        except (WebSocketDisconnect, RuntimeError):
            return    # the browser has gone while something was sent
        finally:
            gone.cancel()

    async def nothing(request: Request, _error: Exception) -> Response:
        return PlainTextResponse(f'there is nothing at {escaped(request.url.path)[:200]}; the page is at /\n', 404,
                                 HEADERS)

    return Starlette(
        routes=[*(Route(path, file, methods=['GET']) for path in FILES),
                Route('/report/{key}', report, methods=['GET']), WebSocketRoute('/live', live)],
        middleware=[Middleware(TrustedHostMiddleware, allowed_hosts=list(hosts), www_redirect=False)],
        exception_handlers={404: nothing})


async def _until_gone(socket: WebSocket) -> None:
    """Returns when the browser has closed; what it sends is not read."""
    while (await socket.receive())['type'] != 'websocket.disconnect':
        pass
