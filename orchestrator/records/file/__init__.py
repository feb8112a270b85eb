"""One record, as docs/record.md describes it.

`recorder.writing` writes it: `provenance` says what is known at the start, `datasets` what it will hold, `room` keeps
room on the disk, `hdf5` knows the quirks of the library.  `run.Run` reads it, with `access` while it is being written.
"""
