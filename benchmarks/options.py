"""Options that several benchmarks have."""

import argparse
from collections.abc import Callable, Iterable

from crar_drake.commands.options import positive
from crar_drake.errors import nearest
from crar_drake.law.parameters import LookaheadParameters, PaperGains


def seed_number(text: str) -> int:
    """Converts a seed of dice: a whole number that is not negative."""
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(
            f"{text!r} is not a whole number from 0 on, as seeds are"
        )
    return int(text)


def add_preview_option(parser: argparse.ArgumentParser) -> None:
    """--preview S: None where it is not given."""
    parser.add_argument(
        "--preview",
        type=lambda text: 0.0 if text == "0" else positive(text),
        metavar="S",
        help="how far the lookahead plans ahead [s] (default: its own; 0: not at all, "
        "the nominal is the paper's law)",
    )


def defaults_or_preview(arguments: argparse.Namespace) -> str:
    """The part of a page that the options measure."""
    if arguments.preview is None:
        return "defaults"
    return "preview" if arguments.preview else "no preview"


def lookahead_defaults(preview: float | None, **settings) -> LookaheadParameters:
    """The lookahead with another preview or none, all else by default but `settings`.

    Args:
        preview: what --preview says [s].
        settings: other fields of `LookaheadParameters`.
    """
    if preview == 0.0:
        return LookaheadParameters(nominal=PaperGains(), **settings)
    return LookaheadParameters(preview=preview, **settings)


def add_duration(parser: argparse.ArgumentParser) -> None:
    """--duration, of each of many motions."""
    parser.add_argument(
        "--duration",
        type=positive,
        metavar="S",
        help="simulate S seconds of each motion (default: all of it)",
    )


def list_of(convert: Callable[[str], object]) -> Callable[[str], list]:
    """Converts what stands between commas."""
    return lambda text: [convert(part.strip()) for part in text.split(",")]


def one_of(known: Iterable[str], what: str = "") -> Callable[[str], str]:
    """Takes a known word only; `what` it is."""

    def convert(text: str) -> str:
        if text not in known:
            raise argparse.ArgumentTypeError(
                f"no {what or 'value'} {text!r}{nearest(text, list(known))}"
            )
        return text

    return convert
