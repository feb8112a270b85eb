WORD = "nord"
