WORD = "süd"
