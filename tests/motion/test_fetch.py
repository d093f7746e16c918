"""Fetching trials from a loopback server that misbehaves in the usual ways."""

import hashlib
import io
import re
import socket
import threading
import time
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
from rich.console import Console
from short_motions import ONE_BONE

from crar_drake.errors import MotionError
from crar_drake.motion.catalogue import KnownTrial, known_trials, trial_files
from crar_drake.motion.fetch import LICENCE_NOTICE, fetch, rich_progress
from crar_drake.motion.formats.asf_amc import read_amc, read_asf

ASF = ONE_BONE.encode()


def amc_text(frames: int, angle: float) -> bytes:
    lines = [":FULLY-SPECIFIED", ":DEGREES"]
    for frame in range(1, frames + 1):
        lines += [f"{frame}", "root 0 18 0 0 0 0", f"spine {angle * frame:08.4f}"]
    return "\n".join([*lines, ""]).encode()


AMC = amc_text(frames=40, angle=0.5)
OTHER_AMC = amc_text(frames=40, angle=0.7)
ASF_URL = "/subjects/05/05.asf"
AMC_URL = "/subjects/05/05_02.amc"


def sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


KNOWN = {"05_02": KnownTrial(40, sha256(AMC), sha256(ASF))}


@dataclass
class Site:
    """A server's files, and how it treats the requests for the motion file.

    `script` holds one word per request for an .amc, the last one for all others:
    "good", "half" (cuts off half way through what it sends), "reset", "quiet half"
    (the same without a Content-Length), or a status such as "500".
    """

    files: dict[str, bytes] = field(
        default_factory=lambda: {ASF_URL: ASF, AMC_URL: AMC}
    )
    script: list[str] = field(default_factory=lambda: ["good"])
    delay: float = 0.0  # before each answer [s]
    requests: list[str] = field(default_factory=list)
    url: str = ""

    def motion_requests(self) -> list[str]:
        """Each request for the motion."""
        return [request for request in self.requests if request == AMC_URL]


class Handler(BaseHTTPRequestHandler):
    server: "Server"

    def log_message(self, *args) -> None:
        pass

    def do_GET(self) -> None:
        site = self.server.site
        site.requests.append(self.path)
        time.sleep(site.delay)
        word = "good"
        if self.path.endswith(".amc"):
            count = len(site.motion_requests())
            word = site.script[min(count, len(site.script)) - 1]
        if word == "reset":
            self.connection.shutdown(socket.SHUT_RDWR)
            return
        if word.isdecimal():
            self.send_error(int(word))
            return
        if self.path not in site.files:
            self.send_error(404)
            return
        self.send_response(200)
        body = site.files[self.path]
        if not word.startswith("quiet"):
            self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body[: len(body) // 2] if word.endswith("half") else body)


class Server(ThreadingHTTPServer):
    site: Site


@pytest.fixture
def site(monkeypatch):
    monkeypatch.setenv("no_proxy", "127.0.0.1,localhost")
    server = Server(("127.0.0.1", 0), Handler)
    server.site = Site(url=f"http://127.0.0.1:{server.server_port}")
    thread = threading.Thread(target=server.serve_forever, args=(0.01,))
    thread.start()
    yield server.site
    server.shutdown()
    thread.join()
    server.server_close()


class Fetcher:
    """Calls fetch on the site and notes the pauses that it would make."""

    def __init__(self, site: Site, cache: Path) -> None:
        self.site = site
        self.cache = cache
        self.pauses: list[float] = []
        self.files = trial_files(cache, "05_02")

    def __call__(self, trial: str = "05_02", known=KNOWN, **options):
        return fetch(
            trial,
            self.cache,
            self.site.url,
            known=known,
            sleep=self.pauses.append,
            **options,
        )

    def refused(self, trial: str = "05_02", known=KNOWN, **options) -> str:
        """Returns the error's text, and asserts that no motion has appeared."""
        with pytest.raises(MotionError) as caught:
            self(trial, known, **options)
        assert list(self.cache.rglob("*.amc")) == []
        for asf in self.cache.rglob("*.asf"):
            assert asf.read_bytes() == ASF
        return str(caught.value)

    def assert_right(self, amc: bytes = AMC) -> None:
        """The cache holds both files, and no trace of how they came."""
        assert self.files.asf.read_bytes() == ASF
        assert self.files.amc.read_bytes() == amc
        names = {path.name for path in self.cache.rglob("*") if path.is_file()}
        assert names == {"05.asf", "05_02.amc", ".lock"}


@pytest.fixture
def fetcher(site, tmp_path) -> Fetcher:
    return Fetcher(site, tmp_path / "cache")


# --- what works -------------------------------------------------------------------


@pytest.mark.parametrize("known", [KNOWN, {}], ids=["checksum", "parsed"])
def test_good(fetcher, site, known):
    seen = []
    files = fetcher("cmu:05_02", known, progress=lambda *args: seen.append(args))
    assert files == fetcher.files
    fetcher.assert_right()
    assert site.requests == [ASF_URL, AMC_URL]
    assert fetcher.pauses == []
    assert seen[0] == ("05.asf", 0, len(ASF))
    assert seen[-1] == ("05_02.amc", len(AMC), len(AMC))


@pytest.mark.parametrize("known", [KNOWN, {}], ids=["checksum", "parsed"])
def test_what_is_there_and_right_is_not_fetched_again(fetcher, site, known):
    fetcher(known=known)
    site.requests.clear()
    fetcher(known=known)
    assert site.requests == []
    fetcher(known=known, force=True)
    assert site.requests == [ASF_URL, AMC_URL]
    fetcher.assert_right()


@pytest.mark.parametrize("known", [KNOWN, {}], ids=["checksum", "parsed"])
def test_what_is_there_but_damaged_is_fetched_again(fetcher, site, known):
    fetcher(known=known)
    site.requests.clear()
    fetcher.files.amc.write_bytes(AMC[:-12])
    fetcher(known=known)
    assert site.requests == [AMC_URL]
    fetcher.assert_right()


@pytest.mark.parametrize("trouble", ["500", "503", "429", "reset", "half"])
def test_passing_trouble(fetcher, site, trouble):
    site.script = [trouble, "good"]
    fetcher()
    fetcher.assert_right()
    assert len(fetcher.pauses) == 1


# --- what is refused --------------------------------------------------------------


def test_cut_off_always(fetcher, site):
    site.script = ["half"]
    message = fetcher.refused()
    assert re.search(rf"cut off at \d+ of {len(AMC)} bytes; gave up after 5", message)
    assert "later" in message
    # Each pause is longer than the one before, and none is without end.
    assert fetcher.pauses == sorted(set(fetcher.pauses)) and len(fetcher.pauses) == 4
    assert sum(fetcher.pauses) < 10.0


def test_wrong_checksum(fetcher, site):
    site.files[AMC_URL] = OTHER_AMC
    message = fetcher.refused()
    assert sha256(AMC) in message and sha256(OTHER_AMC) in message
    assert AMC_URL in message
    assert {path.name for path in fetcher.files.amc.parent.iterdir()} == {"05.asf"}
    assert len(site.motion_requests()) == 1


def test_wrong_checksum_of_a_skeleton_that_another_trial_tells(fetcher, site):
    site.files[ASF_URL] = ASF.replace(b"length 9", b"length 8")
    site.files["/subjects/05/05_03.amc"] = AMC
    with pytest.raises(MotionError, match=sha256(ASF)):
        fetcher("05_03")
    assert not list(fetcher.cache.rglob("*.asf"))


@pytest.mark.parametrize("url", [ASF_URL, AMC_URL])
def test_unknown_checksum_still_has_to_parse(fetcher, site, url):
    site.files[url] = b"<html>Please log in to this network</html>\n"
    message = fetcher.refused(known={})
    assert url in message and "not a readable file" in message
    assert list(fetcher.cache.rglob("*.part*")) == []


def test_truncated_file_without_a_stated_length(fetcher, site):
    site.script = ["quiet half"]
    assert "does not say how long" in fetcher.refused(known={})
    assert "wrong checksum" in fetcher.refused(known=KNOWN)


@pytest.mark.parametrize("trial", ["05_99", "999_01"])
def test_no_such_trial(fetcher, site, trial):
    message = fetcher.refused(trial)
    assert f"the database has no trial {trial}" in message
    assert fetcher.pauses == []


def test_forbidden_is_not_tried_again(fetcher, site):
    site.script = ["403"]
    message = fetcher.refused()
    assert "403" in message and "CRAR_MOCAP_PATH" in message
    assert len(site.motion_requests()) == 1


def test_malformed_trial_asks_nothing(fetcher, site):
    assert "such as 05_02" in fetcher.refused("../../x")
    assert site.requests == []


def test_unreachable_host(fetcher, site):
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        site.url = f"http://127.0.0.1:{unused.getsockname()[1]}"
        message = fetcher.refused()
    assert f"cannot reach {site.url.removeprefix('http://')}" in message
    assert "CRAR_MOCAP_PATH" in message


def test_cache_that_cannot_be_written(fetcher):
    fetcher.cache.write_text("a file where the folder should be")
    with pytest.raises(MotionError, match="cannot keep trial 05_02 in"):
        fetcher()


def test_who_shows_the_progress_may_fail_and_the_server_is_not_asked_again(
    fetcher, site
):
    def closed(file: str, done: int, total: int | None) -> None:
        raise BrokenPipeError(32, "Broken pipe")

    assert "Broken pipe" in fetcher.refused(progress=closed)
    assert site.requests == [ASF_URL] and fetcher.pauses == []


def test_failed_refetch_leaves_the_good_files(fetcher, site):
    fetcher()
    for script in (["half"], ["500"], ["404"]):
        site.script = script
        with pytest.raises(MotionError):
            fetcher(force=True)
        assert fetcher.files.amc.read_bytes() == AMC


# --- the rest ---------------------------------------------------------------------


def test_several_at_once(fetcher, site):
    site.delay = 0.03
    site.script = ["half", "good"]
    errors = []
    together = threading.Barrier(4)

    def work() -> None:
        together.wait()
        try:
            fetcher()
        except BaseException as error:
            errors.append(error)

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert errors == []
    fetcher.assert_right()
    # The others found the first one's files.
    assert site.requests == [ASF_URL, AMC_URL, AMC_URL]


def test_progress_bars_name_the_files(fetcher):
    screen = io.StringIO()
    with rich_progress(Console(file=screen, force_terminal=True, width=80)) as progress:
        fetcher(progress=progress)
    assert "05.asf" in screen.getvalue() and "05_02.amc" in screen.getvalue()
    assert "100%" in screen.getvalue() or f"{len(AMC) / 1000:.1f}" in screen.getvalue()


def test_licence_notice():
    assert (
        "The data used in this project was obtained from mocap.cs.cmu.edu. The "
        "database was created with funding from NSF EIA-0196217." in LICENCE_NOTICE
    )
    assert "resold" in LICENCE_NOTICE


def test_real_trial_with_its_checksum(cmu, fetcher, site):
    for url in ("/subjects/02/02.asf", "/subjects/02/02_01.amc"):
        site.files[url] = (cmu / url[1:]).read_bytes()
    files = fetcher("02_01", known=None)
    assert files.amc.read_bytes() == site.files["/subjects/02/02_01.amc"]
    clip = read_amc(files.amc, read_asf(files.asf))
    assert clip.num_frames == known_trials()["02_01"].frames
    site.files["/subjects/02/02_01.amc"] += b"\n"  # parses all the same
    with pytest.raises(MotionError, match="wrong checksum"):
        fetcher("02_01", known=None, force=True)


def test_known_trials_are_the_real_files(cmu):
    assert len(known_trials()) >= 19
    for trial, facts in known_trials().items():
        files = trial_files(cmu, trial)
        assert sha256(files.amc.read_bytes()) == facts.amc_sha256
        assert sha256(files.asf.read_bytes()) == facts.asf_sha256
