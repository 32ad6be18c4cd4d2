"""Wires for the fuzzer: what passes between a driver and a virtual instrument, spoilt on its way, in either direction.

A driver's client may raise :class:`StepdiagError` and nothing else, within seconds; an instrument must serve the next
client as if nothing had been, and write nothing of Python's into its log.
"""

import random
import re
import select
import socket
import struct
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import yaml

import bags
from stepdiag_ros.devices import t7
from stepdiag_ros.devices.ids3010 import Ids3010
from stepdiag_ros.devices.linuxcnc_rsh import LinuxCncRsh
from stepdiag_ros.devices.modbus_psd import ModbusPsd
from stepdiag_ros.errors import StepdiagError

KINDS = ('json-rpc', 'modbus', 'linuxcncrsh')
HANG_S = 30.0
MEMORY = 1 << 30
TIMEOUT_S = 0.25
"""Of the clients: silence is their commonest fate here."""

Spoil = Callable[[bytes], bytes]

METHODS = ('system.getCurrentMode', 'system.startMeasurement', 'system.resetAxes', 'displacement.getAbsolutePositions',
           'displacement.getAxesDisplacement', 'displacement.getReferencePositions', 'displacement.getAxisSignalQuality',
           'adjustment.getContrastInPermille', 'nothing')
#: Values that a stranger may write into JSON where a number, a list or a method belongs.
JSON = (b'[]', b'{}', b'null', b'""', b'true', b'-1', b'3', b'1e999', b'NaN', b'9' * 400, b'[[]]', b'{"a":1}', b'[null]',
        b'["x"]', b'[1e999]', b'[-7]', b'[' * 40 + b']' * 40, b'"\\ud800"', b'[0,1e300,1e300,1e300]', b'1e-320')
LINES = (b'hello EMC me 1.1', b'set enable EMCTOO', b'set enable x', b'set verbose on', b'set echo off', b'get error',
         b'get abs_act_pos', b'get program_status', b'get joint_homed 7', b'set home -1', b'set mode mdi', b'set estop off',
         b'set machine on', b'set mdi G53 G1 X0.1 F100', b'set mdi', b'set abort', b'get', b'set', b'quit', b'', b'get user_linear_units')


class Relay:
    """Passes bytes between one client and a server; ``spoil(answer)`` exchanges what the server answers, if set."""

    def __init__(self, port: int):
        self._to = port
        self.spoil: Spoil | None = None
        self._listen = socket.create_server(('127.0.0.1', 0))
        self.port = self._listen.getsockname()[1]
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._open = True
        self._thread.start()

    def _run(self) -> None:
        while self._open:
            try:
                client, _ = self._listen.accept()
            except OSError:
                return
            with client, suppress(OSError), socket.create_connection(('127.0.0.1', self._to)) as server:
                self._pass(client, server)

    def _pass(self, client: socket.socket, server: socket.socket) -> None:
        while self._open:
            ready, _, _ = select.select([client, server], [], [], 0.2)
            for end in ready:
                data = end.recv(1 << 18)
                if not data:
                    return
                spoil = self.spoil
                if end is client:
                    server.sendall(data)
                else:
                    client.sendall(data if spoil is None else spoil(data))

    def close(self) -> None:
        self._open = False
        self._listen.shutdown(socket.SHUT_RDWR)
        self._listen.close()
        self._thread.join(10.0)


# -- what is spoilt, and how

def odd_json(text: bytes, rng: random.Random) -> bytes:
    """JSON in which one to three values are others."""
    for _ in range(rng.choice((1, 1, 2, 3))):
        places = list(re.finditer(rb'-?\d+(?:\.\d+)?|"[^"]*"|\[[^\[\]]*\]|\{[^{}]*\}', text))
        if places:
            place = rng.choice(places)
            text = text[:place.start()] + rng.choice(JSON) + text[place.end():]
    return text


def spoiler(kind: str, rng: random.Random) -> Spoil:
    """Exchanges some answers of an instrument of this kind, by a seed's own plan."""
    share, whole = rng.choice((0.1, 0.5, 1.0)), rng.random() < 0.5

    def spoil(data: bytes) -> bytes:
        if rng.random() > share:
            return data
        if kind == 'json-rpc' and whole:
            return odd_json(data, rng)
        if kind == 'linuxcncrsh' and whole:
            words = data.split(b' ')
            words[rng.randrange(len(words))] = rng.choice((b'', b'NAK', b'nan', b'1e400', b'-0', b'OK', b'x' * 100_000, b'\r\n', b'IDLE'))
            return b' '.join(words)
        return bags.changed(data, rng)
    return spoil


def rpc_requests(rng: random.Random) -> bytes:
    """Requests as no client of an interferometer sends them."""
    lines = [b'{"jsonrpc":"2.0","method":"com.attocube.%s.%s","params":%s,"id":%d,"api":2}' % (
        rng.choice((b'sen', b'ids', b'ecu', b'')), rng.choice(METHODS).encode(), rng.choice((b'[]', b'[0]', *JSON)), k)
        for k in range(rng.choice((1, 1, 5, 50)))]
    if rng.random() < 0.7:
        at = rng.randrange(len(lines))
        lines[at] = odd_json(lines[at], rng)
    data = rng.choice((b'', b'\n')).join(lines)
    return bags.changed(data, rng) if rng.random() < 0.3 else data


def modbus_requests(rng: random.Random) -> bytes:
    """Requests as no client of an input box sends them."""
    data = b''
    for k in range(rng.choice((1, 2, 8))):
        address = rng.choice((t7.AIN0, t7.STREAM_ENABLE, t7.STREAM_SCANRATE_HZ, t7.STREAM_SCANLIST_ADDRESS0, t7.CORE_TIMER,
                              t7.INTERNAL_FLASH_READ, t7.INTERNAL_FLASH_READ_POINTER, t7.DAC0, t7.STREAM_AUTO_TARGET, 0, 65535,
                              rng.randrange(65536)))
        function, count = rng.choice((3, 4, 6, 16, 0, 128, 43, 255)), rng.choice((0, 1, 2, 4, 8, 120, 126, 65535))
        body = struct.pack('>BHH', function, address, count)
        if function == 16:
            words = rng.choice((count, 0, 1, 2, 3)) % 130
            body += bytes([2 * words % 256]) + b''.join(rng.choice(bags.SPECIAL)[:2].ljust(2, b'\0') for _ in range(words))
        data += struct.pack('>HHHB', k, rng.choice((0, 0, 0, 0, 1)), rng.choice((len(body) + 1,) * 5 + (0, 1, 2, 255, 65535)), 1) + body
    return bags.changed(data, rng) if rng.random() < 0.3 else data


def line_requests(rng: random.Random) -> bytes:
    """Lines as no client of a machine control sends them."""
    lines = [b'hello EMC me 1.1', b'set enable EMCTOO'] if rng.random() < 0.7 else []
    lines += [rng.choice(LINES) for _ in range(rng.choice((1, 5, 20)))]
    if rng.random() < 0.5:
        lines.append(b'set mdi ' + b' '.join(rng.choice((b'G53', b'G1', b'G0', b'G4', b'G20', b'G21', b'G91', b'X1e9', b'X-', b'Y0.01',
                                                         b'Z' + b'9' * 400, b'F0', b'F-1', b'F1000', b'P1e9', b'M101', b'M199', b'X.', b'('))
                                             for _ in range(rng.choice((1, 3, 6)))))
    data = rng.choice((b'\n', b'\r\n')).join(lines) + b'\n'
    return bags.changed(data, rng) if rng.random() < 0.3 else data


REQUESTS = {'json-rpc': rpc_requests, 'modbus': modbus_requests, 'linuxcncrsh': line_requests}


class Wires:
    """A virtual cell with relays before its instruments; a context manager.  :meth:`turn` makes one attack."""

    def __init__(self, folder: Path):
        (folder / 'cell.yaml').write_text(bags.CELL, encoding='utf-8')
        self._log_file = folder / 'servers.log'
        with open(self._log_file, 'ab') as log:
            self._process = subprocess.Popen(
                [sys.executable, '-m', 'stepdiag_ros.virtual.cell_process', str(folder / 'cell.yaml'), '--runtime',
                 str(folder / 'run')], stdout=subprocess.DEVNULL, stderr=log)
        endpoints, end = folder / 'run' / 'endpoints.yaml', time.monotonic() + 240.0
        while not endpoints.exists():
            if self._process.poll() is not None or time.monotonic() > end:
                raise RuntimeError(self._log_file.read_text(encoding='utf-8'))
            time.sleep(0.05)
        where = yaml.safe_load(endpoints.read_text(encoding='utf-8'))
        self._ports = {'json-rpc': where['interferometer']['port'], 'modbus': where['psd']['port'],
                       'stream': where['psd']['stream_port'], 'linuxcncrsh': where['cnc']['port']}
        self.relays = {wire: Relay(port) for wire, port in self._ports.items()}
        self._memory = _resident()

    def __enter__(self) -> 'Wires':
        return self

    def __exit__(self, *_exception: object) -> None:
        for relay in self.relays.values():
            relay.close()
        self._process.terminate()
        self._process.wait(30.0)

    def turn(self, kind: str, rng: random.Random) -> list[str]:
        """Attack the driver or the instrument of a kind, then use it soundly; what is wrong, a line each."""
        if rng.random() < 0.5:
            said = self._spoilt(kind, rng)
        else:
            said = self._odd_requests(kind, rng)
        self._reset()
        return [*said, *self._sound(kind, rng), *self._log()]

    def _reset(self) -> None:
        for relay in self.relays.values():
            relay.spoil = None

    def _clients(self, kind: str, rng: random.Random, timeout_s: float,
                 ports: dict[str, int]) -> tuple[object, Callable[[], object]]:
        """A client of the kind and what it is used for."""
        if kind == 'json-rpc':
            device = Ids3010('127.0.0.1', ports[kind], timeout_s=timeout_s, newline=rng.random() < 0.5)

            def use() -> None:
                device.read_block(20, 1e-3)
                device.environment()
                device.reset()
                device.read_block(20, 1e-3)
            return device, use
        if kind == 'modbus':
            mode = rng.choice(('stream', 'poll'))
            psd = ModbusPsd('127.0.0.1', ports[kind], ports['stream'], mode=mode, timeout_s=timeout_s)
            return psd, lambda: [psd.read_block(10, 2e-3) for _ in range(3)]
        control = LinuxCncRsh('127.0.0.1', ports[kind], timeout_s=timeout_s, ready_timeout_s=timeout_s + 1.0,
                              stop_timeout_s=2.0 * timeout_s)

        def work() -> None:
            control.make_ready()
            control.move(np.array([0.01, 0.0, 0.0]) * rng.random(), 0.5)
            end = time.monotonic() + timeout_s + 2.0
            while not control.in_position() and time.monotonic() < end:
                time.sleep(0.004)
            control.stop()
        return control, work

    def _spoilt(self, kind: str, rng: random.Random) -> list[str]:
        """The driver meets answers that are spoilt, from its first connection on or later."""
        client, use = self._clients(kind, rng, TIMEOUT_S, {wire: relay.port for wire, relay in self.relays.items()})
        wire = 'stream' if kind == 'modbus' and rng.random() < 0.4 else kind
        spoil, early, began = spoiler(kind, rng), rng.random() < 0.3, time.monotonic()
        said = []
        try:
            self.relays[wire].spoil = spoil if early else None
            client.connect()
            self.relays[wire].spoil = spoil
            use()
        except StepdiagError as error:
            if '\n' in str(error) or '\x1b' in str(error):
                said.append(f'{kind}: not one clean line: {str(error)!r}')
        except Exception as error:
            frame = traceback.extract_tb(error.__traceback__)[-1]
            said.append(f'{kind}: {type(error).__name__}: {error} ({Path(frame.filename).name}:{frame.lineno})')
        finally:
            self._reset()
            with suppress(StepdiagError):
                client.close()
        if (took := time.monotonic() - began) > HANG_S:
            said.append(f'{kind}: took {took:.0f} s')
        if (more := _resident() - self._memory) > MEMORY:
            said.append(f'{kind}: took {more >> 20} MiB')
        return said

    def _odd_requests(self, kind: str, rng: random.Random) -> list[str]:
        """The instrument meets requests of somebody who is no driver, and who hangs up before or after its answer."""
        with suppress(OSError), socket.create_connection(('127.0.0.1', self._ports[kind]), 5.0) as stranger:
            stranger.settimeout(0.05)
            for _ in range(rng.choice((1, 1, 3))):
                stranger.sendall(REQUESTS[kind](rng))
                with suppress(TimeoutError):
                    stranger.recv(1 << 16)
        return []

    def endless_line(self) -> list[str]:
        """A line that never ends, sent to the control and to its client; what is wrong."""
        said = []
        with socket.create_connection(('127.0.0.1', self._ports['linuxcncrsh']), 5.0) as stranger:
            try:
                for _ in range(1000):
                    stranger.sendall(b'x' * 65536)
                said.append('the control took 64 MiB without an end of line')
            except OSError:
                pass   # it hung up
        relay = self.relays['linuxcncrsh']
        relay.spoil = lambda data: b'x' * (1 << 20)
        client = LinuxCncRsh('127.0.0.1', relay.port, timeout_s=5.0)
        try:
            client.connect()
        except StepdiagError as error:
            if 'no end of line' not in str(error):
                said.append(f'the client says: {error}')
        finally:
            client.close()
            self._reset()
        return [*said, *self._log()]

    def _sound(self, kind: str, rng: random.Random) -> list[str]:
        """What hinders a driver that comes afterwards."""
        if self._process.poll() is not None:
            return [f'{kind}: the virtual cell has ended']
        client, use = self._clients(kind, rng, 5.0, self._ports)
        try:
            client.connect()
            if kind == 'linuxcncrsh':
                client.stop()     # what the stranger has set going
            use()
        except StepdiagError as error:
            return [f'{kind}: a driver that comes afterwards is told: {error}']
        finally:
            with suppress(StepdiagError):
                client.close()
        return []

    def _log(self) -> list[str]:
        """What the servers wrote, which is then forgotten."""
        text = self._log_file.read_text(encoding='utf-8', errors='replace')
        with open(self._log_file, 'r+b') as log:
            log.truncate()
        return [f'an instrument wrote: {text[-600:]}'] if text.strip() else []


def _resident() -> int:
    return int(Path('/proc/self/statm').read_text(encoding='ascii').split()[1]) * 4096
