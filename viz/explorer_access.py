"""Access to the explorer's page: who may use it, and what its server does for them.

Requests must name this machine, and sockets bring the secret of this run, which is in the printed address. The browser
sends that address as the referrer of the page's first request, which asks where the socket is. This avoids a cookie,
which would be sent to other servers at this address as well. Those who have the secret may do what the page does: see
the plate, rotate it, and move the sliders.
"""

from __future__ import annotations

import ipaddress
import math
import secrets
import socket
from collections.abc import Awaitable, Callable, Collection
from contextlib import suppress
from typing import TYPE_CHECKING, Any, TypeGuard
from urllib.parse import parse_qs, urlsplit

if TYPE_CHECKING:
    from aiohttp import web

# A browser that takes no data for so long is dropped, as others wait for it [ms].
PATIENCE = 5000
# What the page loads beside the files of its server.
PAGE_NEEDS = "data: blob: 'unsafe-inline' 'unsafe-eval'"
# Shortest and longest side of the picture [pixels].
SIDES = (16, 4096)
# Largest absolute value of a number of a mouse event: positions are shares of the picture.
LARGEST_EVENT = 10.0
# Longest message of a page, and the header of a message: its number, the place of this part, the length of all [bytes].
LONGEST_MESSAGE, HEADER = 2**20, 12
# A remote procedure: the object whose method it is, and the method.
Procedure = tuple[object, Callable[..., Any]]


def guard(server: Any, host: str, secret: str) -> None:
    """Let a trame server answer those who have the secret, and refuse what comes from elsewhere."""
    from aiohttp import web

    def is_secret(text: str) -> bool:
        return secrets.compare_digest(text.encode(errors="replace"), secret.encode())

    names = {name.lower() for name in ("localhost", host, socket.gethostname(), socket.getfqdn())}

    async def answer(request: web.Request) -> web.Response:
        if not is_secret(_key_in(request.headers.get("Referer", ""))):
            raise web.HTTPForbidden
        return web.json_response({"sessionURL": f"ws://{request.host}/ws?secret={secret}", "secret": secret})

    @web.middleware
    async def check(request: web.Request, handler: Any) -> web.StreamResponse:
        name, origin = "", request.headers.get("Origin")
        with suppress(ValueError):  # of a port or characters that no host has
            name = request.url.host or ""
        if not (name.lower() in names or _is_address(name)) or origin not in (None, f"http://{request.host}"):
            raise web.HTTPForbidden
        if request.path == "/ws":
            if not is_secret(request.query.get("secret", "")) or not web.WebSocketResponse().can_prepare(request).ok:
                raise web.HTTPForbidden
            # Drop a connection that accepts no data, so that others need not wait for it (Linux only).
            connection = request.get_extra_info("socket")
            if connection is not None and hasattr(socket, "TCP_USER_TIMEOUT"):
                connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, PATIENCE)
        response: web.StreamResponse = await handler(request)
        # The page's script would take any server's address, of a socket too, from a link to the page.
        response.headers["Content-Security-Policy"] = f"default-src 'self' ws://{request.host} {PAGE_NEEDS}"
        return response

    server.app.middlewares.append(check)
    server.app.router.add_post("/paraview/", answer)


def _key_in(address: str) -> str:
    """Return the secret that a page's address holds, or nothing."""
    with suppress(ValueError):
        return parse_qs(urlsplit(address).query).get("key", [""])[0]
    return ""


def _is_address(name: str) -> bool:
    """Return whether a host is an IP address, which no other site's name can stand for."""
    with suppress(ValueError):
        return bool(ipaddress.ip_address(name))
    return False


def limit_calls(server: Any, sliders: Collection[str]) -> None:
    """Let browsers call only those procedures of a trame server that the page calls, with arguments like the page's,
    in messages of one part.

    Without this they could stop the server, replace the page that later viewers get, and fill the memory: wslink
    allocates what the first part of a message claims as the length of all.

    Args:
        server: The server, before it starts.
        sliders: Keys of the state that sliders change.
    """
    for handler in server._ws_handlers:
        # What is drawn while somebody drags or zooms. It would be drawn again for each that does, and for ever after.
        drawing, _ = handler.functionMap["viewport.image.push"]
        drawn = drawing.views_in_animations = _Once()
        drawing.onClose = lambda client, drawn=drawn: drawn.clear()
        handler.functionMap = _page_calls(handler.functionMap, sliders)
        handler.onMessage = _whole_messages(handler.onMessage)


class _Once(list[str]):
    """A list that holds each item once, however often it is appended."""

    def append(self, item: str) -> None:
        if item not in self:
            super().append(item)


def _whole_messages(receive: Callable[..., Awaitable[None]]) -> Callable[..., Awaitable[None]]:
    """Return a receiver of messages that disconnects clients that send texts, parts of messages, or too long ones."""

    async def receive_whole(is_binary: bool, message: Any, client: str) -> None:
        length = len(message.data) - HEADER
        if not (is_binary and int.from_bytes(message.data[8:HEADER], "little") == length <= LONGEST_MESSAGE):
            raise ValueError("not a whole message")
        await receive(is_binary, message, client)

    return receive_whole


def is_number(value: object) -> TypeGuard[float]:
    """Return whether a value from a browser is a finite number."""
    return isinstance(value, int | float) and math.isfinite(value)


def _page_calls(calls: dict[str, Procedure], sliders: Collection[str]) -> dict[str, Procedure]:
    """Return the procedures that the page calls, which correct their arguments first; errors refuse the call."""

    def settings(changes: list[dict[str, Any]]) -> tuple[object]:
        """Leave out changes of the state that are not the page's."""
        fit = {"playing": lambda value: isinstance(value, bool), **dict.fromkeys(sliders, is_number)}
        return ([change for change in changes if change["key"] in fit and fit[change["key"]](change["value"])],)

    def mouse(event: dict[str, Any]) -> tuple[object]:
        low, high = -LARGEST_EVENT, LARGEST_EVENT
        return ({key: it if isinstance(it, str) else _between(low, it, high) for key, it in event.items()},)

    def size(view: object, width: float, height: float) -> tuple[object, ...]:
        return view, _between(SIDES[0], width, SIDES[1]), _between(SIDES[0], height, SIDES[1])

    corrections: dict[str, Callable[..., tuple[object, ...]]] = {
        "trame.state.get": lambda: (),
        "trame.state.update": settings,
        "trame.trigger": lambda name, arguments, keywords: (name, arguments, {}),
        "viewport.image.push": lambda options: ({"view": options["view"]},),
        "viewport.image.push.invalidate.cache": lambda view: (view,),
        "viewport.image.push.observer.add": lambda view: (view,),
        "viewport.image.push.original.size": size,
        "viewport.image.push.quality": lambda view, quality, ratio: (view, int(_between(1, quality, 100)), 1),
        "viewport.mouse.interaction": mouse,
        "viewport.mouse.zoom.wheel": mouse,
    }
    allowed = {name: _corrected(calls[name], correct) for name, correct in corrections.items()}
    # The page reports that it has been opened and closed.
    return allowed | {"trame.lifecycle.update": (None, lambda *_: None)}


def _corrected(procedure: Procedure, correct: Callable[..., tuple[object, ...]]) -> Procedure:
    """Return a procedure whose arguments are corrected before it is called."""
    owner, function = procedure
    return owner, lambda owner, *arguments: function(owner, *correct(*arguments))


def _between(low: float, value: float, high: float) -> float:
    """Return the number in a range that is nearest to one from a browser; the highest for NaN."""
    return max(low, min(high, value))
