"""Many runs that answer one question: is a result converged, what do a sweep or a search show, does the thesis hold?"""
