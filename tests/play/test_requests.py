"""What a page may ask for, and what is refused."""

import json

import pytest

from crar_drake.play.requests import LONGEST, Request, parse
from crar_drake.strict_json import MessageError


def said(**request: object) -> bytes:
    return json.dumps(request).encode()


@pytest.mark.parametrize(
    "body, request_",
    [
        (said(do="pause"), Request("pause")),
        (said(do="speed", value=0.5), Request("speed", 0.5)),
        (
            said(do="offset", task=1, value=[0.1, 0, -2]),
            Request("offset", [0.1, 0.0, -2.0], task=1),
        ),
        (said(do="ball", value=[1, 0.5, 0]), Request("ball", [1.0, 0.5, 0.0])),
        (said(do="ball away"), Request("ball away")),
        (said(do="motion", value=False), Request("motion", False)),
        (
            said(do="push", frame="tool", value=[0, 0, 500]),
            Request("push", [0.0, 0.0, 500.0], frame="tool"),
        ),
    ],
)
def test_what_can_be_asked_for(body, request_):
    assert parse(body) == request_


@pytest.mark.parametrize(
    "body, why",
    [
        (b"", "no JSON"),
        (rb'{"do": "push", "frame": "\ud800", "value": [0, 0, 1]}', "no valid Unicode"),
        (rb'{"do": "\udc00"}', "no valid Unicode"),
        (b"\xff\xfe", "no JSON"),
        (b"[" * LONGEST, "no JSON"),
        (b" " * (LONGEST + 1), "longer than"),
        (b"[]", "no JSON object"),
        (b'{"do": 1}', "there is no '1' to do"),
        (said(do="__init__"), "there is no '__init__' to do"),
        (said(do="pause", value=1), "pause has do"),
        (said(do="speed"), "speed has do, value"),
        (said(do="speed", value=True), "is no number"),
        (said(do="speed", value=1e400), "Infinity is no number"),
        (b'{"do": "speed", "value": NaN}', "NaN is no number"),
        (b'{"do": "speed", "value": 1' + b"0" * 400 + b"}", "is not from"),
        (said(do="offset", task=0.5, value=[0, 0]), "3 numbers"),
        (said(do="offset", task=-1, value=[0, 0, 0]), "is not from"),
        (said(do="offset", task=0, value=[0, 0, 2.1]), "is not from -2 to 2"),
        (said(do="ball", value=[0, 0, 11]), "is not from -10 to 10"),
        (said(do="ball away", value=[0, 0, 1]), "ball away has do"),
        (said(do="motion", value=0), "true or false"),
        (said(do="push", frame="x" * 201, value=[0, 0, 0]), "by its name"),
        (said(do="push", frame="tool", value=[0, 0, 501]), "is not from"),
    ],
)
def test_what_cannot(body, why):
    with pytest.raises(MessageError, match=why):
        parse(body)
