"""Compiled loops of an inverted index: which lists a descriptor is looked for in, and there."""
from neo_ros.machine.compiled import njit
from neo_ros.memory.kernels import FAST
import numpy as np


@njit(**FAST)
def greatest(values, columns):
    """
    Find where each row of values float32 (N, W), 0 or more, is greatest: columns (N, L), L <= W.

    The greatest first; of equal ones the first.
    """
    most = columns.shape[1]
    found = np.empty(most, np.float32)
    for row in range(len(values)):
        found[:] = -1
        for column in range(values.shape[1]):
            value = values[row, column]
            rank = most
            while rank > 0 and found[rank - 1] < value:
                rank -= 1
            for after in range(most - 1, rank, -1):
                found[after] = found[after - 1]
                columns[row, after] = columns[row, after - 1]
            if rank < most:
                found[rank], columns[row, rank] = value, column


@njit(**FAST)
def nearest_in_lists(queries, asking, bounds, starts, numbers, codes, found, likeness):
    """
    Find for each query the codes most like it in its lists.

    queries int16 (N, D). Of list k, of W, asking[bounds[k]:bounds[k + 1]] are the queries that
    look there, and numbers[starts[k]:starts[k + 1]] the indices of codes uint8 (P, D) in it. Fills
    found int32 (N, K) and likeness int32 (N, K), the dot products, the most alike first; what
    there are too few for stays: -1.
    """
    size, most = queries.shape[1], found.shape[1]
    for one in range(len(bounds) - 1):
        # A code that is in a cache is compared with all queries of its list.
        for place in range(starts[one], starts[one + 1]):
            number = numbers[place]
            for asked in range(bounds[one], bounds[one + 1]):
                query, alike = asking[asked], np.int32(0)
                for k in range(size):
                    # Of each sum and product numba would make 64 bits.
                    product = np.int32(np.int32(queries[query, k]) * np.int32(codes[number, k]))
                    alike = np.int32(alike + product)
                rank = most
                while rank > 0 and likeness[query, rank - 1] < alike:
                    rank -= 1
                if rank == most:
                    continue
                for after in range(most - 1, rank, -1):
                    likeness[query, after] = likeness[query, after - 1]
                    found[query, after] = found[query, after - 1]
                likeness[query, rank], found[query, rank] = alike, number
