"""``python -m sfglab.fleet.routing CONFIG``: a router that reports JSON lines; see `app`."""

import sys

from sfglab.fleet.routing.app import main

if __name__ == "__main__":
    main(sys.argv[1])
