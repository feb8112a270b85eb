"""Many runs of one experiment: designed, run on many processes, and compared by paired statistics."""
