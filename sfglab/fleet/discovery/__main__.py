"""``python -m sfglab.fleet.discovery CONFIG``: a discoverer that reports JSON lines; see `app`."""

import sys

from sfglab.fleet.discovery.app import main

if __name__ == "__main__":
    main(sys.argv[1])
