"""Access control of the explorer's page: requests must name this machine, sockets bring the secret of the run, and the
page connects to no other server.

The secret is in the printed address. The browser sends that address as the referrer of the page's first request, which
asks where the socket is. This avoids a cookie, which would be sent to other servers at this address as well.
"""

from __future__ import annotations

import ipaddress
import secrets
import socket
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs, urlsplit

if TYPE_CHECKING:
    from aiohttp import web

# A browser that takes no data for so long is dropped, as others wait for it [ms].
PATIENCE = 5000
# What the page loads beside the files of its server.
PAGE_NEEDS = "data: blob: 'unsafe-inline' 'unsafe-eval'"


def guard(server: Any, host: str, secret: str) -> None:
    """Let a trame server answer those who have the secret, and refuse what comes from elsewhere."""
    from aiohttp import web

    def is_known(found: str) -> bool:
        return secrets.compare_digest(found.encode(errors="replace"), secret.encode())

    names = {name.lower() for name in ("localhost", host, socket.gethostname(), socket.getfqdn())}

    async def answer(request: web.Request) -> web.Response:
        if not is_known(_key_in(request.headers.get("Referer", ""))):
            raise web.HTTPForbidden
        return web.json_response({"sessionURL": f"ws://{request.host}/ws?secret={secret}", "secret": secret})

    @web.middleware
    async def check(request: web.Request, handler: Any) -> web.StreamResponse:
        name, origin = request.url.host or "", request.headers.get("Origin")
        if not (name.lower() in names or _is_address(name)) or origin not in (None, f"http://{request.host}"):
            raise web.HTTPForbidden
        if request.path == "/ws":
            if not is_known(request.query.get("secret", "")) or not web.WebSocketResponse().can_prepare(request).ok:
                raise web.HTTPForbidden
            _drop_if_idle(request)
        response: web.StreamResponse = await handler(request)
        # The page's script would take any server's address, of a socket too, from a link to the page.
        response.headers["Content-Security-Policy"] = f"default-src 'self' ws://{request.host} {PAGE_NEEDS}"
        return response

    server.app.middlewares.append(check)
    server.app.router.add_post("/paraview/", answer)


def _key_in(address: str) -> str:
    """Return the secret that a page's address holds, or nothing."""
    try:
        return parse_qs(urlsplit(address).query).get("key", [""])[0]
    except ValueError:
        return ""


def _is_address(name: str) -> bool:
    """Return whether a host is a number, to which no other site can lead a browser by a name of its own."""
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def _drop_if_idle(request: web.Request) -> None:
    """End a connection through which nothing can be sent any more; others would wait for it (Linux only)."""
    connection = request.get_extra_info("socket")
    if connection is not None and hasattr(socket, "TCP_USER_TIMEOUT"):
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, PATIENCE)
