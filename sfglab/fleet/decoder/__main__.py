"""``python -m sfglab.fleet.decoder CONFIG``: a decoder that reports JSON lines; see `app`."""

import sys

from sfglab.fleet.decoder.app import main

if __name__ == "__main__":
    main(sys.argv[1])
