"""A widget in a page of its own, in this process: no notebook, no kernel, no network.

`Page` takes the place of Jupyter for the widgets of this process: what they say goes to the pages that are
open, what is done there comes back, over a WebSocket on this machine alone, to whoever knows the token. A
page that is opened or loaded again gets all there is. The widgets' own JavaScript is what ipywidgets and
anywidget bring for the classic notebook, of which `page.js` plays the part.

A message is its JSON and its buffers: the number of parts and the length of each, four bytes each, and the
parts.
"""

from __future__ import annotations

import asyncio
import hmac
import json
import secrets
import socket
import struct
import sys
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import comm
import ipywidgets as w
import tornado.httpserver
import tornado.web
import tornado.websocket
from comm.base_comm import BaseComm

HERE = Path(__file__).parent
GRACE = 3.0  # s after the last page was left until all ends: one that is loaded again is back sooner
LEFT = 1000  # the code with which page.js closes the channel of a tab that is left
# s after the last page was lost, as when the browser puts a tab to sleep overnight, or dies.
LOST = 24 * 3600.0
PATIENCE = 2.0  # s that the widget has for its end
MOST = 1 << 28  # bytes of a message from the page: an upload
# Nothing but this machine: scripts that widgets bring are blobs, Rerun's viewer has a server of its own.
OWN = "'self' blob: data: http://127.0.0.1:* http://localhost:* ws://127.0.0.1:* ws://localhost:*"
POLICY = f"default-src {OWN} 'unsafe-inline' 'unsafe-eval'; frame-ancestors 'none'"
# The page's scripts: the package that brings each, and where it lies there.
FILES = {
    "page.js": ("endolab.tuning", "page.js"),
    "widgets.js": ("widgetsnbextension", "static/extension.js"),
    "anywidget.js": ("anywidget", "nbextension/index.js"),
}


def _file(name: str) -> Path:
    package, place = FILES[name]
    found = find_spec(package)
    if found is None or found.origin is None:
        raise FileNotFoundError(f"{package} is not installed")
    return Path(found.origin).parent / place


def packed(message: dict[str, Any], buffers: Sequence[Any] = ()) -> bytes:
    """Encode a message."""
    parts = [json.dumps(message, allow_nan=False, separators=(",", ":")).encode(), *map(bytes, buffers)]
    return b"".join([struct.pack(f"<{len(parts) + 1}I", len(parts), *map(len, parts)), *parts])


def unpacked(content: bytes) -> tuple[dict[str, Any], list[memoryview]]:
    """Decode a message; ValueError if it is none."""
    try:
        (count,) = struct.unpack_from("<I", content)
        lengths = struct.unpack_from(f"<{count}I", content, 4)
    except struct.error as error:
        raise ValueError("not a message") from error
    parts, start = [], 4 * (count + 1)
    for length in lengths:
        parts.append(memoryview(content)[start : start + length])
        start += length
    if start != len(content) or not parts:
        raise ValueError("not a message")
    message = json.loads(bytes(parts[0]))
    if not isinstance(message, dict):
        raise ValueError("not a message")
    return message, parts[1:]


class Page:
    """Serves one widget, which `make` makes in a thread of its own while the browser loads the page.

    `run` serves until the last page is left, and raises what `make` raised. `link` is the address to open.
    OSError in one sentence, if nobody may listen on `port`, which may be 0 for any.
    """

    def __init__(self, make: Callable[[], w.Widget], title: str, port: int = 0) -> None:
        self._make, self._title = make, title
        self.token = secrets.token_hex(24)
        try:
            self._socket = socket.create_server(("127.0.0.1", port))
        except OSError as error:
            raise OSError(f"cannot listen on port {port}: {error.strerror}") from error
        self.port = int(self._socket.getsockname()[1])
        self.link = f"http://127.0.0.1:{self.port}/?token={self.token}"
        self.widget: w.Widget | None = None
        self._making = threading.Thread(target=self._begin, name="endolab page", daemon=True)
        self.failure: BaseException | None = None
        self.busy = False  # at its end: a solve is still under way, which may take as long as a compiler does
        self._pages: set[_Channel] = set()
        self._ending: asyncio.TimerHandle | None = None
        self._parent = ""  # the message that is being answered ...
        self._asker: _Channel | None = None  # ... and whose it is

    def run(self, opened: Callable[[], object] = lambda: None) -> None:
        """Serve; `opened` is called when pages can be."""
        before = comm.create_comm
        try:
            asyncio.run(self._serve(opened))
        finally:
            comm.create_comm = before
            # A solve may not stop at once, as when it is being compiled.
            closing = threading.Thread(target=self._close, name="endolab end", daemon=True)
            closing.start()
            closing.join(PATIENCE)
            self.busy = closing.is_alive()
        if self.failure is not None:
            raise self.failure

    async def _serve(self, opened: Callable[[], object]) -> None:
        self._loop, self._ended, self._made = asyncio.get_running_loop(), asyncio.Event(), asyncio.Event()
        self._thread = threading.get_ident()
        files = [(f"/({'|'.join(FILES)})", _Script, {"page": self}), ("/channel", _Channel, {"page": self})]
        how: dict[str, Any] = {"log_function": lambda _: None, "websocket_max_message_size": MOST}
        app = tornado.web.Application([("/", _Whole, {"page": self}), *files], **how)
        server = tornado.httpserver.HTTPServer(app, max_body_size=1 << 16)
        self._socket.setblocking(False)
        server.add_socket(self._socket)
        self._take_over()
        self._making.start()
        opened()
        try:
            await self._ended.wait()
        finally:
            server.stop()
            for page in [*self._pages]:
                page.close(1001)
            with suppress(TimeoutError):  # whoever does not answer
                await asyncio.wait_for(server.close_all_connections(), PATIENCE)

    def _take_over(self) -> None:
        """Be what the widgets of this process talk to, as a kernel is in Jupyter."""
        page = self

        class Comm(BaseComm):
            def publish_msg(
                self, msg_type: str, data: Any = None, metadata: Any = None, buffers: Any = None, **keys: Any
            ) -> None:
                content = {"comm_id": self.comm_id, "data": data or {}, **keys}
                page.send(msg_type, content, metadata or {}, buffers or [])

        comm.create_comm = Comm
        w.register_comm_target()

    def _begin(self) -> None:
        """Make the widget, while pages wait for it."""
        try:
            self.widget = self._make()
        except BaseException as error:
            self.failure = error
        with suppress(RuntimeError):  # all has ended meanwhile
            self._loop.call_soon_threadsafe(self._made.set if self.failure is None else self._ended.set)

    def _close(self) -> None:
        """Close the widget, which may only just be made."""
        if self._making.is_alive():
            self._making.join()
        if self.widget is not None:
            self.widget.close()

    # Between widgets and pages -----------------------------------------------------------

    def send(
        self, kind: str, content: dict[str, Any], metadata: dict[str, Any], buffers: Sequence[Any]
    ) -> None:
        """Tell all pages something, from any thread; an answer that is for one page, that one."""
        answering = threading.get_ident() == self._thread
        message = {"type": kind, "content": content, "metadata": metadata}
        message["parent"] = self._parent if answering else ""
        alone = kind == "idle" or content["data"].get("method") == "update_states"
        pages = [self._asker] if answering and alone else None
        with suppress(RuntimeError):  # all has ended, and what is closed says so to nobody
            self._loop.call_soon_threadsafe(self._tell, packed(message, buffers), pages)

    def _tell(self, content: bytes, pages: list[Any] | None) -> None:
        for page in [*self._pages] if pages is None else pages:
            page.tell(content)

    def take(self, content: bytes, page: _Channel) -> None:
        """Do what a page says, and tell it when that is done."""
        message, buffers = unpacked(content)
        given = {"content": message["content"], "metadata": message["metadata"], "buffers": buffers}
        self._parent, self._asker = str(message["id"]), page
        try:
            if message["type"] in ("comm_open", "comm_msg", "comm_close"):
                getattr(comm.get_comm_manager(), message["type"])(None, None, given)
        finally:
            self.send("idle", {}, {}, [])
            self._parent, self._asker = "", None

    async def join(self, page: _Channel) -> None:
        """Add a page, as soon as there is something to show."""
        if self._ending is not None:
            self._ending.cancel()
        await self._made.wait()
        assert self.widget is not None
        if page.ws_connection is not None:  # it has not been left meanwhile
            page.tell(packed({"type": "ready", "content": {"model_id": self.widget.model_id}}))
            self._pages.add(page)

    def leave(self, page: _Channel) -> None:
        """Forget a page; the last one ends all."""
        self._pages.discard(page)
        if not self._pages:
            if self._ending is not None:
                self._ending.cancel()
            rest = GRACE if page.close_code == LEFT else LOST
            self._ending = self._loop.call_later(rest, self._ended.set)


class _Guarded(tornado.web.RequestHandler):
    """Answers who knows the token: from the link, or from the cookie that the link left."""

    def initialize(self, page: Page) -> None:
        self.page = page

    @property
    def cookie(self) -> str:
        return f"endolab-{self.page.port}"

    def prepare(self) -> None:
        if self.request.host not in (f"127.0.0.1:{self.page.port}", f"localhost:{self.page.port}"):
            raise tornado.web.HTTPError(403)
        known = self.get_query_argument("token", "") or self.get_cookie(self.cookie, "") or ""
        if not hmac.compare_digest(known.encode(), self.page.token.encode()):
            raise tornado.web.HTTPError(403)

    def set_default_headers(self) -> None:
        self.set_header("Content-Security-Policy", POLICY)
        self.set_header("X-Content-Type-Options", "nosniff")
        self.set_header("Referrer-Policy", "no-referrer")
        self.set_header("Cache-Control", "no-store")

    def write_error(self, status_code: int, **_: Any) -> None:
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        said = "Open the link that endolab printed." if status_code == 403 else f"{status_code}"
        self.finish(said)


class _Whole(_Guarded):
    """The page itself."""

    def get(self) -> None:
        self.set_cookie(self.cookie, self.page.token, httponly=True, samesite="Strict")
        html = (HERE / "page.html").read_text(encoding="utf-8")
        self.finish(html.replace("TITLE", tornado.escape.xhtml_escape(self.page._title)))


class _Script(_Guarded):
    """One of the page's scripts."""

    def get(self, name: str) -> None:
        self.set_header("Content-Type", "text/javascript; charset=utf-8")
        self.set_header("Cache-Control", "max-age=86400")
        self.finish(_file(name).read_bytes())


class _Channel(_Guarded, tornado.websocket.WebSocketHandler):
    """A page that is open."""

    async def open(self) -> None:
        await self.page.join(self)

    def tell(self, content: bytes) -> None:
        with suppress(tornado.websocket.WebSocketClosedError):  # at once, or once it was to be sent
            self.write_message(content, binary=True).add_done_callback(lambda sent: sent.exception())

    def on_message(self, message: str | bytes) -> None:
        try:
            self.page.take(message if isinstance(message, bytes) else message.encode(), self)
        except (ValueError, KeyError) as error:
            print(f"endolab: a page sent what cannot be read: {error}", file=sys.stderr)

    def on_close(self) -> None:
        self.page.leave(self)
