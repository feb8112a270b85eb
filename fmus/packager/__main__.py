"""`python -m packager`: reads one JSON request per line and answers each with one line, in any order.

A request is {"source": file, "native": file or null, "python": file or null, "compilers": [{"command", "folder"}]}:
where to write the FMU of which packaging; equations become a native FMU where one is wanted, a plain Python model
never does.  An answer is {"source", "target", "sources": {path: sha256}, "plain": whether it is plain Python,
"reads": files that it reads meanwhile without declaring them}, or
{"source", "error": message, "compiler": whether the compiler failed}.
"""

from __future__ import annotations

import concurrent.futures
import contextlib
import json
import os
import pathlib
import sys
import traceback
from collections.abc import Iterator
from typing import Any

from .native import CompilerError
from .package import package


def main() -> None:
    with concurrent.futures.ThreadPoolExecutor(os.cpu_count()) as pool:
        waiting = []
        for request in map(json.loads, sys.stdin):
            with _reporting(request["source"]) as answer:
                waiting.append((answer, package(request, pool)))  # compilers run while the next model is traced
            if "error" in answer:
                print(json.dumps(answer), flush=True)
        for answer, wait in waiting:
            with _reporting(answer["source"]) as late:
                late |= wait()
            print(json.dumps(late), flush=True)


@contextlib.contextmanager
def _reporting(source: str) -> Iterator[dict[str, Any]]:
    """What a model prints must not mix with the answers; whatever it raises is the answer."""
    answer: dict[str, Any] = {"source": source}
    with contextlib.redirect_stdout(sys.stderr):
        try:
            yield answer
        except CompilerError as error:
            answer |= {"error": str(error), "compiler": True}
        except Exception as error:
            answer |= {"error": _reason(error, pathlib.Path(source)), "compiler": False}


def _reason(error: BaseException, source: pathlib.Path) -> str:
    """The error in one line, with the line of the user's file where it came from."""
    if isinstance(error, SyntaxError):
        return f"line {error.lineno}: {error.msg}"
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(source)]
    where = f"line {lines[-1]}: " if lines else ""
    return f"{where}{type(error).__name__}: {error}"


if __name__ == "__main__":
    main()
