"""``python -m sfglab`` and the command: Ctrl-C is one line, also while libraries are still imported."""

import sys


def main() -> None:
    """Run the command line."""
    try:
        from sfglab import cli

        cli.main()
    except KeyboardInterrupt:
        sys.stderr.write("sfglab: interrupted\n")
        sys.exit(130)


if __name__ == "__main__":
    main()
