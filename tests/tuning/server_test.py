"""A widget in a page of its own: messages, who may look, what is told to whom, and the end."""

import asyncio
import http.client
import struct
import threading
import time
from contextlib import closing

import comm
import ipywidgets as w
import pytest
import tornado.websocket

from endolab.tuning import server
from endolab.tuning.server import Page, packed, unpacked


@pytest.fixture(autouse=True)
def restored(monkeypatch):
    """The comms of other tests' widgets stay theirs; all ends soon."""
    monkeypatch.setattr(comm, "create_comm", comm.create_comm)
    monkeypatch.setattr(server, "GRACE", 0.3)


@pytest.fixture
def serve():
    """Function that runs a page in a thread; returns it, its thread, and a list for what it raises."""
    threads = []

    def serve(make):
        page, up, raised = Page(make, "a <title>"), threading.Event(), []

        def run():
            try:
                page.run(up.set)
            except Exception as error:
                raised.append(error)
                up.set()

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


def get(page, path, cookie="", host=None):
    """Status, headers and body of an answer."""
    ask = http.client.HTTPConnection("127.0.0.1", page.port, timeout=10)
    headers = {"Cookie": cookie} if cookie else {}
    ask.request("GET", path, headers=headers | ({"Host": host} if host else {}))
    with closing(ask):
        answer = ask.getresponse()
        return answer.status, dict(answer.getheaders()), answer.read()


async def connected(page, cookie=None, origin=None):
    headers = {"Cookie": f"endolab-{page.port}={page.token}" if cookie is None else cookie}
    headers |= {"Origin": origin} if origin else {}
    address = f"ws://127.0.0.1:{page.port}/channel"
    return await tornado.websocket.websocket_connect(tornado.httpclient.HTTPRequest(address, headers=headers))


async def leave(*channels):
    """Close pages, as page.js does when a tab is left."""
    for channel in channels:
        channel.close(1000)
        while await asyncio.wait_for(channel.read_message(), 10) is not None:
            pass


async def heard(channel, kind):
    """The next message of a kind, and its buffers."""
    while True:
        content = await asyncio.wait_for(channel.read_message(), 10)
        assert content is not None
        message, buffers = unpacked(content)
        if message["type"] == kind:
            return message, [bytes(one) for one in buffers]


def said(kind, content, number="1", buffers=()):
    message = {"type": kind, "id": number, "content": content, "metadata": {"version": "1.0.0"}}
    return packed(message, buffers)


@pytest.mark.parametrize(
    "content", [b"", b"abc", struct.pack("<I", 0), struct.pack("<II", 1, 9), struct.pack("<II", 1, 2) + b"[]"]
)
def test_what_is_no_message_is_refused(content):
    with pytest.raises(ValueError, match="not a message"):
        unpacked(content)


def test_nobody_gets_in_without_the_token(serve):
    page, *_ = serve(w.IntSlider)
    for path in ("/", "/?token=", "/?token=wrong", "/page.js", "/widgets.js", "/anywidget.js", "/channel"):
        status, _, body = get(page, path)
        assert status == 403, path
        assert page.token.encode() not in body
    status, headers, body = get(page, f"/?token={page.token}")
    cookie = headers["Set-Cookie"]
    assert status == 200
    assert "HttpOnly" in cookie
    assert "SameSite=Strict" in cookie
    assert b"<title>a &lt;title&gt;</title>" in body
    for name in ("page.js", "widgets.js", "anywidget.js"):
        status, headers, body = get(page, f"/{name}", cookie.split(";")[0])
        assert (status, headers["Content-Type"]) == (200, "text/javascript; charset=utf-8")
        assert len(body) > 1000
    assert get(page, "/../server.py", cookie.split(";")[0])[0] == 404
    assert get(page, f"/?token={page.token}", host="evil.example")[0] == 403  # as by a rebound name


def test_no_other_pages_script_may_open_the_channel(serve):
    page, *_ = serve(w.IntSlider)

    async def tried():
        for how in ({"cookie": ""}, {"origin": "http://evil.example"}):
            with pytest.raises(tornado.httpclient.HTTPClientError, match="403"):
                await connected(page, **how)

    asyncio.run(tried())


def test_it_listens_to_this_machine_alone(serve):
    page, *_ = serve(w.IntSlider)
    assert page._socket.getsockname()[0] == "127.0.0.1"
    with pytest.raises(OSError, match=f"cannot listen on port {page.port}: "):
        Page(w.IntSlider, "", page.port)


def test_pages_get_all_there_is_and_what_changes_and_the_widget_hears_them(serve):
    seen = []

    def make():
        slider = w.IntSlider(3)
        slider.observe(lambda change: seen.append(change["new"]), "value")
        return slider

    page, *_ = serve(make)

    async def talk():
        one, other = await connected(page), await connected(page)
        ready, _ = await heard(one, "ready")
        await heard(other, "ready")
        model = ready["content"]["model_id"]
        assert model == page.widget.model_id
        opening = {"comm_id": "c", "target_name": "jupyter.widget.control", "data": {}}
        await one.write_message(said("comm_open", opening), binary=True)
        asking = {"comm_id": "c", "data": {"method": "request_states"}}
        await one.write_message(said("comm_msg", asking), binary=True)
        states, _ = await heard(one, "comm_msg")
        assert states["content"]["data"]["states"][model]["state"]["value"] == 3
        await heard(one, "idle")
        change = {"comm_id": model, "data": {"method": "update", "state": {"value": 5}, "buffer_paths": []}}
        await one.write_message(said("comm_msg", change, "2"), binary=True)
        while (await heard(one, "idle"))[0]["parent"] != "2":
            pass
        told, _ = await heard(other, "comm_msg")  # the first thing that the other hears: not the states
        assert (told["content"]["comm_id"], told["parent"]) == (model, "2")
        assert told["content"]["data"]["state"] == {"value": 5}
        page.widget.value = 7  # from another thread
        told, _ = await heard(other, "comm_msg")
        assert (told["content"]["data"]["state"], told["parent"]) == ({"value": 7}, "")
        await one.write_message(b"nonsense", binary=True)
        await one.write_message(said("comm_msg", {"comm_id": "none", "data": {}}, "3"), binary=True)
        assert (await heard(one, "idle"))[0]["parent"] == "3"  # it is still there
        await leave(one, other)

    asyncio.run(talk())
    assert seen == [5, 7]


def test_it_ends_when_the_last_page_is_left_and_not_when_one_is_loaded_again(serve, monkeypatch):
    monkeypatch.setattr(server, "GRACE", 1.5)
    page, thread, raised = serve(w.IntSlider)

    async def visit():
        one, other = await connected(page), await connected(page)
        await heard(one, "ready")
        await heard(other, "ready")
        await leave(one)
        await asyncio.sleep(2)
        assert thread.is_alive()
        await leave(other)
        await asyncio.sleep(0.1)
        again = await connected(page)
        await heard(again, "ready")
        await asyncio.sleep(2)
        assert thread.is_alive()
        await leave(again)

    asyncio.run(visit())
    thread.join(10)
    assert not thread.is_alive()
    assert raised == []
    assert page.widget.comm is None  # it was closed


def test_a_widget_that_is_made_when_all_has_ended_is_closed(serve):
    asked, leaving = threading.Event(), threading.Event()

    def make():
        asked.set()
        assert leaving.wait(10)
        return w.IntSlider()

    page, thread, raised = serve(make)
    assert asked.wait(10)
    loop = page._loop
    loop.call_soon_threadsafe(page._ended.set)
    while not loop.is_closed():
        time.sleep(0.01)
    leaving.set()
    thread.join(10)
    assert raised == []
    assert page.widget.comm is None
    assert not page.busy


@pytest.mark.parametrize("code", [None, 1001])
def test_a_page_that_is_lost_is_waited_for(serve, code):
    """Without a word, or with the browser's own, as when it dies or puts a tab to sleep."""
    page, thread, _ = serve(w.IntSlider)

    async def visit():
        one = await connected(page)
        await heard(one, "ready")
        if code is None:
            one.protocol.stream.close()
        one.close(code)
        until = time.monotonic() + 10
        while page._pages and time.monotonic() < until:
            await asyncio.sleep(0.01)
        assert not page._pages
        await asyncio.sleep(2 * server.GRACE)

    asyncio.run(visit())
    assert thread.is_alive()


def test_what_the_widget_raises_ends_it(serve):
    def make():
        raise ValueError("no frame")

    _, thread, raised = serve(make)
    thread.join(10)
    assert [str(error) for error in raised] == ["no frame"]
