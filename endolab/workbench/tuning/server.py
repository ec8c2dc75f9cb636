"""A widget in a page of its own, in this process: no notebook, no kernel, no network.

`Page` takes the place of Jupyter: what the widget says goes to the pages that are open, what is done there
comes back, over a WebSocket on this machine alone, to whoever knows the address. A page that is opened or
loaded again gets all there is. `page.js` is its other end.
"""

from __future__ import annotations

import asyncio
import json
import re
import secrets
import socket
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import tornado.httpserver
import tornado.web
import tornado.websocket
from anywidget import AnyWidget

from endolab.io.atomic import one_sentence
from endolab.workbench.tuning.script import page_script

# s, after the last page was left, until all ends: one that is loaded again is back sooner.
AFTER_LEAVING = 3.0
HERE = Path(__file__)
# Nothing but this machine, and a proxy's channel; scripts that widgets bring are blobs.
CONTENT_POLICY = (
    "default-src 'self' blob: data: ws://127.0.0.1:* ws://localhost:* %s 'unsafe-inline'; "
    "frame-ancestors 'none'"
)


class Page:
    """Serves one widget, which `make` makes while the browser starts.

    `run` serves until the last page is left, and raises what `make` raised. `link` is the address to open.
    `origin`, such as ``https://lab.example.org``, is that of a proxy through which pages may come, too.
    OSError in one sentence, if nobody may listen on `port`, which may be 0 for any.
    """

    def __init__(
        self,
        make: Callable[[], AnyWidget],
        title: str,
        port: int = 0,
        origin: str | None = None,
    ) -> None:
        self._make = make
        self.title = title
        if origin is not None and not re.fullmatch(r"https?://[\w.:[\]-]+/?", origin):
            raise ValueError(f"an origin is like https://lab.example.org, got {origin!r}")
        self.origin = origin and origin.lower().rstrip("/")
        with one_sentence(f"cannot listen on port {port}"):
            self._socket = socket.create_server(("127.0.0.1", port))
        self._place = f"/{secrets.token_hex(24)}/"  # which nobody can guess
        self.link = f"http://127.0.0.1:{self._socket.getsockname()[1]}{self._place}"
        self.widget: AnyWidget
        self._loop = asyncio.new_event_loop()
        self._ended = asyncio.Event()
        self._pages: set[_Channel] = set()
        self._ending: asyncio.TimerHandle | None = None

    def run(self, on_open: Callable[[], object] = lambda: None) -> None:
        """Serve; `on_open` is called when pages can be opened."""
        try:
            on_open()
            self.widget = self._make()
            self.widget.send = self.send
            self._loop.run_until_complete(self._serve())
        finally:
            self._loop.close()
            self._socket.close()
            if hasattr(self, "widget"):  # it could be made
                self.widget.close()  # what it still does, such as an export, comes to its end

    async def _serve(self) -> None:
        places = [
            (self._place, _Whole, {"page": self}),
            (self._place + "channel", _Channel, {"page": self}),
        ]
        app = tornado.web.Application(places, log_function=lambda _: None)
        server = tornado.httpserver.HTTPServer(app)
        self._socket.setblocking(False)
        server.add_socket(self._socket)
        await self._ended.wait()
        server.stop()

    # Between widget and pages ------------------------------------------------------------

    def send(self, content: Any, buffers: Sequence[bytes] = ()) -> None:
        """Tell all pages, from any thread."""
        head = json.dumps({"content": content, "buffers": len(buffers)})
        with suppress(RuntimeError):  # all has ended, and what is closed says so to nobody
            self._loop.call_soon_threadsafe(self._tell, head, *buffers)

    def _tell(self, *parts: str | bytes) -> None:
        for page in self._pages:
            page.tell(*parts)

    def take(self, content: Any) -> None:
        """Do what a page says."""
        data = {"method": "custom", "content": content}
        self.widget.comm.handle_msg({"content": {"data": data}, "buffers": []})

    def join(self, page: _Channel) -> None:
        """Add a page, and give it the widget."""
        if self._ending is not None:
            self._ending.cancel()
        self._pages.add(page)
        state = {"facts": self.widget.get_state()["facts"]}
        page.tell(json.dumps({"state": state, "buffers": 0}))

    def leave(self, page: _Channel) -> None:
        """Forget a page; the last one ends all."""
        self._pages.discard(page)
        # With this code page.js closes a channel; a tab that dies or is put to sleep may come back.
        if page.close_code == 1000 and not self._pages:
            self._ending = self._loop.call_later(AFTER_LEAVING, self._ended.set)


class _Whole(tornado.web.RequestHandler):
    """The page itself."""

    def initialize(self, page: Page) -> None:
        self.page = page

    def get(self) -> None:
        style = HERE.with_name("tuner.css").read_text(encoding="utf-8")
        channel = (self.page.origin or "").replace("http", "ws", 1)
        self.set_header("Content-Security-Policy", CONTENT_POLICY % channel)
        self.set_header("Cache-Control", "no-store")
        page = str(HERE.with_name("page.html"))
        script = page_script("page")
        self.render(page, title=self.page.title, style=style, script=script)


class _Channel(tornado.websocket.WebSocketHandler):
    """A page that is open."""

    def initialize(self, page: Page) -> None:
        self.page = page

    def check_origin(self, origin: str) -> bool:
        """Whether a page of that origin may open the channel: one that came from here, or by the proxy."""
        return origin.lower() == self.page.origin or super().check_origin(origin)

    def open(self) -> None:
        self.page.join(self)

    def tell(self, *parts: str | bytes) -> None:
        for part in parts:
            # At once, or once it was to be sent.
            with suppress(tornado.websocket.WebSocketClosedError):
                sent = self.write_message(part, binary=isinstance(part, bytes))
                sent.add_done_callback(lambda sent: sent.exception())

    def on_message(self, message: str | bytes) -> None:
        try:
            self.page.take(json.loads(message))
        # The page lives on, and what it sent, with its address, is nobody's.
        except Exception as error:
            sentence = f"endolab: a page sent what cannot be read: {type(error).__name__}"
            print(sentence, file=sys.stderr)

    def on_close(self) -> None:
        self.page.leave(self)
