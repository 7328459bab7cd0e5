"""Our commands as a user has them, in this process."""

from typer.testing import CliRunner

from sfglab.cli import app


def called(*arguments, status=0):
    """Call a command; return what was printed."""
    done = CliRunner().invoke(app, arguments)
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    assert done.exit_code == status, done.output
    return done.output
