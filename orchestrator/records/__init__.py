"""Records: what remains of a run.

file     one record: an HDF5 file, written while the run goes on, and read
store    the folder of records: found by run id, listed, chosen, deleted
compare  what several records say together
"""
