"""A widget in a page of its own: who may look, what is told to whom, and the end."""

import asyncio
import http.client
import json
import re
import threading
import time
from contextlib import closing
from urllib.parse import urlsplit

import anywidget
import pytest
import tornado.websocket
import traitlets as t

from endolab.workbench.tuning import server
from endolab.workbench.tuning.server import Page


class Widget(anywidget.AnyWidget):
    """A widget with facts."""

    _esm = "export default {}"
    _css = ""
    facts = t.Dict({"a": 3}).tag(sync=True)


@pytest.fixture(autouse=True)
def soon(monkeypatch):
    """All ends soon."""
    monkeypatch.setattr(server, "AFTER_LEAVING", 0.3)


@pytest.fixture
def serve():
    """Function that runs a page in a thread; returns it, its thread, and a list for what it raises."""
    threads = []

    def serve(make, **how):
        page = Page(make, "a <title>", **how)
        up = threading.Event()
        raised = []

        def run():
            try:
                page.run(up.set)
            except Exception as error:
                raised.append(error)

        threads.append((page, threading.Thread(target=run)))
        threads[-1][1].start()
        assert up.wait(10)
        return page, threads[-1][1], raised

    yield serve
    for page, thread in threads:
        if thread.is_alive():
            page._loop.call_soon_threadsafe(page._ended.set)
        thread.join(10)
        assert not thread.is_alive()


def get(link):
    """Status, headers and body of an answer."""
    parts = urlsplit(link)
    ask = http.client.HTTPConnection(parts.netloc, timeout=10)
    ask.request("GET", parts.path)
    with closing(ask):
        answer = ask.getresponse()
        return answer.status, dict(answer.getheaders()), answer.read()


async def connected(page, origin=None):
    asking = tornado.httpclient.HTTPRequest(
        page.link.replace("http:", "ws:") + "channel",
        headers={} if origin is None else {"Origin": origin},
    )
    return await tornado.websocket.websocket_connect(asking)


async def leave(*channels):
    """Close pages, as page.js does when a tab is left."""
    for channel in channels:
        channel.close(1000)
        while await asyncio.wait_for(channel.read_message(), 10) is not None:
            pass


async def heard(channel):
    """The next message, and its buffers."""
    message = json.loads(await asyncio.wait_for(channel.read_message(), 10))
    return message, [
        await asyncio.wait_for(channel.read_message(), 10)
        for _ in range(message["buffers"])
    ]


def test_nobody_gets_in_without_the_address_and_nothing_comes_from_outside(serve):
    page, *_ = serve(Widget)
    assert re.fullmatch(r"http://127\.0\.0\.1:\d+/\w{48}/", page.link)
    root = page.link[: -len("/") - 48]
    for path in ("", "channel", f"{'0' * 48}/", f"{page.link[-49:]}../server.py"):
        status, _, body = get(root + path)
        assert status == 404, path
        assert page.link[-49:-1].encode() not in body
    status, headers, body = get(page.link)
    assert status == 200
    policy = headers["Content-Security-Policy"]
    assert policy.startswith("default-src 'self' blob: data: ws://127.0.0.1")
    assert b"<title>a &lt;title&gt;</title>" in body


@pytest.mark.parametrize(
    ("origin", "named"),
    [
        (None, None),
        ("https://Lab.Example.org/", "https://lab.example.org"),
        ("http://10.0.0.2:8080", "http://10.0.0.2:8080"),
    ],
)
def test_a_proxy_that_is_named_may_open_the_channel_and_nobody_else(
    serve, origin, named
):
    page, *_ = serve(Widget, origin=origin)
    _, headers, _ = get(page.link)

    async def visit():
        channel = await connected(page, named)
        assert (await heard(channel))[0]["state"]["facts"] == {"a": 3}
        await leave(channel)

    for other in ("http://evil.example", f"{named}.evil.example", "null", ""):
        with pytest.raises(tornado.httpclient.HTTPClientError, match="403"):
            asyncio.run(connected(page, other))
    if named is not None:
        channel = named.replace("http", "ws", 1)
        assert channel in headers["Content-Security-Policy"].split(" ")
    asyncio.run(visit())


def test_pages_get_the_widget_and_what_it_says_and_the_widget_hears_them(serve, capfd):
    seen = []

    def make():
        widget = Widget()
        widget.on_msg(lambda _, content, buffers: seen.append(content))
        return widget

    page, *_ = serve(make)

    async def talk():
        one = await connected(page)
        other = await connected(page)
        for channel in (one, other):
            assert (await heard(channel))[0]["state"]["facts"] == {"a": 3}
        await one.write_message(json.dumps({"do": 1}))
        page.widget.send({"b": 7}, [b"xyz"])  # from another thread
        for channel in (one, other):
            message, buffers = await heard(channel)
            assert (message["content"], buffers) == ({"b": 7}, [b"xyz"])
        for nonsense in ("nonsense", "[" * 200_000):
            await one.write_message(nonsense)
        await one.write_message(json.dumps("end"))
        while len(seen) < 2:
            await asyncio.sleep(0.02)
        await leave(one, other)

    asyncio.run(talk())
    assert seen == [{"do": 1}, "end"]
    output = capfd.readouterr().err
    assert len(output.splitlines()) == 2  # one for each nonsense
    assert page.link[-49:-1] not in output


def test_it_ends_when_the_last_page_is_left_and_not_when_one_is_loaded_again(
    serve, monkeypatch
):
    monkeypatch.setattr(server, "AFTER_LEAVING", 1.5)
    page, thread, raised = serve(Widget)

    async def visit():
        one = await connected(page)
        other = await connected(page)
        await leave(one)
        await asyncio.sleep(2)
        assert thread.is_alive()
        await leave(other)
        await asyncio.sleep(0.1)
        again = await connected(page)
        await asyncio.sleep(2)
        assert thread.is_alive()
        await leave(again)

    asyncio.run(visit())
    thread.join(10)
    assert not thread.is_alive()
    assert raised == []
    assert page.widget.comm is None  # it was closed


@pytest.mark.parametrize("code", [None, 1001])
def test_a_page_that_is_lost_is_waited_for(serve, code):
    """Without a word, or with the browser's own, as when it dies or puts a tab to sleep."""
    page, thread, _ = serve(Widget)

    async def visit():
        one = await connected(page)
        await heard(one)
        if code is None:
            one.protocol.stream.close()
        one.close(code)
        until = time.monotonic() + 10
        while page._pages and time.monotonic() < until:
            await asyncio.sleep(0.01)
        assert not page._pages
        await asyncio.sleep(2 * server.AFTER_LEAVING)

    asyncio.run(visit())
    assert thread.is_alive()
