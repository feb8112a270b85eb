"""Records for eyes and for other tools: figures, tables, pages, exports."""
