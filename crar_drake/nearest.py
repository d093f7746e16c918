"""What a mistyped name may have meant."""

import difflib
from collections.abc import Iterable

# More names than these are more than anybody reads.
_MOST_NAMES = 40


def nearest(name: str, known: Iterable[str]) -> str:
    """The end of an error message: "; did you mean x?" or the names there are."""
    known = sorted(set(known))
    close = difflib.get_close_matches(name, known, n=1)
    if close:
        return f"; did you mean {close[0]!r}?"
    more = f" and {len(known) - _MOST_NAMES} more" if len(known) > _MOST_NAMES else ""
    return f"; known are {', '.join(known[:_MOST_NAMES])}{more}" if known else ""
