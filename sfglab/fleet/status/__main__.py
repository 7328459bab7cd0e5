"""``python -m sfglab.fleet.status CONFIG``: a status provider that reports JSON lines; see `app`."""

import sys

from sfglab.fleet.status.app import main

if __name__ == "__main__":
    main(sys.argv[1])
