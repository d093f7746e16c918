"""A headless Chromium that is told what to do, through its debugging pipe.

It looks at recorded pages for the pictures of the documentation, and for tests, with
real keys and a real mouse. Nothing but Chromium itself is needed.

The protocol: https://chromedevtools.github.io/devtools-protocol
"""

from __future__ import annotations

import base64
import fcntl
import json
import os
import select
import shutil
import signal
import tempfile
import time
from pathlib import Path

_NAMES = ("chromium", "chromium-browser", "google-chrome")
_PATIENCE = 180.0  # for one answer of the browser, on a busy computer [s]


def find_browser() -> str | None:
    """The command of a Chromium; None if there is none."""
    return next(filter(None, map(shutil.which, _NAMES)), None)


class HeadlessBrowser:
    """One page in a browser of its own; a context manager.

    Attributes:
        complaints: what the page threw, and wrote to the console as warning or error.
        requests: addresses that were asked for, but for files and data in the page.
    """

    def __init__(self, width: int, height: int, *, scale: float = 1.0) -> None:
        """
        Args:
            width, height: of the page [CSS pixels].
            scale: pixels of the picture per CSS pixel.

        Raises:
            RuntimeError: there is no Chromium.
        """
        browser = find_browser()
        if browser is None:
            raise RuntimeError("there is no Chromium here: install chromium")
        self.complaints: list[str] = []
        self.requests: list[str] = []
        self._count, self._buffer = 0, b""
        self._profile = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        to_browser, self._out = os.pipe()
        self._in, from_browser = os.pipe()
        command = [
            *(browser, "--headless", "--no-sandbox", "--hide-scrollbars"),
            *("--disable-background-networking", "--no-first-run"),
            *("--use-gl=angle", "--use-angle=swiftshader"),
            *("--enable-unsafe-swiftshader", "--remote-debugging-pipe"),
            f"--user-data-dir={self._profile.name}",
            "about:blank",
        ]
        # The browser reads from descriptor 3 and writes to 4. First out of the way,
        # so that neither is overwritten by the other.
        ours = [fcntl.fcntl(fd, fcntl.F_DUPFD, 10) for fd in (to_browser, from_browser)]
        silent = (os.POSIX_SPAWN_OPEN, os.devnull, os.O_RDWR, 0)
        self._process = os.posix_spawn(
            browser,
            command,
            os.environ,
            file_actions=[
                *((kind, fd, *rest) for kind, *rest in [silent] for fd in (1, 2)),
                *((os.POSIX_SPAWN_DUP2, fd, 3 + i) for i, fd in enumerate(ours)),
            ],
        )
        for descriptor in (to_browser, from_browser, *ours):
            os.close(descriptor)
        self._session = ""
        try:
            targets = self.send("Target.getTargets")["targetInfos"]
            page = next(t["targetId"] for t in targets if t["type"] == "page")
            attached = self.send("Target.attachToTarget", targetId=page, flatten=True)
            self._session = attached["sessionId"]
            for domain in ("Runtime", "Log", "Network", "Page"):
                self.send(f"{domain}.enable")
            self.resize(width, height, scale)
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> HeadlessBrowser:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Ends the browser."""
        for descriptor in (self._out, self._in):
            os.close(descriptor)
        deadline = time.monotonic() + 10.0  # it goes when its pipe does
        while os.waitpid(self._process, os.WNOHANG)[0] == 0:
            if time.monotonic() > deadline:
                os.kill(self._process, signal.SIGKILL)
            time.sleep(0.02)
        self._profile.cleanup()

    def send(self, method: str, **parameters: object) -> dict:
        """A command of the protocol and its answer.

        Raises:
            RuntimeError: the browser refuses, ends, or says nothing for three minutes.
        """
        self._count += 1
        message = {"id": self._count, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._out, json.dumps(message).encode() + b"\0")
        deadline = time.monotonic() + _PATIENCE
        while True:
            answer = self._receive(deadline, method)
            if answer.get("id") != self._count:
                self._note(answer)
            elif "error" in answer:
                raise RuntimeError(f"{method}: {answer['error']['message']}")
            else:
                return answer["result"]

    def resize(self, width: int, height: int, scale: float = 1.0) -> None:
        """As the constructor's arguments; below 600 pixels it is a phone."""
        self.send(
            "Emulation.setDeviceMetricsOverride",
            **{"width": width, "height": height, "deviceScaleFactor": scale},
            mobile=width < 600,
        )

    def open(self, page: Path, fragment: str = "") -> None:
        """Opens a file and waits until a recorded page has drawn its first frame."""
        address = page.resolve().as_uri() + fragment
        # Else another fragment of the same file would not load it again.
        self.send("Page.navigate", url="about:blank")
        self.send("Page.navigate", url=address)
        self.wait_for("document.readyState === 'complete' && window.crar")
        self.settle()

    def wait_for(self, condition: str) -> None:
        """Waits until a JavaScript expression holds.

        Raises:
            RuntimeError: it does not within three minutes.
        """
        deadline = time.monotonic() + _PATIENCE
        while not self._holds(condition):
            if time.monotonic() > deadline:
                raise RuntimeError(f"{condition}: not so; {self.complaints}")
            time.sleep(0.05)

    def _holds(self, condition: str) -> bool:
        try:
            return bool(self.evaluate(f"Boolean({condition})"))
        except RuntimeError as error:
            # The page that was asked has just given way to the one that was opened.
            if "target navigated" not in str(error):
                raise
            return False

    def settle(self) -> None:
        """Waits until what has changed is drawn."""
        self.evaluate(
            "new Promise(done => requestAnimationFrame(() => "
            "requestAnimationFrame(() => done(true))))"
        )

    def evaluate(self, expression: str) -> object:
        """The value of a JavaScript expression, awaited if it is a promise.

        Raises:
            RuntimeError: it throws.
        """
        answer = self.send(
            "Runtime.evaluate",
            expression=expression,
            awaitPromise=True,
            returnByValue=True,
        )
        if "exceptionDetails" in answer:
            details = answer["exceptionDetails"]
            raise RuntimeError(details.get("exception", details).get("description"))
        return answer["result"].get("value")

    def press(self, code: str, key: str = "", *, shift: bool = False) -> None:
        """Presses a key and lets it go; `code` as in KeyboardEvent.code."""
        common = {"code": code, "key": key or code, "modifiers": 8 if shift else 0}
        self.send("Input.dispatchKeyEvent", type="keyDown", **common)
        self.send("Input.dispatchKeyEvent", type="keyUp", **common)

    def drag(self, path: list[tuple[float, float]]) -> None:
        """Presses the left button at the first point, lets it go at the last one."""
        for i, (x, y) in enumerate(path):
            kind = "mousePressed" if i == 0 else "mouseMoved"
            self._mouse(kind, x, y)
        self._mouse("mouseReleased", *path[-1])

    def _mouse(self, kind: str, x: float, y: float) -> None:
        self.send(
            "Input.dispatchMouseEvent",
            **{"type": kind, "x": x, "y": y, "button": "left", "buttons": 1},
            clickCount=1,
        )

    def screenshot(self) -> bytes:
        """The page as PNG."""
        return base64.b64decode(
            self.send("Page.captureScreenshot", format="png")["data"]
        )

    def _receive(self, deadline: float, method: str) -> dict:
        while b"\0" not in self._buffer:
            left = deadline - time.monotonic()
            ready = left > 0.0 and select.select([self._in], [], [], left)[0]
            part = os.read(self._in, 1 << 20) if ready else b""
            if not part:
                why = "ended" if ready else "does not answer"
                raise RuntimeError(f"{method}: the browser {why}")
            self._buffer += part
        message, _, self._buffer = self._buffer.partition(b"\0")
        return json.loads(message)

    def _note(self, event: dict) -> None:
        """Keeps what tells of a defect of the page."""
        method, said = event.get("method"), event.get("params", {})
        if method == "Runtime.exceptionThrown":
            details = said["exceptionDetails"]
            text = details.get("exception", {}).get("description") or details["text"]
            self.complaints.append(text)
        elif method == "Runtime.consoleAPICalled":
            if said["type"] in ("warning", "error", "assert"):
                values = [
                    str(a.get("value", a.get("description"))) for a in said["args"]
                ]
                self.complaints.append(" ".join(values))
        elif method == "Log.entryAdded":
            if said["entry"]["level"] in ("warning", "error"):
                self.complaints.append(said["entry"]["text"])
        elif method == "Network.requestWillBeSent":
            url = said["request"]["url"]
            if not url.startswith(("data:", "blob:", "file:", "about:")):
                self.requests.append(url)
