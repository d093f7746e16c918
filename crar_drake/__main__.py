"""`python -m crar_drake` is `crar-drake`."""

import sys

from crar_drake.commands import main

if __name__ == "__main__":
    sys.exit(main())
