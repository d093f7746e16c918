"""`crar-drake`, which is `python -m crar_drake`, too."""

import os
import sys

# Matrices are small here: the threads of NumPy's library cost more than they bring.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")


def main() -> int:
    """Runs the command line; Ctrl-C ends it without a traceback, imports included.

    Returns:
        The exit code, as of `crar_drake.commands.main`; 130 if interrupted.
    """
    try:
        from crar_drake.commands import main as run

        code = run()
        if code == 130:
            # What Drake was in the middle of may be torn down in the wrong order.
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(code)
        return code
    except (KeyboardInterrupt, ImportError) as error:
        if not _came_of_ctrl_c(error):
            raise
        print("crar-drake: interrupted", file=sys.stderr)
        return 130


def _came_of_ctrl_c(error: BaseException | None) -> bool:
    """Whether a KeyboardInterrupt began it: Drake's modules, which are compiled, turn
    one that comes while they are imported into an ImportError."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


if __name__ == "__main__":
    sys.exit(main())
