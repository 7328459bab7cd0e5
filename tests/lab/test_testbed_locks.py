"""Locks of the test bed: other users cannot take them, and this user's programs exclude each other."""

import fcntl
import socket
from contextlib import ExitStack, closing, suppress

import pytest

from sfglab.bus import locks
from sfglab.bus.locks import LockedError, user_lock
from sfglab.lab.testbed import DOMAINS, FIRST_DOMAIN, Testbed, held_domains

pytestmark = pytest.mark.live


def test_names_that_another_took_hold_nobody_up_and_a_domain_is_had_once():
    names = ["run-on-one-host", *(f"dds-domain-{FIRST_DOMAIN + i}" for i in range(DOMAINS))]
    with ExitStack() as squatter:
        for name in names:
            taken = squatter.enter_context(
                closing(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM))
            )
            with suppress(OSError):  # an earlier version runs beside: squatter enough
                taken.bind(f"\0sfglab-{name}")
        with held_domains(3) as some, held_domains(3) as others, Testbed("a", separate=False):
            assert len({*some, *others}) == 6
            for lock in ("run-on-one-host", f"dds-domain-{some[0]}"):
                with pytest.raises(LockedError):
                    user_lock(lock).__enter__()


@pytest.mark.parametrize("taken_away", [False, True])
def test_a_lock_leaves_no_file_and_who_opened_another_s_file_takes_a_new_one(
    tmp_path, monkeypatch, taken_away
):
    monkeypatch.setattr(locks, "own_folder", lambda: tmp_path)

    def flock(*args):
        monkeypatch.undo()  # the rest of this test uses the real one
        monkeypatch.setattr(locks, "own_folder", lambda: tmp_path)
        for path in tmp_path.iterdir():
            path.unlink()
        return fcntl.flock(*args)

    if taken_away:
        monkeypatch.setattr(locks.fcntl, "flock", flock)
    with user_lock("a"), pytest.raises(LockedError):
        user_lock("a").__enter__()
    assert not list(tmp_path.iterdir())
