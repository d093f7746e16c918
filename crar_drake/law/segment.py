"""How small a smooth function can be on a segment, by its values at few places."""

from collections.abc import Callable

# A segment is halved so often before its bound counts: each halving leaves a quarter of
# what curvature takes from a part's bound, seven 1/10,000.
_HALVINGS = 7


def lowest_on_segment(
    value: Callable[[float], float], curvature: float, level: float
) -> float:
    """No value of a function on [0, 1] is smaller.

    Between a and b it is at least min(f(a), f(b)) - curvature (b - a)^2 / 8. Parts are
    halved until that is at least the level, or an end is below it.

    Args:
        value: the function f; of a place on the segment.
        curvature: |f''| is nowhere larger.
        level: above which nobody asks how small f is.
    """
    least, parts = float("inf"), [(0.0, value(0.0), 1.0, value(1.0), 0)]
    while parts:
        a, of_a, b, of_b, halvings = parts.pop()
        ends = min(of_a, of_b)
        bound = ends - 0.125 * curvature * (b - a) ** 2
        if bound >= level or not ends >= level or halvings == _HALVINGS:
            least = min(least, bound)
            continue
        middle = 0.5 * (a + b)
        of_middle = value(middle)
        parts.append((a, of_a, middle, of_middle, halvings + 1))
        parts.append((middle, of_middle, b, of_b, halvings + 1))
    return least
