"""Compilation of functions by Numba at import, not at the first call; importing Numba takes 0.3 s."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Any

import numba

if TYPE_CHECKING:
    from collections.abc import Callable

_log = logging.getLogger(__name__)


def compiled(signature: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Return a decorator that compiles a function at once, with a cache if its folder is writable."""

    def compile_now(function: Callable[..., Any]) -> Callable[..., Any]:
        try:
            return numba.njit(signature, nogil=True, cache=True)(function)
        except RuntimeError as error:  # numba found no directory that it may write
            _log.warning(
                "%s is compiled again in each process; set NUMBA_CACHE_DIR: %s", function, error
            )
            return numba.njit(signature, nogil=True)(function)

    return compile_now
