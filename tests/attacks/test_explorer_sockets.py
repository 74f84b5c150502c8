"""Clients of the explorer's page that are no page of it, or that send what no page sends."""

import asyncio
import math
import re
import socket
import sys
import urllib.error
import urllib.request
from contextlib import suppress
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from support.attacks import examples
from support.commands import error_of
from support.sockets import PATIENCE, answers_to, ask, call, session
from warp_plate.viz.explorer_access import limit_calls

aiohttp = pytest.importorskip("aiohttp")
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGINT to send to one process")
FILES, VIEW = 200, "1"
ESCAPES = "\x1b[2J\x1b]0;title\x07"
METHODS = [
    "trame.state.get",
    "trame.state.update",
    "trame.trigger",
    "trame.lifecycle.update",
    "viewport.image.push",
    "viewport.image.push.quality",
    "viewport.mouse.interaction",
    "application.exit",
    "application.exit.later",
    "a" * 300,
]
# Calls that would end the page, or change what later viewers see, and calls that no page makes.
HARMFUL = [
    ("viewport.image.push.observer.add", VIEW),
    *(("trame.state.update", [{"key": key, "value": "{{ 1 + 1 }}"}]) for key in ("title", "magnitude_1", "playing")),
    *(("trame.state.update", [{"key": f"trame__{key}", "value": "a"}]) for key in ("template_main", "title")),
    *(("viewport.image.push.original.size", VIEW, *size) for size in (("a", None), (2**40, -5), (math.nan, 16))),
    *(("viewport.image.push.quality", VIEW, *quality) for quality in ((math.nan, 1), (85, "a"), (0, 1e300))),
    ("viewport.mouse.interaction", {"view": VIEW, "action": "down", "x": math.nan}),
    ("trame.lifecycle.update", "server_bind"),
    ("viewport.image.animation.fps.max", "a"),
    ("application.exit.later", 0),
    ("application.exit",),
    ("viewport.image.push.original.size", VIEW, 300, 300),
]
VALUES = (
    st.none() | st.integers(-(2**63), 2**63) | st.floats() | st.binary(max_size=9) | st.lists(st.text(), max_size=3)
)


async def greet(socket, secret):
    """Return the server's answer to a client that has the secret."""
    return await answers_to(socket, call("wslink.hello", {"secret": secret}, rpc="system:1"))


async def flood(socket):
    """Send messages whose answers are as long, and read none of them."""
    while True:
        await socket.send_bytes(call("a" * 60000))


@pytest.mark.parametrize(
    ("host", "error"),
    [("", "must be an address of this machine"), ("é" * 70, "cannot be listened on: it is no name")],
    ids=["empty", "long"],
)
def test_hosts_that_are_none_are_refused(command, host, error):
    """An empty one would listen everywhere."""
    assert error in error_of(command("explore", "paper", "--web", "--port", "0", "--host", host))


def test_only_the_page_has_the_secret_and_may_open_a_socket(served):
    """Not other users of this machine, who can reach the address, and not other pages."""
    page = f"http://{served[0]}/"
    for referer in ("", page, f"{page}?key=", f"{page}{served[1]}x", f"{page}?key=%ff", "http://[?key=1"):
        with pytest.raises(urllib.error.HTTPError, match="403"):
            ask(served, Referer=referer)
    for host in ("elsewhere.example", "127.0.0.1:99999", "\xff"):
        with pytest.raises(urllib.error.HTTPError, match="403"):
            ask(served, Referer=page + served[1], Host=host)
    assert session(served)[1] in served[1]
    request = urllib.request.Request(f"{page}paraview/", b"{}", {"Referer": page + served[1]})
    with urllib.request.urlopen(request, timeout=PATIENCE) as answer:
        assert "Access-Control-Allow-Origin" not in answer.headers
    address, secret = session(served)
    plain = address.partition("?")[0]
    host = {"Origin": f"http://{served[0]}"}

    async def statuses():
        found = []
        async with aiohttp.ClientSession() as client:
            guesses = ("", "?secret=", "?secret=é", f"?secret={secret[:-1]}")
            elsewhere = ({"Origin": "http://elsewhere.example"}, {"Origin": "null"}, {"Host": "elsewhere.example"})
            attempts = [(plain + guess, host) for guess in guesses] + [(address, headers) for headers in elsewhere]
            for url, headers in attempts:
                with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
                    await client.ws_connect(url, headers=headers)
                found.append(refused.value.status)
            async with client.ws_connect(address, headers=host) as opened:
                assert "clientID" in (await greet(opened, secret))["result"]
        return found

    assert set(asyncio.run(statuses())) <= {400, 403}
    for url in (plain, address):  # without an upgrade
        with pytest.raises(urllib.error.HTTPError, match="403"):
            urllib.request.urlopen(f"http://{url.removeprefix('http://')}", timeout=PATIENCE)


@pytest.mark.slow
def test_what_clients_send_is_neither_printed_nor_obeyed(served):
    address, secret = session(served)

    async def talk():
        async with aiohttp.ClientSession() as client:
            for message in (b"", b"\xff" * 40, call("a" + ESCAPES), call("trigger", ESCAPES, [], {}), ESCAPES):
                async with client.ws_connect(address) as opened:
                    await greet(opened, secret)
                    await (opened.send_str if isinstance(message, str) else opened.send_bytes)(message)
                    await asyncio.sleep(0.2)

    asyncio.run(talk())
    with socket.create_connection(served[0].split(":"), PATIENCE) as raw:
        raw.sendall(f"GET /{ESCAPES} HTTP/9\r\n{ESCAPES}\r\n\r\n".encode())
    session(served)


@pytest.mark.slow
def test_connections_that_use_up_the_files_are_not_reported(served):
    """The server may open only so many files and sockets at once; once clients leave, the page is served again."""
    resource = pytest.importorskip("resource")
    if not hasattr(resource, "prlimit"):
        pytest.skip("only Linux sets limits of another process")
    before = resource.prlimit(served[2], resource.RLIMIT_NOFILE)
    resource.prlimit(served[2], resource.RLIMIT_NOFILE, (FILES, before[1]))
    idle = [socket.create_connection(served[0].split(":"), PATIENCE) for _ in range(FILES)]
    with socket.create_connection(served[0].split(":"), 1.0) as late:
        late.sendall(b"GET / HTTP/1.0\r\n\r\n")
        with pytest.raises(TimeoutError):
            late.recv(1)
    for connection in idle:
        connection.close()
    resource.prlimit(served[2], resource.RLIMIT_NOFILE, before)
    session(served)


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(socket, "TCP_USER_TIMEOUT"), reason="Linux only")
def test_a_client_that_does_not_read_is_dropped(served):
    address, secret = session(served)

    async def talk():
        async with aiohttp.ClientSession() as client, client.ws_connect(address) as idle:
            await greet(idle, secret)
            async with client.ws_connect(address) as other:
                await greet(other, secret)
                with pytest.raises(ConnectionError):
                    await flood(idle)
                assert "error" in await answers_to(other, call("b"))

    asyncio.run(asyncio.wait_for(talk(), PATIENCE))


def test_sliders_take_only_numbers_within_their_ends(served):
    """Values that are no numbers leave the plate as it is; others end at the ends."""
    address, secret = session(served)

    async def talk():
        async with aiohttp.ClientSession() as client, client.ws_connect(address) as opened:
            await greet(opened, secret)

            async def state():
                return (await answers_to(opened, call("trame.state.get")))["result"]["state"]

            page = (await state())["trame__template_main"]
            trigger = re.search(r"""<VSlider[^>]*magnitude_1[^>]*trigger\(\W*(trigger__\d+)""", page)[1]
            for value, expected in ((1e300, 2.0), (-1, 0.0)):
                for sent in (float("nan"), "a", [], value):
                    await answers_to(opened, call("trame.trigger", trigger, [sent], {}))
                while (found := await state())["magnitude_1"] != expected:
                    await asyncio.sleep(0.02)
                assert found["status"] == ""

    asyncio.run(asyncio.wait_for(talk(), PATIENCE))


def test_viewers_can_neither_end_the_page_nor_change_it(served):
    """They see the plate and move the sliders; the next viewer gets the same page, and new pictures."""
    address, secret = session(served)

    async def state(opened):
        return (await answers_to(opened, call("trame.state.get")))["result"]["state"]

    async def talk():
        async with aiohttp.ClientSession() as client:
            async with client.ws_connect(address) as opened:
                await greet(opened, secret)
                before = await state(opened)
                for harmful in HARMFUL:
                    await answers_to(opened, call(*harmful))
            async with client.ws_connect(address) as other:
                await greet(other, secret)
                after = await state(other)
                while (later := await state(other))["picture"] == after["picture"]:
                    await asyncio.sleep(0.02)
        assert later == {**before, "picture": later["picture"]}

    asyncio.run(asyncio.wait_for(talk(), PATIENCE))


def test_viewers_who_drag_and_leave_do_not_slow_the_page(monkeypatch):
    """The view was drawn once more, at each frame to come, for each of them."""
    monkeypatch.setattr("warp_plate.viz.explorer_access._page_calls", lambda calls, sliders: calls)
    drawing = SimpleNamespace(views_in_animations=[])
    handler = SimpleNamespace(functionMap={"viewport.image.push": (drawing, None)}, onMessage=None)
    limit_calls(SimpleNamespace(_ws_handlers=[handler]), ())
    for _ in range(3):
        drawing.views_in_animations.append(VIEW)
    assert drawing.views_in_animations == [VIEW]
    drawing.onClose("client")
    assert drawing.views_in_animations == []


def test_messages_are_whole_and_not_too_long(served):
    """wslink takes messages in parts, and allocates at the first one the length that it claims for all."""
    address, secret = session(served)
    claims = [number.to_bytes(4, "little") + bytes(4) + (2**30).to_bytes(4, "little") for number in range(8)]

    async def talk():
        async with aiohttp.ClientSession() as client:
            for message in (*claims, call("a" * 2**20), "a" * 3 * 2**20):
                async with client.ws_connect(address) as opened:
                    await greet(opened, secret)
                    await (opened.send_str if isinstance(message, str) else opened.send_bytes)(message)
                    while not opened.closed:
                        await opened.receive(timeout=PATIENCE)
            async with client.ws_connect(address) as other:
                await greet(other, secret)
                assert "state" in (await answers_to(other, call("trame.state.get")))["result"]

    asyncio.run(asyncio.wait_for(talk(), PATIENCE))


@st.composite
def messages(draw):
    """A message of wslink, of any method and arguments, or nearly one."""
    keys = ("magnitude_1", "title", "playing", "trame__template_main")
    changes = [{"key": key, "value": draw(VALUES)} for key in keys]
    event = {"view": VIEW, "action": "down", "buttonLeft": 1, "x": draw(VALUES), "y": 0.5}
    names = st.sampled_from([changes, "trigger__1", "trigger__9", ESCAPES, VIEW, event, 0.0]) | VALUES
    content = call(draw(st.sampled_from(METHODS)), *draw(st.lists(names, max_size=3)), rpc=draw(st.text(max_size=4)))
    if draw(st.integers(0, 3)):
        return content
    at = draw(st.integers(0, len(content) - 1))
    return content[:at] + draw(st.binary(max_size=20)) + content[at + draw(st.integers(0, 9)) :]


@pytest.mark.slow
@pytest.mark.hour
@examples(40)
@given(sent=st.lists(messages() | st.text(max_size=20), min_size=1, max_size=5))
def test_any_messages(sent, served):
    """Whatever a client with the secret sends, the next client gets its answers, and nothing is printed."""
    address, secret = session(served)

    async def talk():
        async with aiohttp.ClientSession() as client:
            async with client.ws_connect(address) as opened:
                await greet(opened, secret)
                with suppress(ConnectionError):  # the server may drop this client
                    for message in sent:
                        await (opened.send_str if isinstance(message, str) else opened.send_bytes)(message)
            async with client.ws_connect(address) as other:
                await greet(other, secret)
                state = (await answers_to(other, call("trame.state.get")))["result"]["state"]
                assert all(math.isfinite(state[f"magnitude_{index}"]) for index in range(3))
                assert state["title"] == "warp-plate explore"
                assert "magnitude_1" in state["trame__template_main"]

    asyncio.run(asyncio.wait_for(talk(), PATIENCE))
