from elbow import BEND


def twice(x):
    return 2 * x + BEND
