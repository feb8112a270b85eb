OFFSET = 1


def offset_later():
    return OFFSET
