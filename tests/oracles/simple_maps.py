"""Alg. 2.1 of Alam 2018 in plain Python: the periodic groups of a simple map, cell after cell."""

import numpy as np


def simple_map_groups(image):
    """Find the group and the step of each cell, and the period of each group.

    Groups are numbered by their smallest cells.
    """
    image = np.asarray(image).tolist()
    group, step, cycles = [-1] * len(image), [0] * len(image), []
    for cell in range(len(image)):
        places = {}
        while group[cell] < 0 and cell not in places:
            places[cell] = len(places)
            cell = image[cell]
        path = list(places)
        if group[cell] < 0:
            path, cycle = path[: places[cell]], path[places[cell] :]
            for member in cycle:
                group[member] = len(cycles)
            cycles.append(cycle)
        for member in reversed(path):
            group[member], step[member] = group[image[member]], step[image[member]] + 1
    order = sorted(range(len(cycles)), key=lambda number: min(cycles[number]))
    period = np.array([len(cycles[number]) for number in order])
    return np.argsort(order)[group], np.array(step), period
