"""Bags that are written and read without rosbags compiling its code anew for each."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from types import CodeType, ModuleType
from unittest import mock


@contextmanager
def compiled_once() -> Iterator[None]:
    """Let rosbags compile each text of its generated code once: the same in every bag, and most of its time."""
    from rosbags.serde import cdr, ros1

    with mock.patch.object(cdr, "compile_lines", _module_of), mock.patch.object(ros1, "compile_lines", _module_of):
        yield


def _module_of(lines: list[str]) -> ModuleType:
    module = ModuleType("tmpmod")
    exec(_code_of("\n".join(lines)), module.__dict__)
    return module


@lru_cache(maxsize=5000)
def _code_of(text: str) -> CodeType:
    return compile(text, "<rosbags>", "exec")
