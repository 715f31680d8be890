"""Where a fleet's work is done: by a Dask cluster, by processes of this machine, or here."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")
# Called with items done and items in all.
Progress = Callable[[int, int], None]


class Engine:
    """Applies functions to many items.

    Parameters
    ----------
    scheduler
        "serial" in this process; "processes" of this machine (a Dask LocalCluster); or the address of a Dask scheduler.
        None: processes if there is more than one processor.
    workers
        Number of processes; None: one per processor.
    """

    def __init__(self, scheduler: str | None = None, workers: int | None = None) -> None:
        raise NotImplementedError

    def __enter__(self) -> Engine:
        raise NotImplementedError

    def __exit__(self, *_: object) -> None:
        raise NotImplementedError

    def map(
        self,
        function: Callable[[Item], Result],
        items: Sequence[Item],
        *,
        key: Callable[[Item], str] | None = None,
        progress: Progress | None = None,
    ) -> list[Result]:
        """Return function(item) of each item, in their order.

        Parameters
        ----------
        function
            Of a module, so that workers can import it.
        items
            What it is applied to; they and the results are sent between processes.
        key
            Names a task by its content: whoever else asks the same scheduler for it waits for the one result. None:
            every call is its own.
        progress
            Called with items done and in all.
        """
        raise NotImplementedError

    def reduce(
        self,
        function: Callable[[Item], Result],
        items: Sequence[Item],
        combine: Callable[[Result, Result], Result],
        *,
        progress: Progress | None = None,
    ) -> Result:
        """Return the results of all items combined, in a fixed order: neighbours first, then neighbouring pairs.

        The same bits for any number of workers, whenever results arrive.
        """
        raise NotImplementedError
