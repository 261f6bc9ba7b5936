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
def nearest_in_lists(queries, lists, starts, numbers, codes, found, likeness):
    """
    Find for each query the codes most like it in its lists.

    queries float32 (N, D) of whole numbers; lists int64 (N, L), the lists to look at; list k is
    numbers[starts[k]:starts[k + 1]], indices of codes uint8 (P, D). Fills found int32 (N, K) and
    likeness float32 (N, K), the dot products, the most alike first; what there are too few for
    stays: -1. Sums of up to 256 products are exact in float32, in whatever order.
    """
    size, most = queries.shape[1], found.shape[1]
    for query in range(len(queries)):
        for one in lists[query]:
            for place in range(starts[one], starts[one + 1]):
                number = numbers[place]
                alike = np.float32(0)
                for k in range(size):
                    alike += queries[query, k] * np.float32(codes[number, k])
                rank = most
                while rank > 0 and likeness[query, rank - 1] < alike:
                    rank -= 1
                if rank == most:
                    continue
                for after in range(most - 1, rank, -1):
                    likeness[query, after] = likeness[query, after - 1]
                    found[query, after] = found[query, after - 1]
                likeness[query, rank], found[query, rank] = alike, number
