"""The server of the page, over the real socket."""

import http.client
import json
import threading
from collections.abc import Iterator

import pytest

from crar_drake.errors import CrarError
from crar_drake.play.web_server import PlayServer

JSON = {"Content-Type": "application/json"}


@pytest.fixture
def server() -> Iterator[PlayServer]:
    server = PlayServer("127.0.0.1", 0)
    server.start("<p>ö</p>", b"viewer()")
    yield server
    server.close()


def ask(server: PlayServer, method: str, path: str, body=None, **headers):
    connection = http.client.HTTPConnection(*server.address, timeout=10)
    connection.request(method, path, body, headers)
    answer = connection.getresponse()
    return answer.status, answer.read().decode()


def do(server: PlayServer, body: object, **headers) -> tuple[int, str]:
    text = json.dumps(body)
    return ask(server, "POST", "/do", text, **(JSON | headers))


def test_it_has_the_page_and_its_viewer(server):
    assert ask(server, "GET", "/") == (200, "<p>ö</p>")
    assert ask(server, "GET", "/meshcat.js") == (200, "viewer()")
    assert ask(server, "GET", "/favicon.ico")[0] == 204
    assert ask(server, "GET", "/../etc/passwd")[0] == 404


def test_requests_come_in_order_or_are_refused(server):
    assert do(server, {"do": "pause"})[0] == 204
    assert do(server, {"do": "speed", "value": 2})[0] == 204
    assert [server.requests.get_nowait().do for _ in range(2)] == ["pause", "speed"]
    assert do(server, {"do": "explode"}) == (400, "there is no 'explode' to do")
    assert ask(server, "POST", "/", "{}", **JSON)[0] == 404
    assert ask(server, "POST", "/do", "x" * 3000, **JSON)[0] == 413
    while not server.requests.full():
        assert do(server, {"do": "step"})[0] == 204
    assert do(server, {"do": "step"})[0] == 503


def test_pages_of_other_sites_do_not_reach_in(server):
    """A form, a script of another origin, and a name pointed at this computer."""
    here = ":".join(map(str, server.address))
    assert do(server, {"do": "step"}, Origin=f"http://{here}")[0] == 204
    form = {"Content-Type": "application/x-www-form-urlencoded"}
    assert ask(server, "POST", "/do", '{"do": "step"}', **form)[0] == 415
    assert do(server, {"do": "step"}, Origin="http://evil.example")[0] == 403
    evil = f"evil.example:{server.address[1]}"
    assert do(server, {"do": "step"}, Host=evil, Origin=f"http://{evil}")[0] == 403
    assert ask(server, "GET", "/", Host=evil)[0] == 403
    assert server.requests.qsize() == 1


def test_a_page_gets_the_newest_frame_and_the_last(server):
    server.show({"time": 1})
    server.show({"time": 2})
    newest = {"number": 2, "frame": {"time": 2}}
    assert json.loads(ask(server, "GET", "/live?after=0")[1]) == newest
    threading.Timer(0.2, server.show, ({"ended": "now"},)).start()
    last = {"number": 3, "frame": {"ended": "now"}}
    assert json.loads(ask(server, "GET", "/live?after=2")[1]) == last
    assert ask(server, "GET", "/live?after=x")[0] == 404


def test_a_frame_of_what_is_not_finite_is_a_mistake(server):
    with pytest.raises(ValueError, match="Out of range"):
        server.show({"time": float("nan")})


def test_a_port_that_is_taken(server):
    _, port = server.address
    with pytest.raises(CrarError, match=f"HTTP at 127.0.0.1:{port}: .*--port"):
        PlayServer("127.0.0.1", port)
    with pytest.raises(CrarError, match="70000 must be from 0 to 65535"):
        PlayServer("127.0.0.1", 70000)
    with pytest.raises(CrarError, match="--host is empty"):
        PlayServer("", 0)
    with pytest.raises(CrarError, match="--host must be an address of this computer"):
        PlayServer("192.0.2.1", 0)
