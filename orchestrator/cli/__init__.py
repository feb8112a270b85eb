"""The command line: words typed and words printed."""
