"""What a reproduction of the thesis writes: the thesis's figures, an index page and a summary."""
