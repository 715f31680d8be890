"""Threads that stay awake for a moment, for kernels that take less time than waking a thread does.

`beamfield.kernels.threads` hands Python functions to threads that sleep: waking one takes 30 to 40 microseconds, as
long as a call of a likelihood field. The threads here never sleep while calls follow each other closely: they watch a
few words of memory, without the GIL, and take blocks of rows of the caller's job from there.
"""

from __future__ import annotations

import os
import threading
from contextlib import suppress

import numpy as np
from numba.core import config
from numpy.typing import NDArray

from beamfield.kernels.atomic import add, call, load, pause, replace, store
from beamfield.kernels.jit import kernel
from beamfield.kernels.processors import keep_off, n_processors, processor_in_use

Words = NDArray[np.int64]

# The words of a board, each on a cache line of its own.
TICKET, FINISHED, TAKEN, JOB = 0, 8, 16, 24
# In the words from JOB on: addresses of the function and its arguments, rows, rows of a block, blocks, threads that may
# help.
FUNCTION, ARGUMENTS, N_ROWS, ROWS, N_BLOCKS, HELPERS, WORDS = range(JOB, JOB + 7)
# A ticket is the job's number times this, plus the next block of rows.
BLOCKS = 2**20
# How often a thread looks for a job before it sleeps: 0.1 to 0.2 ms.
LOOKS = 5_000


def run_together(function: int, arguments: Words, n_rows: int, rows: int, *, threads: int) -> None:
    """Call a compiled function over blocks of [0, n_rows), with the help of threads that wait awake.

    Parameters
    ----------
    function
        Address of a C function ``void (int64 *arguments, int64 start, int64 stop)``, which computes each row alone.
    arguments
        All it needs, as words: addresses, sizes. What they point to must live until this returns.
    n_rows, rows
        Number of rows, and of rows in a block. Blocks go to whoever asks next, so that a thread that comes late, or
        that the system has stopped, is not waited for.
    threads
        Number of threads, the caller among them.

    Notes
    -----
    While another caller's job is being done, the caller works alone, so that nobody waits.
    """
    board = _board
    board.wake(threads - 1)
    lead(board.words, function, arguments, n_rows, rows, threads - 1)


def is_possible() -> bool:
    """Whether kernels are compiled: interpreted ones cannot share memory as this needs."""
    return not config.DISABLE_JIT  # type: ignore[attr-defined]  # made when Numba is imported


class _Board:
    """Where a job is announced, and the threads that look at it."""

    def __init__(self) -> None:
        self.words: Words = np.zeros(WORDS, np.int64)
        self.words[TICKET] = BLOCKS - 1
        self._helpers: list[_Helper] = []
        self._starting = threading.Lock()

    def wake(self, n: int) -> None:
        """Have n threads awake, no more than there are processors beside the caller's."""
        for i in range(n):
            if i >= len(self._helpers):
                if i >= n_processors() - 1:
                    return
                self._start(i)
            if self._helpers[i].asleep:
                self._helpers[i].wake()

    def _start(self, i: int) -> None:
        """Start the thread of this number, unless another caller just has."""
        with self._starting:
            if i == len(self._helpers):
                self._helpers.append(_Helper(self.words, i))


class _Helper(threading.Thread):
    """A thread that looks at the board, and sleeps when nothing has been there for a while.

    Nothing that a caller does leaves it asleep for good: a signal (Ctrl-C) may end the caller's Python code between any
    two steps, so that only the thread itself says whether it is asleep.
    """

    def __init__(self, words: Words, number: int) -> None:
        super().__init__(name="beamfield awake", daemon=True)
        self._words, self._number = words, number
        self._woken, self.asleep = threading.Lock(), True
        self._woken.acquire()
        self._kept_off = -1
        # Compiled here, not beside the first jobs.
        _help_out(words, number, 0)
        self.start()

    def run(self) -> None:
        while True:
            self._woken.acquire()
            self.asleep = False
            _help_out(self._words, self._number, LOOKS)
            self.asleep = True

    def wake(self) -> None:
        """Let it look again."""
        here = processor_in_use()
        if here != self._kept_off and keep_off(self.native_id, here):
            self._kept_off = here
        # Released already: someone has woken it, and it has not come to say so.
        with suppress(RuntimeError):
            self._woken.release()


def _start_anew() -> None:
    """Forget the threads in a forked process: it inherits the list, but none of them, and a lock that may be held."""
    global _board
    _board = _Board()


_board = _Board()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_start_anew)


@kernel
def lead(board: Words, function: int, arguments: Words, n_rows: int, rows: int, helpers: int) -> None:
    """Announce a job, work on it, and wait for the blocks that others have taken; alone if another job is there.

    All of it here, where no signal can end it half way.
    """
    if not replace(board, TAKEN, 0, 1):
        call(function, arguments.ctypes.data, 0, n_rows)
        return
    rows = max(rows, (n_rows + BLOCKS - 2) // (BLOCKS - 1))
    n_blocks = (n_rows + rows - 1) // rows
    board[FUNCTION], board[ARGUMENTS] = function, arguments.ctypes.data
    board[N_ROWS], board[ROWS] = n_rows, rows
    # Read by threads that have taken no block yet.
    store(board, N_BLOCKS, n_blocks)
    store(board, HELPERS, helpers)
    store(board, FINISHED, 0)
    # Whoever takes a block from here on sees all of the above. One who read the number of blocks of another job cannot
    # take any: the ticket it saw with it has gone, and none comes back. These words are stored and loaded in one order
    # for all threads, on any processor; the plain ones are read only by who has a block, which keeps the job open.
    store(board, TICKET, (load(board, TICKET) // BLOCKS + 1) * BLOCKS)
    while _take_block(board):
        pass
    while load(board, FINISHED) < n_blocks:
        pause()
    # Closed: the words may change from here on.
    store(board, TICKET, load(board, TICKET) // BLOCKS * BLOCKS + BLOCKS - 1)
    store(board, TAKEN, 0)


@kernel
def _take_block(board: Words) -> bool:
    """Do the next block of the job, if any is left; whether one was, or may have been."""
    ticket = load(board, TICKET)
    block = ticket % BLOCKS
    if block >= load(board, N_BLOCKS):
        return False
    if replace(board, TICKET, ticket, ticket + 1):
        rows, n_rows = board[ROWS], board[N_ROWS]
        call(board[FUNCTION], board[ARGUMENTS], block * rows, min((block + 1) * rows, n_rows))
        add(board, FINISHED, 1)
    return True


@kernel
def _help_out(board: Words, number: int, most_looks: int) -> None:
    """Take blocks of the jobs that are announced, until there has been none for so many looks."""
    looks = 0
    while looks < most_looks:
        if number < load(board, HELPERS) and _take_block(board):
            looks = 0
        else:
            pause()
            looks += 1
