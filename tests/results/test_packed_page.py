"""A page's scripts and arrays, compressed: against what was put in."""

import base64
import gzip
import re

import numpy as np
import pytest

from crar_drake.results.packed_page import packed_array, packed_page

DRAWN = b"\x83\xa4type\xaaset_object"
DRAW = (
    f'fetch("data:application/octet-binary;base64,{base64.b64encode(DRAWN).decode()}")\n'
    "    .then(res => res.arrayBuffer())\n"
    "    .then(buffer => viewer.handle_command_bytearray(new Uint8Array(buffer)));\n"
)


def page(*scripts: str) -> str:
    told = "".join(f"<script>{text}</script>\n" for text in scripts)
    return (
        "<html><title>a</title><body><p>b</p>"
        '<script type="text/javascript">first();</script>\n'
        f'{told}<script id="embedded-json"></script>'
        '<script type="application/json" id="d">{"c": 1}</script></body></html>'
    )


def unpack(text: str) -> tuple[str, list[bytes], list[bytes]]:
    """The page around the block, its parts, its scripts."""
    tag = re.search(r'<script type="text/plain" id="crar-packed"([^>]*)>(.*?)<', text)
    sizes = {
        name: [int(n) for n in value.split()]
        for name, value in re.findall(r'data-(\w+)="([^"]*)"', tag[1])
    }
    everything = gzip.decompress(base64.b64decode(tag[2]))
    found, start = [], 0
    for size in sizes["parts"] + sizes["scripts"]:
        found.append(everything[start : start + size])
        start += size
    assert start == len(everything)
    count = len(sizes["parts"])
    return text, found[:count], found[count:]


def test_scripts_in_their_order_and_what_they_draw():
    text, parts, scripts = unpack(
        packed_page(page(f"a();{DRAW}b();", "c();"), [b"xyz"])
    )
    assert parts == [b"xyz", DRAWN]
    assert scripts[0] == b"first();" and scripts[2] == b"c();"
    drawn = re.sub(r"\s", "", scripts[1].decode())
    assert drawn == "a();viewer.handle_command_bytearray(crarPacked[1]);b();"
    # The rest stays, and only the block's own script is run at first.
    assert '<script type="application/json" id="d">{"c": 1}</script>' in text
    assert "<p>b</p>" in text and text.endswith("</body></html>")
    assert "first();" not in text and text.count("<script>") == 1


def test_what_another_drake_writes_stays_in_its_script():
    other = DRAW.replace("handle_command_bytearray", "handle_something")
    _, parts, scripts = unpack(packed_page(page(other)))
    assert parts == [] and scripts[1].decode() == other


@pytest.mark.parametrize("shape", [(1, 1), (7, 3), (40, 5, 3), (4, 0)])
def test_arrays_are_rounded_and_nothing_else(shape):
    values = np.random.default_rng(1).uniform(-3.0, 3.0, shape)
    values.ravel()[::5] = np.nan
    step = 2**-14
    told = np.frombuffer(packed_array(values, step), np.uint8)
    # Four planes: the first bytes of all numbers, the second ones, ...
    numbers = np.stack(np.split(told, 4), axis=1).copy().view("<f4").ravel()
    columns = numbers.reshape(-1, len(values)).T.reshape(shape)
    np.testing.assert_allclose(columns, values, rtol=0, atol=step / 2)
