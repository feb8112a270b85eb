"""How a sweep runs: in batches on Dask's workers, into records and a table, so that it can be resumed."""
