"""The runs of the thesis's chapter 5, and the signals that are needed of them."""
