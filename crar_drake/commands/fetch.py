"""`crar-drake fetch`: recordings of the CMU database, downloaded."""

import argparse

from crar_drake.commands.options import add_command


def add(subparsers: argparse._SubParsersAction) -> None:
    """Adds the command and its options."""
    parser = add_command(
        subparsers,
        "fetch",
        run,
        "Download recordings of the CMU motion-capture database into the user's cache.",
    )
    parser.add_argument(
        "trials",
        nargs="+",
        metavar="TRIAL",
        help="a recording's number in the database, such as 05_02",
    )
    parser.add_argument(
        "--force", action="store_true", help="download it even if it is there already"
    )


def run(arguments: argparse.Namespace) -> None:
    """Does what the arguments say."""
    from crar_drake.motion.catalogue import trial_id
    from crar_drake.motion.fetch import LICENCE_NOTICE, fetch, rich_progress

    trials = [trial_id(text) for text in arguments.trials]
    print(LICENCE_NOTICE)
    for trial in trials:
        with rich_progress() as progress:
            files = fetch(trial, progress=progress, force=arguments.force)
        print(files.asf)
        print(files.amc)
