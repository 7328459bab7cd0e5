"""Entry point of ``python -m sfglab`` and of the command: Ctrl-C prints one line, even during the imports."""

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
