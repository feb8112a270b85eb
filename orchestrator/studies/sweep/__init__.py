"""Many runs of one experiment: designed, run on many processes, and judged by paired statistics."""
