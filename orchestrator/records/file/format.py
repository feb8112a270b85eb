"""What the format of a record is called, and the names in it that several modules need; docs/record.md describes it."""

from __future__ import annotations

import re

FORMAT = "orch-run"
FORMAT_VERSION = 2  # 1: metrics were of the rows, and there was no envelope
ID_LENGTH = 10  # hex digits of the digest that make a run id
ENVELOPE = "_envelope"  # group of the least and the largest values between rows
HEARD = "_heard"  # group of what live components received from outside

# What a link of HDF5, a variable of netCDF, or a dimension of the record itself cannot be called; see `link_of`.
ESCAPED = re.compile(r"[%/\x00-\x1f\x7f]|^ | \Z|^\.(?=\.*\Z)|^t(?=ime\Z)|_(?=dim[0-9]+\Z)")
VARIABLE = "variable"  # attribute of a data set whose link is not the name of the variable: that name


def link_of(variable: str) -> str:
    """What the data set of a variable is called in the group of its component: its name, but as `%2F` what cannot stand
    there.  `urllib.parse.unquote` is the way back.

    Escaped are `%` and `/`, control characters, a space at either end, and the first character of names that mean
    something else: a dot in names of dots, `t` of `time`, the dimension, and `_` of `_dim1`, the dimensions of arrays.
    """
    return ESCAPED.sub(lambda match: "".join(f"%{byte:02X}" for byte in match[0].encode()), variable)
