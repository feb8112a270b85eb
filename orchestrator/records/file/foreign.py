"""Reads HDF5 without trust: a record may come from anybody, as an FMU may.

Everything of a record is opened by `child`, which follows no link, and read after `dataset` or `attributes` has
checked it: no link leads out of the file, no number of rows is greater than the file holds, and what an attribute says
has the form that docs/record.md states.  `Foreign`, which names the attribute or the data set, is raised otherwise.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Container, Iterator, Mapping
from typing import Any

import h5py
from h5py import h5l, h5t

from ...metrics.specs import METRICS, NUMBERS, TEXTS
from .format import FORMAT, FORMAT_VERSION

DEFLATED = 1100  # bytes that a byte of a compressed file stands for, at most
LARGEST = 1 << 32  # bytes of a data set that is compressed
CHUNK = 1 << 24  # bytes of a chunk, in any case
FILTERS = (1, 2, 3, 4, 5, 6, 32000)  # those of HDF5 itself, and lzf of h5py: no other code is loaded
KEPT_SIZE = (2, 3)  # shuffle and Fletcher-32 compress nothing
DEEPEST = 64  # tables and lists within each other


class Foreign(ValueError):
    """What a record may not hold; the text begins with the attribute or the data set."""


# --- Groups and data sets ---------------------------------------------------------------------------------------------


def child(group: h5py.Group, name: str) -> Any:
    """The group or data set of that name, no path, in a group.  Raises KeyError where there is none."""
    where = f"{group.name.rstrip('/')}/{name}"
    if name in ("", ".") or "/" in name or not group.id.links.exists(name.encode()):
        raise KeyError(f"{where} does not exist")
    if group.id.links.get_info(name.encode()).type != h5l.TYPE_HARD:
        raise Foreign(f"{where} is a link to something else, which a record does not have")
    return group[name]


def children(group: h5py.Group) -> Iterator[tuple[str, Any]]:
    """Names and items of a group, in order."""
    for name in group:
        yield name, child(group, name)


def group(parent: h5py.Group, name: str) -> h5py.Group:
    """Raises KeyError where there is none."""
    item = child(parent, name)
    if not isinstance(item, h5py.Group):
        raise Foreign(f"{item.name} is no group")
    return item


def dataset(parent: h5py.Group, name: str, rows: int | None = None) -> h5py.Dataset:
    """One of numbers or texts.  rows: how many are read, all of them by default.  Raises KeyError where it is none."""
    item = child(parent, name)
    if not isinstance(item, h5py.Dataset):
        raise Foreign(f"{item.name} is no data set")
    where = item.name
    try:
        of_text, kind = h5py.check_string_dtype(item.dtype) is not None, item.dtype.kind
    except TypeError:  # HDF5 has types that numpy does not have
        of_text, kind = False, ""
    if not (of_text or (kind in "iuf" and kind and item.dtype.itemsize <= 8)):
        raise Foreign(f"{where} holds neither numbers nor texts")
    if not item.shape:
        raise Foreign(f"{where} has no rows")
    if item.is_virtual or item.external:
        raise Foreign(f"{where} has its values in another file")
    if rows is not None and item.shape[0] < rows:
        raise Foreign(f"{where} has {item.shape[0]} rows, the time {rows}")
    _bound(item, item.shape[0] if rows is None else rows)
    return item


def _bound(item: h5py.Dataset, rows: int) -> None:
    """Raises Foreign where rows are stated that the file does not hold: memory is taken for what is stated."""
    properties = item.id.get_create_plist()
    filters = [properties.get_filter(i)[0] for i in range(properties.get_nfilters())]
    if other := [number for number in filters if number not in FILTERS]:
        raise Foreign(f"{item.name} needs the HDF5 filter {other[0]}")
    held = min(item.id.get_storage_size(), item.file.id.get_filesize())
    if any(number not in KEPT_SIZE for number in filters):
        held = min(held * DEFLATED, LARGEST)
    row = math.prod(item.shape[1:]) * item.dtype.itemsize
    if rows * row > held:
        raise Foreign(f"{item.name} states {rows} rows of {row} bytes, and the file holds {held} bytes of it")
    if item.chunks and math.prod(item.chunks) * item.dtype.itemsize > max(held, CHUNK):
        raise Foreign(f"{item.name} has chunks of {math.prod(item.chunks)} values")


def texts(item: h5py.Dataset, rows: int) -> Any:
    """(rows, *shape) of a data set of texts, which together are not longer than the file."""
    import numpy as np

    most = item.file.id.get_filesize()
    block = max(1, min(1024, (1 << 28) // most))
    parts, length = [], 0
    for first in range(0, rows, block):
        part = item.asstr(errors="replace")[first : min(rows, first + block)]
        length += sum(len(text) for text in part.flat)
        if length > most:
            raise Foreign(f"{item.name} holds texts that are longer than the file")
        parts.append(part)
    return np.concatenate(parts) if parts else np.empty((0, *item.shape[1:]), dtype=object)


# --- Attributes -------------------------------------------------------------------------------------------------------

Shape = Any  # {key: Shape}, with "*" of every other key and "?" behind one that may be missing; [Shape]; a check
Check = Callable[[Any], str]  # what is wrong with a value; "" of a right one


def _text(value: Any) -> str:
    return "" if isinstance(value, str) else "is no text"


def _number(value: Any) -> str:
    return "" if isinstance(value, (int, float)) and not isinstance(value, bool) else "is no number"


def _whole(value: Any) -> str:
    return "" if isinstance(value, int) and not isinstance(value, bool) else "is no whole number"


def _number_or_none(value: Any) -> str:
    return "" if value is None else _number(value)


def _positive(value: Any) -> str:
    return _number(value) or ("" if 0.0 < value < math.inf else f"is {value:g}; it is a positive number")


def _plain(value: Any) -> str:
    return "" if value is None or isinstance(value, (str, int, float)) else "is neither text nor number"


def _any(value: Any) -> str:
    return ""


def _one_of(*texts: str) -> Check:
    return lambda value: "" if value in texts else f"is {str(value)[:40]!r}, none of {', '.join(texts)}"


def _time(value: Any) -> str:
    import datetime

    try:
        return "" if datetime.datetime.fromisoformat(value).tzinfo else "is a time without its zone"
    except (TypeError, ValueError):
        return "is no time of ISO 8601"


def _ends(value: Any) -> str:
    fits = isinstance(value, list) and len(value) in (2, 4)
    if fits and all(isinstance(end, str) for end in value[:2]) and not any(_number(number) for number in value[2:]):
        return ""
    return "is no input, output, and factor and offset"


def _metric(value: Any) -> str:
    if not isinstance(value, dict):
        return "is no table"
    if value.get("of") not in METRICS or not isinstance(value.get("signal"), str):
        return "names no metric of a signal"
    for name, check in METRIC.items():
        if name in value and (problem := check(value[name])):
            return f"its {name} {problem}"
    return ""


METRIC: dict[str, Check] = {**dict.fromkeys(TEXTS, _text), **dict.fromkeys((*NUMBERS, "after", "before"), _number)}
RESOLVED: Shape = {
    "master": {"stop_time": _positive, "step": _positive, "algorithm": _text, "*": _plain},
    "components": [
        {
            "name": _text,
            "fmu": _text,
            "fmu_sha256": _text,
            "parameters": {"*": _plain},
            "start": {"*": _plain},
            "*": _plain,
        }
    ],
    "connections": [_ends],
    "record": {"every": _positive, "signals": [_text], "*": _any},
    "metrics": {"*": _metric},
    "from?": {"run_id": _text, "time": _number, "checkpoint_sha256": _text, "fresh": [_text], "*": _plain},
    "*": _any,
}
TIMING: Shape = {
    "loop?": _text,
    "stepping?": _number,
    "components?": {"*": {"set": _number, "step": _number, "get": _number, "*": _number}},
    "comparison?": {"steps": _number, "seconds": _number, "*": _any},
    "pacing?": {"factor": _number, "late_max": _number, "late_mean": _number, "late_end": _number, "*": _number},
    "*": _any,
}
# Of the root, in JSON.
JSON: dict[str, Shape] = {
    "experiment_resolved": RESOLVED,
    "versions": {"*": _text},
    "metrics": {"*": _number_or_none},
    "metrics_never": [_text],
    "metric_units": {"*": _text},
    "warnings": [_text],
    "warning_kinds": [_text],
    "timing": TIMING,
    "command": [_text],
    "changes": {"set": {"*": _any}, "swap": {"*": _text}, "*": _any},
    "model_descriptions": {"*": _text},
    "last_inputs": {"*": _any},
}
# Of the root, as they are.
PLAIN: dict[str, Check] = {
    "format": _text,
    "format_version": _whole,
    "status": _one_of("running", "completed", "failed", "interrupted"),
    "metrics_of": _one_of("steps", "rows"),
    "created": _time,
    "step": _positive,
    "pid": _whole,
    **dict.fromkeys(("run_id", "title", "error", "algorithm", "experiment", "experiment_toml"), _text),
    **dict.fromkeys(("git_commit", "digest", "platform", "hostname", "experiment_path", "sweep", "kept"), _text),
    **dict.fromkeys(("from_run", "from_file"), _text),
    **dict.fromkeys(("wall_time", "real_time_factor", "seed", "failed_at", "stopped_at", "interrupted_at"), _number),
    "from_time": _number,
}
LATER = ("metrics_never", "metric_units", "warning_kinds", "last_inputs", "experiment_path", "changes", "metrics_of")
SOMETIMES = ("seed", "failed_at", "stopped_at", "interrupted_at", "sweep", "kept", "from_run", "from_file", "from_time")
REQUIRED = tuple(name for name in (*PLAIN, *JSON) if name not in (*LATER, *SOMETIMES))
# Of a component.
COMPONENT: dict[str, Check] = dict.fromkeys(("fmu", "fmu_sha256", "fmi_version", "packaging"), _text)
COMPONENT_JSON: dict[str, Shape] = {name: {"*": _plain} for name in ("parameters", "calculated")}


def root_attributes(file: h5py.File, without: Container[str] = ()) -> dict[str, Any]:
    """Those of a record, JSON decoded.  without: names that are not read."""
    values = _attributes(file, PLAIN, JSON, without)
    for name in REQUIRED:
        if name not in values and name not in without:
            raise Foreign(f"the attribute {name} is missing")
    if values["format"] != FORMAT:
        raise Foreign("the attribute format is not that of a record")
    if not 1 <= values["format_version"] <= FORMAT_VERSION:
        words = f"the attribute format_version is {values['format_version']}: this orch reads up to {FORMAT_VERSION}"
        raise Foreign(words)
    if len(values.get("warning_kinds") or values["warnings"]) != len(values["warnings"]):
        raise Foreign("the attribute warning_kinds does not go with the attribute warnings")
    return values


def component_attributes(component: h5py.Group) -> dict[str, Any]:
    """Those of the group of a component, JSON decoded."""
    return _attributes(component, COMPONENT, COMPONENT_JSON)


def text_of(item: Any, name: str, default: str = "") -> str:
    """An attribute that is a text; `default` where there is none."""
    return str(_attributes(item, {name: _text}, {}, only=name).get(name, default))


def _attributes(
    item: Any, plain: Mapping[str, Check], coded: Mapping[str, Shape], without: Container[str] = (), only: str = ""
) -> dict[str, Any]:
    """Attributes that are a text or a number.  Those of other types that are not named in `plain` or `coded`, which
    anybody may have added, are left out."""
    values: dict[str, Any] = {}
    value: Any
    inside = "" if item.name == "/" else f" of {item.name}"
    attributes = item.attrs
    for name in [only] if only else list(attributes):
        if name in without or (only and only not in attributes):
            continue
        value = _scalar(attributes, name)
        where = f"the attribute {name[:40]}{inside}"
        if name in coded:
            if isinstance(value, str):
                value = _decoded(value, where)
                problem = _misfit(value, coded[name], "")
            else:
                problem = _text(value)
        else:
            problem = plain.get(name, _any)(value)
        if problem:
            raise Foreign(f"{where} {problem.lstrip()}")
        if value is not None:
            values[name] = value
    return values


def _scalar(attributes: h5py.AttributeManager, name: str) -> str | int | float | None:
    """The value of an attribute; None where it is neither a text nor a number."""
    attribute = attributes.get_id(name)
    kind = attribute.get_type().get_class()
    if attribute.shape != () or kind not in (h5t.STRING, h5t.INTEGER, h5t.FLOAT):
        return None
    value = attributes[name]
    if isinstance(value, bytes):
        value = value.decode(errors="replace")
    elif kind != h5t.STRING:
        value = value.item()
        return value if isinstance(value, (int, float)) else None  # floats of 16 bytes remain
    try:
        value.encode()
    except UnicodeEncodeError:
        raise Foreign(f"the attribute {name[:40]!r} is not UTF-8") from None
    return str(value)


def _decoded(text: str, where: str) -> Any:
    """JSON, without what no experiment can hold: see `experiment.bounds`."""
    try:
        value = json.loads(text, parse_int=_bounded)
        if "\\u" in text:
            json.dumps(value, ensure_ascii=False).encode()
    except (ValueError, RecursionError) as error:
        raise Foreign(f"{where} is no JSON that can be read: {str(error)[:100]}") from None
    if "\\u0000" in text:
        raise Foreign(f"{where} contains the character NUL")
    if _depth(value) > DEEPEST:
        raise Foreign(f"{where} is nested more than {DEEPEST} levels deep")
    return value


def _bounded(digits: str) -> int:
    if len(digits) > 20 or not -(1 << 63) <= int(digits) < 1 << 64:
        raise ValueError("a whole number does not fit 64 bits")
    return int(digits)


def _depth(value: Any) -> int:
    depth, level = 0, [value]
    while level and depth <= DEEPEST:
        depth += 1
        tables = [of.values() if isinstance(of, dict) else of for of in level if isinstance(of, (dict, list))]
        level = [value for table in tables for value in table]
    return depth


def _misfit(value: Any, shape: Shape, where: str) -> str:
    """What does not fit, with its place in front; "" where all does."""
    if isinstance(shape, dict):
        if not isinstance(value, dict):
            return f"{where} is no table"
        for key in shape:
            if key not in value and key != "*" and not key.endswith("?"):
                return f"{where} has no {key}"
        for key, below in value.items():
            inner = shape.get(key) or shape.get(f"{key}?") or shape.get("*", _any)
            if inner is not _any and (problem := _misfit(below, inner, f"{where}.{key[:40]}".lstrip("."))):
                return problem
        return ""
    if isinstance(shape, list):
        if not isinstance(value, list):
            return f"{where} is no list"
        return next((p for i, v in enumerate(value) if (p := _misfit(v, shape[0], f"{where}[{i}]"))), "")
    sentence: str = shape(value)
    return f"{where}: {sentence}" if sentence and where else sentence
