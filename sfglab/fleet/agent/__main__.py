"""``python -m sfglab.fleet.agent CONFIG``: an agent that reports JSON lines; see `app`."""

import sys

from sfglab.fleet.agent.app import main

if __name__ == "__main__":
    main(sys.argv[1])
