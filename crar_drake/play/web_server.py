"""The page of `crar-drake play`, what is live in it, and what it asks for, over HTTP.

    GET /             the page
    GET /meshcat.js   Meshcat's viewer, which the page connects to Meshcat itself
    GET /live?after=N the newest frame, as soon as there is one after number N
    POST /do          a request, see `requests`

A page asks for a frame when it has drawn the one before: a slow browser sees fewer of
them, never old ones.

It runs in threads of its own, that only hand things over: they never touch the
simulation or Meshcat.
"""

import json
import queue
import re
import socket
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from crar_drake.addresses import in_words, listen
from crar_drake.play.requests import LONGEST, Request, parse
from crar_drake.strict_json import MessageError

# Requests that wait for the simulation, and pages that wait for a frame, at most.
_MOST_WAITING, _MOST_PAGES = 256, 16
_PATIENCE = 5.0  # with a browser that does not read or write [s]
_LAST = 3.0  # for a page that is busy to ask for the last frame [s]
_LOCAL = ("127.0.0.1", "localhost", "::1")

_HEADERS = {
    "Cache-Control": "no-store",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
}


class PlayServer:
    """Serves one page and what is live in it.

    Attributes:
        requests: that came, in order.
        address: (host, port) that it listens at.
    """

    def __init__(self, host: str, port: int) -> None:
        """
        Args:
            host, port: see `listen`.

        Raises:
            CrarError: nothing can listen there.
        """
        self.requests: queue.Queue[Request] = queue.Queue(_MOST_WAITING)
        self._files: dict[str, tuple[str, bytes]] = {}
        self._frame, self._number = b"", 0
        self._changed = threading.Condition()
        self._closed, self._pages = False, 0
        self._asked, self._handed = -_PATIENCE, 0
        self._http = _Http(listen("HTTP", host, port), self)
        self.address: tuple[str, int] = self._http.server_address[:2]
        self._thread = threading.Thread(
            target=self._http.serve_forever, args=(0.05,), daemon=True
        )

    @property
    def url(self) -> str:
        """Where the page is."""
        host, port = self.address
        if host in ("0.0.0.0", "::"):
            host = "localhost"
        return f"http://{in_words(host, port)}/"

    def start(self, page: str, viewer: bytes) -> None:
        """Begins to serve."""
        self._files = {
            "/": ("text/html; charset=utf-8", page.encode()),
            "/meshcat.js": ("text/javascript; charset=utf-8", viewer),
        }
        self._thread.start()

    def show(self, frame: dict) -> None:
        """Hands the newest frame to all pages.

        Args:
            frame: for JSON, with finite numbers.
        """
        text = json.dumps(frame, allow_nan=False, separators=(",", ":"))
        with self._changed:
            self._frame, self._number = text.encode(), self._number + 1
            self._changed.notify_all()

    def close(self) -> None:
        """Lets the pages have the last frame, and gives the port free."""
        with self._changed:
            if time.monotonic() - self._asked < _PATIENCE:
                self._changed.wait_for(lambda: self._handed >= self._number, _LAST)
            self._closed = True
            self._changed.notify_all()
            self._changed.wait_for(lambda: not self._pages, timeout=1.0)
        if self._thread.is_alive():
            self._http.shutdown()
            self._thread.join()
        self._http.server_close()

    # --- in the threads ------------------------------------------------------------

    def _next_frame(self, number: int) -> bytes:
        """The newest frame after that of a number and its own; without one if none
        comes for some time."""
        with self._changed:
            self._asked = time.monotonic()
            self._changed.wait_for(
                lambda: self._number > number or self._closed, timeout=_PATIENCE
            )
            frame = self._frame if self._number > number else b"null"
            return b'{"number":%d,"frame":%s}' % (self._number, frame)

    def _enter(self) -> bool:
        """Counts a page that looks on, if there is room for it."""
        with self._changed:
            if self._pages >= _MOST_PAGES:
                return False
            self._pages += 1
            return True

    def _leave(self, handed: int) -> None:
        with self._changed:
            self._pages -= 1
            self._handed = max(self._handed, handed)
            self._changed.notify_all()


class _Http(ThreadingHTTPServer):
    daemon_threads = True

    def __init__(self, opened: socket.socket, play: PlayServer) -> None:
        # Its own binding looks the computer's name up, which can take long.
        super().__init__(opened.getsockname(), _Handler, bind_and_activate=False)
        self.socket.close()
        self.socket, self.play = opened, play

    def handle_error(self, request: object, client_address: object) -> None:
        """A browser that goes away in the middle is no error."""


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    timeout = _PATIENCE
    server: _Http

    def do_GET(self) -> None:
        if not self._is_for_us():
            return
        if self.path in self.server.play._files:
            self._answer(200, *self.server.play._files[self.path])
        elif (asked := re.fullmatch(r"/live\?after=(\d{1,15})", self.path)) is not None:
            self._hand_frame(int(asked[1]))
        elif self.path == "/favicon.ico":
            self._answer(204, "image/x-icon", b"")
        else:
            self._answer(404, "text/plain", b"there is only /\n")

    def do_POST(self) -> None:
        if not self._is_for_us():
            return
        kind = self.headers.get("Content-Type", "").partition(";")[0].strip()
        length = self.headers.get("Content-Length", "")
        if self.path != "/do":
            self._refuse(404, "there is only /do")
        elif kind != "application/json":
            # Another site's page could send a form, but not this without being asked.
            self._refuse(415, "a request is application/json")
        elif not length.isdecimal() or int(length) > LONGEST:
            self._refuse(413, f"a request has at most {LONGEST} bytes")
        else:
            self._take(self.rfile.read(int(length)))

    def log_message(self, *_: object) -> None:
        """Nothing is printed for every request."""

    def _take(self, body: bytes) -> None:
        try:
            self.server.play.requests.put_nowait(parse(body))
        except MessageError as error:
            self._refuse(400, str(error))
        except queue.Full:
            self._refuse(503, "too many requests at a time")
        else:
            self._answer(204, "text/plain", b"")

    def _hand_frame(self, after: int) -> None:
        play = self.server.play
        if not play._enter():
            self._refuse(503, f"{_MOST_PAGES} pages are open already")
            return
        handed = 0
        try:
            body = play._next_frame(after)
            self._answer(200, "application/json", body)
            self.wfile.flush()
            handed = json.loads(body)["number"]
        finally:
            play._leave(handed)

    def _is_for_us(self) -> bool:
        """Whether the browser shows our page: other sites' may not reach in.

        A name that another site has pointed at this computer is not among ours, and the
        origin of another site's page is not the host.
        """
        host = self.headers.get("Host", "")
        name = host.rpartition(":")[0].strip("[]")
        ours, _ = self.server.play.address
        origin = self.headers.get("Origin")
        if ours in _LOCAL and name not in _LOCAL:
            self._refuse(403, "another host")
        elif origin is not None and origin.partition("://")[2] != host:
            self._refuse(403, "another origin")
        else:
            return True
        return False

    def _refuse(self, status: int, why: str) -> None:
        self.close_connection = True  # what it still sends is not read
        self._answer(status, "text/plain; charset=utf-8", why.encode())

    def _answer(self, status: int, kind: str, body: bytes) -> None:
        self.send_response(status)
        for name, value in {"Content-Type": kind, **_HEADERS}.items():
            self.send_header(name, value)
        if status != 204:
            self.send_header("Content-Length", str(len(body)))
        if self.close_connection:
            self.send_header("Connection", "close")
        self.end_headers()
        self.wfile.write(body)
