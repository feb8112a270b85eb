"""MCAP for Foxglove, all messages in JSON, at simulated time from 0.

/vehicle1 has the signals of a component, as recorded: /vehicle1.eta.x is a path of Foxglove's.  /vehicle1/pose,
/vehicle1/desired_pose, /vehicle1/track (once, at the start) and /tf have what its 3D panel draws; see `foxglove`.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from mcap.writer import Writer

from ...names import ANGLE_AXES
from ...records.compare.vehicles import AXES, vehicles
from . import foxglove
from .content import Content, Signal, unique

if TYPE_CHECKING:
    from ...arrays import Reals, Table

LONGEST_TRACK = 2000  # poses
BATCH = 1024  # rows that are held as messages at a time
TYPES = {"real": "number", "integer": "integer", "boolean": "boolean", "string": "string"}


@dataclass(frozen=True)
class Channel:
    """messages(rows): a message for each of these rows."""

    topic: str
    schema: Mapping[str, Any]
    messages: Callable[[slice], list[Any]]


def write(content: Content, target: Path) -> None:
    times = [round(time * foxglove.NANOSECONDS) for time in content.time.tolist()]
    taken = {f"/{component}" for component in content.components}
    channels = [_component(content, component) for component in content.components]
    channels += _vehicles(content, times, taken)
    with target.open("wb") as file:
        writer: Any = Writer(file)  # its methods are not all typed
        writer.start(library="orch")
        writer.add_metadata("orch-run", {name: str(value) for name, value in content.facts.items()})
        numbers = _registered(writer, channels)
        for first in range(0, len(times), BATCH):
            rows = slice(first, first + BATCH)
            batches = [[*map(_bytes, channel.messages(rows))] for channel in channels]
            for row, time in enumerate(times[rows]):
                for number, batch in zip(numbers, batches, strict=True):
                    if row < len(batch):
                        writer.add_message(number, time, batch[row], time, first + row)
        writer.finish()


def _registered(writer: Any, channels: Sequence[Channel]) -> list[int]:
    """Ids of the channels in the file: one for each topic; a schema is written once."""
    schemas: dict[str, int] = {}
    topics: dict[str, int] = {}
    for channel in channels:
        title = channel.schema["title"]
        if title not in schemas:
            schemas[title] = writer.register_schema(title, "jsonschema", _bytes(channel.schema))
        if channel.topic not in topics:
            topics[channel.topic] = writer.register_channel(channel.topic, "json", schemas[title])
    return [topics[channel.topic] for channel in channels]


def _bytes(message: Any) -> bytes:
    return json.dumps(message, ensure_ascii=False, separators=(",", ":")).encode()


def _component(content: Content, component: str) -> Channel:
    """The signals of a component: {"eta": {"x": ...}} of vehicle1.eta.x."""
    signals = content.of(component)
    paths = _paths([signal.variable for signal in signals])
    columns = [signal.values for signal in signals]
    schema = {"title": f"orch.{component}", **_nested([*zip(paths, map(_schema, signals), strict=True)], _as_object)}

    def messages(rows: slice) -> list[Any]:
        lists = [_listed(values[rows]) for values in columns]
        return [_nested([*zip(paths, row, strict=True)]) for row in zip(*lists, strict=True)]

    return Channel(f"/{component}", schema, messages)


def _paths(names: Sequence[str]) -> list[list[str]]:
    """Nested keys: eta and x of eta.x; the whole name as one key where eta itself is a signal."""
    prefixes = {name: {name[:i] for i, letter in enumerate(name) if letter == "."} for name in names}
    return [[name] if prefixes[name] & set(names) else name.split(".") for name in names]


def _nested(leaves: Sequence[tuple[Sequence[str], Any]], wrap: Callable[[Any], Any] = lambda tree: tree) -> Any:
    """A tree of leaves, each at its keys; every node through `wrap`."""
    tree: dict[str, Any] = {}
    below: dict[str, list[tuple[Sequence[str], Any]]] = {}
    for (first, *rest), leaf in leaves:
        if rest:
            below.setdefault(first, []).append((rest, leaf))
            tree.setdefault(first, None)
        else:
            tree[first] = leaf
    return wrap(tree | {first: _nested(inner, wrap) for first, inner in below.items()})


def _as_object(properties: dict[str, Any]) -> dict[str, Any]:
    return {"type": "object", "properties": properties}


def _schema(signal: Signal) -> dict[str, Any]:
    description = signal.long_name if signal.unit == "1" else f"{signal.long_name} [{signal.unit}]"
    schema: dict[str, Any] = {"type": TYPES[signal.kind]}
    for _ in range(signal.values.ndim - 1):
        schema = {"type": "array", "items": schema}
    return {**schema, "description": description}


def _listed(values: Table) -> list[Any]:
    """As JSON can hold them: null for nan and infinities."""
    if values.dtype.kind == "f" and not np.isfinite(values).all():
        values = np.where(np.isfinite(values), values.astype(object), None)  # type: ignore[call-overload]
    listed: list[Any] = values.tolist()
    return listed


def _vehicles(content: Content, times: Sequence[int], taken: set[str]) -> Iterator[Channel]:
    """What the 3D panel draws of each vehicle."""
    frames = unique("/tf", taken)
    for vehicle in vehicles(content.run):
        name, eta = vehicle.name, vehicle.eta
        yield Channel(unique(f"/{name}/pose", taken), foxglove.POSE, _poses(eta, times, foxglove.pose))
        if all(axis in vehicle.eta_d for axis in AXES):
            topic = unique(f"/{name}/desired_pose", taken)
            yield Channel(topic, foxglove.POSE, _poses(vehicle.eta_d, times, foxglove.pose))
        yield Channel(unique(f"/{name}/track", taken), foxglove.TRACK, _track(eta, times))
        yield Channel(frames, foxglove.FRAME, _poses(eta, times, _frame_of(name)))


def _frame_of(name: str) -> Callable[[int, Any], Any]:
    return lambda time, pose: foxglove.frame(time, name, pose)


def _poses(
    eta: Mapping[str, Reals], times: Sequence[int], message: Callable[[int, Any], Any]
) -> Callable[[slice], list[Any]]:
    # Without jumps of the angles, quaternions keep their sign from row to row.
    smooth = {axis: np.unwrap(eta[axis]) if axis in ANGLE_AXES else eta[axis] for axis in AXES}

    def messages(rows: slice) -> list[Any]:
        poses = foxglove.poses({axis: smooth[axis][rows] for axis in AXES})
        return [message(time, pose) for time, pose in zip(times[rows], poses, strict=True)]

    return messages


def _track(eta: Mapping[str, Reals], times: Sequence[int]) -> Callable[[slice], list[Any]]:
    """The whole track, as one message with the first row."""

    def messages(rows: slice) -> list[Any]:
        if rows.start:
            return []
        chosen = np.linspace(0, len(times) - 1, min(len(times), LONGEST_TRACK)).astype(int)
        return [foxglove.track(times[0], foxglove.poses({axis: eta[axis][chosen] for axis in AXES}))]

    return messages
