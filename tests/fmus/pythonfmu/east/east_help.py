WORD = "east"
