"""Options that several benchmarks have."""

import argparse

from crar_drake.commands.options import positive
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
