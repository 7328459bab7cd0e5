"""Our commands as a user has them, in this process."""

from inspect import unwrap

from typer.main import get_command
from typer.testing import CliRunner

from sfglab.cli import app


def called(*arguments, status=0):
    """Call a command; return what was printed."""
    done = CliRunner().invoke(app, arguments)
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    assert done.exit_code == status, done.output
    return done.output


def commands(command=None, words=()):
    """Yield the words and the command of each that is no group and not hidden."""
    # Parsers of their own: tests also make some without the options of their groups.
    command = command or unwrap(get_command)(app)
    for name, inner in getattr(command, "commands", {}).items():
        yield from commands(inner, (*words, name))
    if not hasattr(command, "commands") and not command.hidden:
        yield words, command
