"""A page whose scripts, meshes and arrays are compressed; the browser unpacks them.

Meshcat's own script alone has 2.2 MB, and what it draws is base64 of text. In
one gzip stream that shrinks to a third or less. `page/unpack.js` undoes it, with the
browser's own DecompressionStream.
"""

import base64
import gzip
import re
from collections.abc import Sequence

import numpy as np

from crar_drake.resources import page_resource

# A script in the page itself; not data, and not what has an address or is empty.
_SCRIPT = re.compile(r'<script(?: type="text/javascript")?>(.+?)</script>', re.DOTALL)
# What Meshcat's `StaticHtml` draws with. Where another Drake writes it differently,
# nothing matches, and it stays in its script: larger, but as good.
_COMMAND = re.compile(
    r'fetch\("data:application/octet-binary;base64,([A-Za-z0-9+/=]*)"\)\s*'
    r"\.then\(res => res\.arrayBuffer\(\)\)\s*"
    r"\.then\(buffer => viewer\.handle_command_bytearray\(new Uint8Array\(buffer\)\)\);"
)


def packed_page(page: str, arrays: Sequence[bytes] = ()) -> str:
    """The page with its scripts, and what they draw, in one compressed block.

    Args:
        page: HTML with scripts in it. They are run in their order, after the whole page
            is there.
        arrays: for the scripts, which find them as `crarPacked[0]`, `crarPacked[1]` and
            so on, each a Uint8Array.
    """
    parts = list(arrays)

    def take_command(match: re.Match) -> str:
        parts.append(base64.b64decode(match[1]))
        return f"viewer.handle_command_bytearray(crarPacked[{len(parts) - 1}]);"

    def take_script(match: re.Match) -> str:
        scripts.append(_COMMAND.sub(take_command, match[1]).encode())
        return ""

    scripts: list[bytes] = []
    page = _SCRIPT.sub(take_script, page)
    stream = gzip.compress(b"".join([*parts, *scripts]), 9, mtime=0)
    body, end, rest = page.rpartition("</body>")
    return (
        f'{body}<script type="text/plain" id="crar-packed"'
        f' data-parts="{_lengths(parts)}" data-scripts="{_lengths(scripts)}">'
        f"{base64.b64encode(stream).decode()}</script>\n"
        f"<script>\n{page_resource('unpack.js')}</script>\n{end}{rest}"
    )


def packed_array(values: np.ndarray, step: float) -> bytes:
    """An array over time, so that it can be compressed well.

    Each column stands together, and of all numbers first the first bytes, then the
    second ones and so on: what changes slowly in time repeats itself.

    Args:
        values: (F, ...), at F frames; may have NaN.
        step: a power of two. Numbers are rounded to its multiples, which lets most
            bytes of what is about 1 be zero.

    Returns:
        Little-endian 4-byte numbers, F of the first column and so on, in four planes.
    """
    columns = values.reshape(len(values), -1).T
    rounded = np.ascontiguousarray(np.round(columns / step) * step, "<f4")
    return rounded.view(np.uint8).reshape(-1, 4).T.tobytes()


def _lengths(parts: Sequence[bytes]) -> str:
    return " ".join(str(len(part)) for part in parts)
