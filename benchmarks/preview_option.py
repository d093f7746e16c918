"""The option --preview, of benchmarks that run the lookahead as it comes."""

from __future__ import annotations

import argparse

from crar_drake.commands.options import positive
from crar_drake.control.lookahead_parameters import LookaheadParameters
from crar_drake.control.parameters import CrarParameters


def add_preview_option(parser: argparse.ArgumentParser) -> None:
    """--preview S: None where it is not given."""
    parser.add_argument(
        "--preview",
        type=positive,
        metavar="S",
        help="the lookahead with a preview of so many seconds (default: without)",
    )


def defaults_or_preview(arguments: argparse.Namespace) -> str:
    """The part of a page that the options measure."""
    return "preview" if arguments.preview else "defaults"


def lookahead_defaults(preview: float | None, **settings) -> CrarParameters:
    """The lookahead with or without a preview [s], all else by default but `settings`.

    Args:
        preview: what --preview says.
        settings: other fields of `CrarParameters`.
    """
    return CrarParameters(
        constraints="lookahead",
        lookahead=LookaheadParameters(preview=preview),
        **settings,
    )
