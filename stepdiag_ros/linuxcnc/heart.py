#!/usr/bin/python3
"""HAL component that turns a remote client's signs of life into a pin; LinuxCNC's HAL file starts it.

Every piece of data that arrives on the TCP port changes ``stepdiagheart.beat``; what it says does not matter.
The newest connection counts.  Needs LinuxCNC's Python module and nothing else.
"""

import argparse
import selectors
import socket


def serve(host: str, port: int, beat) -> None:
    """Listen for ever; ``beat()`` for each piece of data that arrives."""
    selector = selectors.DefaultSelector()
    server = socket.create_server((host, port))
    selector.register(server, selectors.EVENT_READ)
    client = None
    while True:
        for key, _ in selector.select():
            if key.fileobj is server:
                if client is not None:
                    selector.unregister(client)
                    client.close()
                client, _ = server.accept()
                client.setblocking(False)
                selector.register(client, selectors.EVENT_READ)
                continue
            if key.fileobj is not client:
                continue    # it was replaced a moment ago
            try:
                data = client.recv(4096)
            except OSError:
                data = b''
            if data:
                beat()
            else:
                selector.unregister(client)
                client.close()
                client = None


def main() -> None:
    import hal
    parser = argparse.ArgumentParser(description="A remote client's signs of life as a HAL pin.")
    parser.add_argument('--host', default='127.0.0.1')
    parser.add_argument('--port', type=int, default=5008)
    given = parser.parse_args()
    component = hal.component('stepdiagheart')
    component.newpin('beat', hal.HAL_U32, hal.HAL_OUT)

    def beat() -> None:
        component['beat'] = (component['beat'] + 1) & 0xFFFFFFFF

    component.ready()
    try:
        serve(given.host, given.port, beat)
    except KeyboardInterrupt:
        pass


if __name__ == '__main__':
    main()
