"""Records for readers and for other tools: figures, tables, HTML pages, exports."""
