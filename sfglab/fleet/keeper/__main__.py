"""``python -m sfglab.fleet.keeper CONFIG``: a keeper that reports JSON lines; see `app`."""

import sys

from sfglab.fleet.keeper.app import main

if __name__ == "__main__":
    main(sys.argv[1])
