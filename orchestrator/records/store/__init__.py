"""A folder of records: `folder` finds one, `index` lists all, `filters` and `query` choose, `prune` deletes."""
