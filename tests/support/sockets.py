"""Clients of the explorer's page that are no page of it."""

import json
import urllib.request

import pytest

msgpack = pytest.importorskip("msgpack")
# Longest wait on a busy machine [s].
PATIENCE = 60.0
HEADER = 12  # bytes before each message of wslink: its number, the place of this part, the length of all


def ask(served, **headers):
    """Return the answer to the page's first request."""
    request = urllib.request.Request(f"http://{served[0]}/paraview/", b"{}", headers)
    with urllib.request.urlopen(request, timeout=PATIENCE) as answer:
        return json.load(answer)


def session(served):
    """The address of the socket and the secret, as the page asks for them."""
    found = ask(served, Referer=f"http://{served[0]}/{served[1]}")
    return found["sessionURL"].replace("ws://", "http://"), found["secret"]


def call(method, *arguments, rpc="x:1"):
    """A message of wslink."""
    content = msgpack.packb({"wslink": "1.0", "id": rpc, "method": method, "args": list(arguments), "kwargs": {}})
    return bytes(8) + len(content).to_bytes(4, "little") + content


async def answers_to(socket, message):
    """Send a message, and return the answer to it."""
    await socket.send_bytes(message)
    while True:
        answer = msgpack.unpackb((await socket.receive_bytes(timeout=PATIENCE))[HEADER:])
        if not answer["id"].startswith("publish:"):
            return answer
