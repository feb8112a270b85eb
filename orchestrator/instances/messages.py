"""Messages that FMUs log, kept by instance."""

from __future__ import annotations

import ctypes
import itertools
import re
from collections import deque
from functools import cache
from typing import Any
from weakref import WeakValueDictionary

KEPT = 20  # messages of an instance
OK = 0  # of FMI's statuses

_ENVIRONMENTS = itertools.count(1)
TRACEBACK = "Traceback (most recent call last):"


class Message(str):
    """A message in one line; `traceback`: of the exception of a Python model that it is about, or ""."""

    traceback: str = ""


_MESSAGES: WeakValueDictionary[int, deque[Message]] = WeakValueDictionary()  # of live instances, by environment


def listen() -> tuple[int, deque[Message]]:
    """An environment for a new instance, and the list that its messages go to as long as it exists."""
    environment, messages = next(_ENVIRONMENTS), deque[Message](maxlen=KEPT)
    _MESSAGES[environment] = messages
    return environment, messages


def keep(environment: int | None, status: int, message: bytes | None) -> None:
    """Keep a message of the instance with that environment, unless its status is OK."""
    messages = _MESSAGES.get(environment or 0)
    if messages is not None and status > OK:
        messages.append(_plain((message or b"").decode(errors="replace")))


def callbacks_for(environment: int, formats: bool) -> Any:
    """fmi2CallbackFunctions of an instance; formats: as for `_callbacks`."""
    from fmpy.fmi2 import fmi2CallbackFunctions

    copy = fmi2CallbackFunctions.from_buffer_copy(_callbacks(formats)[0])
    copy.componentEnvironment = environment
    return copy


@cache
def _callbacks(formats: bool) -> Any:
    """The callbacks of all instances, and their logger, which must live as long as they do.

    There is one logger, since FMPy's proxy, which formats printf-style messages, keeps only one; it tells instances
    apart by their environment.  formats: False for pythonfmu's library, which gives the text of an exception as the
    format: a "%s" in it would read arbitrary memory.
    """
    from fmpy.fmi2 import defaultCallbacks, fmi2CallbackFunctions, fmi2CallbackLoggerTYPE
    from fmpy.logging import addLoggerProxy

    def logger(environment: int | None, instance: bytes, status: int, category: bytes, message: bytes) -> None:
        keep(environment, status, message)

    callbacks = fmi2CallbackFunctions()
    callbacks.logger = fmi2CallbackLoggerTYPE(logger)
    callbacks.allocateMemory = defaultCallbacks.allocateMemory
    callbacks.freeMemory = defaultCallbacks.freeMemory
    if formats:
        addLoggerProxy(ctypes.byref(callbacks))
    return callbacks, logger


def _plain(message: str) -> Message:
    """The model's own message, without what pythonfmu's library puts around it, and its traceback."""
    head, mark, lines = message.partition(f"\n{TRACEBACK}\n")
    plain = Message(_without_library(head))
    plain.traceback = f"{TRACEBACK}\n{lines}" if mark else ""
    return plain


def _without_library(message: str) -> str:
    text = " ".join(message.split())
    match = re.search(r"Fatal py exception encountered: \[\w+\] \w+ (.*)", text)
    if not match:
        return text
    error = re.fullmatch(r"(\w+)\((['\"])(.*?)\2?,?\)", match[1])
    return f"{error[1]}: {error[3]}" if error else match[1]
