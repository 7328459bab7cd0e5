"""``python -m sfglab``: the command line."""

from sfglab.cli import main

if __name__ == "__main__":
    main()
