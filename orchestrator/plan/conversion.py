"""Whether an output fits an input: types and units, and what turns one value into the other."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..experiment.experiment import ConnectionSpec
from ..fmu.units import Unit, conversion
from ..fmu.variables import DTYPES, FLOATS, OBJECTS, TRUTHS, WHOLE, Variable


def between(
    connection: ConnectionSpec, output: Variable, input: Variable, there: Mapping[str, Unit], here: Mapping[str, Unit]
) -> tuple[float, float]:
    """Factor and offset of one scalar connection.

    there, here: units that the FMUs of the output and of the input define.  Raises ValueError, with the reason, where
    the types or units do not fit.
    """
    scaled = connection.gain is not None or connection.offset is not None
    types = f"{input.name} is {input.type}, {output.name} is {output.type}"
    if not _holds(input, output):
        raise ValueError(types)
    if input.kind in FLOATS and output.kind in WHOLE and not scaled:
        raise ValueError(f"{types}; say gain = 1.0 to take it as it is")
    factor, offset = 1.0, 0.0
    # A gain may carry a unit: newtons for a command between -1 and 1.
    if connection.unit_check and not (scaled and output.unit in ("", "1")):
        try:
            factor, offset = conversion(output.unit, there, input.unit, here)
            if offset and output.relative != input.relative:
                raise ValueError("one is a difference (relativeQuantity), the other is not")
            if output.relative:
                offset = 0.0
        except ValueError as error:
            raise ValueError(
                f"{input.name} is in {input.unit!r}, {output.name} in {output.unit!r}: {error}; "
                "connect what fits, or say unit_check = false for this connection"
            ) from None
    gain = 1.0 if connection.gain is None else connection.gain
    factor, offset = gain * factor, gain * offset + (connection.offset or 0.0)
    if (factor, offset) != (1.0, 0.0) and (input.kind not in FLOATS or output.kind not in (*FLOATS, *WHOLE)):
        raise ValueError(f"{types}: only what need not be a whole number can be scaled")
    return factor, offset


def _holds(input: Variable, output: Variable) -> bool:
    """Whether the input can take every value of the output: exactly, but for a Float64 into a Float32."""
    if input.kind == output.kind or (input.kind in FLOATS and output.kind in FLOATS):
        return True
    if input.kind in OBJECTS or output.kind in OBJECTS or input.kind in TRUTHS or output.kind in TRUTHS:
        return input.kind in TRUTHS and output.kind in TRUTHS
    if output.kind in FLOATS:
        return False
    limits = np.iinfo(DTYPES[output.kind])
    low, high = int(limits.min), int(limits.max)
    if output.items:
        values = [value for _, value in output.items]
        low, high = min(values), max(values)
    if input.kind in FLOATS:
        return max(-low, high) <= 1 << (np.finfo(DTYPES[input.kind]).nmant + 1)
    limits = np.iinfo(DTYPES[input.kind])
    return limits.min <= low and high <= limits.max
