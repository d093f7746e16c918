"""A headless Chromium that opens a page, through its debugging pipe.

Nothing of the product is known here. The protocol:
https://chromedevtools.github.io/devtools-protocol
"""

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

NAMES = ("chromium", "chromium-browser", "google-chrome")
PATIENCE = 300.0  # for what takes seconds on a computer that does nothing else [s]


def find_browser() -> str | None:
    """The command of a Chromium; None if there is none."""
    return next(filter(None, map(shutil.which, NAMES)), None)


class Browser:
    """One page in a browser of its own; a context manager.

    Attributes:
        complaints: errors and warnings of the page, also of its console.
        requests: addresses that it asked for, but for files and what is in the page.
    """

    def __init__(self, width: int, height: int) -> None:
        """Begins it, with a page of so many pixels."""
        self.complaints: list[str] = []
        self.requests: list[str] = []
        self._count, self._buffer, self._session = 0, b"", ""
        self._profile = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        theirs, self._out = os.pipe()
        self._in, answers = os.pipe()
        command = [
            *(find_browser(), "--headless", "--no-sandbox", "--no-first-run"),
            *("--use-gl=angle", "--use-angle=swiftshader"),
            *("--enable-unsafe-swiftshader", "--remote-debugging-pipe"),
            f"--window-size={width},{height}",
            *(f"--user-data-dir={self._profile.name}", "about:blank"),
        ]
        # It reads from descriptor 3 and writes to 4; neither may be in the other's way.
        moved = [fcntl.fcntl(fd, fcntl.F_DUPFD, 10) for fd in (theirs, answers)]
        silent = [(os.POSIX_SPAWN_OPEN, fd, os.devnull, os.O_RDWR, 0) for fd in (1, 2)]
        pipes = [(os.POSIX_SPAWN_DUP2, fd, 3 + i) for i, fd in enumerate(moved)]
        actions = [*silent, *pipes]
        self._process = os.posix_spawn(
            command[0], command, os.environ, file_actions=actions
        )
        for descriptor in (theirs, answers, *moved):
            os.close(descriptor)

    def __enter__(self) -> "Browser":
        targets = self.send("Target.getTargets")["targetInfos"]
        page = next(each["targetId"] for each in targets if each["type"] == "page")
        attached = self.send("Target.attachToTarget", targetId=page, flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Runtime", "Log", "Network", "Page"):
            self.send(f"{domain}.enable")
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._out)
        os.close(self._in)
        os.kill(self._process, signal.SIGKILL)
        os.waitpid(self._process, 0)
        self._profile.cleanup()

    def send(self, method: str, **parameters: object) -> dict:
        """A command of the protocol and its answer."""
        self._count += 1
        message = {"id": self._count, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._out, json.dumps(message).encode() + b"\0")
        while (answer := self._receive(method)).get("id") != self._count:
            self._note(answer)
        assert "error" not in answer, f"{method}: {answer}"
        return answer["result"]

    def open(self, page: Path) -> None:
        """Opens a file."""
        self.send("Page.navigate", url=page.resolve().as_uri())

    def value(self, expression: str) -> object:
        """Of a JavaScript expression, awaited if it is a promise."""
        answer = self.send(
            "Runtime.evaluate",
            expression=expression,
            awaitPromise=True,
            returnByValue=True,
        )
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def wait_for(self, condition: str) -> None:
        """Waits until a JavaScript expression holds."""
        deadline = time.monotonic() + PATIENCE
        while not self.value(f"Boolean({condition})"):
            assert time.monotonic() < deadline, (condition, self.complaints)
            time.sleep(0.05)

    def picture(self) -> bytes:
        """The page as PNG, once what has changed is drawn."""
        self.value(
            "new Promise(done => requestAnimationFrame(() => "
            "requestAnimationFrame(() => done(true))))"
        )
        shot = self.send("Page.captureScreenshot", format="png")
        return base64.b64decode(shot["data"])

    def _receive(self, method: str) -> dict:
        deadline = time.monotonic() + PATIENCE
        while b"\0" not in self._buffer:
            left = max(0.0, deadline - time.monotonic())
            ready = select.select([self._in], [], [], left)[0]
            part = os.read(self._in, 1 << 20) if ready else b""
            assert part, f"{method}: the browser ended, or does not answer"
            self._buffer += part
        message, _, self._buffer = self._buffer.partition(b"\0")
        return json.loads(message)

    def _note(self, event: dict) -> None:
        """Keeps what tells of a defect of the page."""
        told = event.get("params", {})
        match event.get("method"):
            case "Runtime.exceptionThrown":
                self.complaints.append(str(told["exceptionDetails"]))
            case "Runtime.consoleAPICalled" if told["type"] in ("warning", "error"):
                self.complaints.append(str(told["args"]))
            case "Log.entryAdded" if told["entry"]["level"] in ("warning", "error"):
                self.complaints.append(told["entry"]["text"])
            case "Network.requestWillBeSent":
                url = told["request"]["url"]
                if not url.startswith(("data:", "blob:", "file:", "about:")):
                    self.requests.append(url)
