"""What a model raised, with the place in its files."""

from __future__ import annotations

import pathlib
import traceback

HERE = pathlib.Path(__file__).parent
BUNDLE = HERE.parent.parent


class ModelFailed(Exception):
    """Stands in for an exception of the model: pythonfmu's library logs its repr.

    That is the message in one line, with file and line where it came from the model's files, and below it the traceback
    from the model's first frame on.
    """

    def __init__(self, error: Exception):
        frames = [f for f in traceback.extract_tb(error.__traceback__) if pathlib.Path(f.filename).parent != HERE]
        for frame in frames:
            if pathlib.Path(frame.filename).is_relative_to(BUNDLE):
                frame.filename = str(pathlib.Path(frame.filename).relative_to(BUNDLE))
        own = [frame for frame in frames if not pathlib.Path(frame.filename).is_absolute()]
        where = f" ({own[-1].filename}, line {own[-1].lineno})" if own else ""
        message = " ".join(str(error).split())
        self._lines = [f"{type(error).__name__}: {message}{where}"]
        if frames:
            self._lines += [
                "Traceback (most recent call last):",
                *"".join(traceback.format_list(frames)).splitlines(),
                *"".join(traceback.format_exception_only(error)).splitlines(),
            ]
        super().__init__(self._lines[0])

    def __repr__(self) -> str:
        return "\n".join(self._lines)
