"""
Compiled loops that find the depth of what contradicts the memory, from images of known poses.

A plane sweep (Collins 1996) with semi-global smoothing (Hirschmueller 2008). They run beside the
camera's loops, on one core: none of them is parallel.
"""
from typing import NamedTuple

from neo_ros.machine.compiled import njit
from neo_ros.memory.kernels import FAST
from neo_ros.memory.recent_kernels import between, project
import numpy as np

# Grey levels by which two images differ at most, per channel: more says no more.
MOST = np.float32(40)
# Where colours leap by so many grey levels, depths may leap at half the cost.
EDGE = np.float32(24)
# What a level of difference to the memory's depth costs where the image does not contradict it.
# At most; and at most where the image does.
ANCHOR, MOST_ANCHOR, LIKELIER = np.float32(4), np.float32(24), np.float32(3)


class Shots(NamedTuple):
    """
    N images of one camera, in the memory's exposure: float32 (N, h, w, 3), grey levels.

    R float32 (N, 3, 3), t float32 (N, 3): from the camera of the reference to them.
    """

    images: np.ndarray
    R: np.ndarray
    t: np.ndarray


@njit(**FAST)
def sweep(reference, rays, shots, camera, inverse, wanted, top, left, share, cost):
    """
    Compare a part of a reference image with other images for each inverse depth.

    reference float32 (h, w, 3), rays (h, w, 3), z = 1; camera a Pinhole; inverse (D,), 1 / metres;
    wanted bool (part's h, w): elsewhere nothing is compared, and every depth costs the same; (top,
    left): where the part begins. Fills cost (part's h, w, D), grey levels: the mean of the
    better share of the images that show a point; MOST where fewer than two do.
    """
    images, R, t = shots
    count, height, width = images.shape[0], images.shape[1], images.shape[2]
    half, third = np.float32(0.5), np.float32(1 / 3)
    found = np.empty(count, np.float32)
    for y in range(cost.shape[0]):
        for x in range(cost.shape[1]):
            if not wanted[y, x]:
                for level in range(len(inverse)):
                    cost[y, x, level] = MOST
                continue
            ray = rays[top + y, left + x]
            colour = reference[top + y, left + x]
            for level in range(len(inverse)):
                q = inverse[level]
                seen = 0
                for k in range(count):
                    z = (R[k, 2, 0] * ray[0] + R[k, 2, 1] * ray[1] + R[k, 2, 2] * ray[2]
                         + q * t[k, 2])
                    if z < np.float32(0.05):
                        continue
                    u = camera.fx * (R[k, 0, 0] * ray[0] + R[k, 0, 1] * ray[1]
                                     + R[k, 0, 2] * ray[2] + q * t[k, 0]) / z + camera.cx - half
                    v = camera.fy * (R[k, 1, 0] * ray[0] + R[k, 1, 1] * ray[1]
                                     + R[k, 1, 2] * ray[2] + q * t[k, 1]) / z + camera.cy - half
                    if u < 0 or v < 0 or u > width - 1 or v > height - 1:
                        continue
                    x0, y0 = min(int(u), width - 2), min(int(v), height - 2)
                    ax, ay = u - x0, v - y0
                    off = np.float32(0)
                    for c in range(3):
                        off += min(abs(between(images, k, y0, x0, ay, ax, c) - colour[c]), MOST)
                    off *= third
                    # Sorted as they come: they are few.
                    at = seen
                    while at > 0 and found[at - 1] > off:
                        found[at] = found[at - 1]
                        at -= 1
                    found[at] = off
                    seen += 1
                if seen < 2:
                    cost[y, x, level] = MOST
                    continue
                better = max(2, int(seen * share + half))
                total = np.float32(0)
                for k in range(better):
                    total += found[k]
                cost[y, x, level] = total / better


@njit(**FAST)
def anchor(cost, levels, contradicted):
    """
    Say where the memory has surfaces: levels (h, w) of inverse depth, below 0 = not known.

    Where the image contradicts it, they are as likely as others, and a little more.
    """
    for y in range(cost.shape[0]):
        for x in range(cost.shape[1]):
            if levels[y, x] < 0:
                continue
            most, share = MOST_ANCHOR, np.float32(0.5)
            if contradicted[y, x]:
                most, share = LIKELIER, np.float32(1)
            for level in range(cost.shape[2]):
                cost[y, x, level] = share * cost[y, x, level] + min(
                    ANCHOR * abs(level - levels[y, x]), most)


@njit(**FAST)
def _add_path(cost, picture, slant, leap, total, y, x, dy, dx, before, now):
    """Walk one path from (y, x) in steps of (dy, dx); see `smooth`."""
    height, width, levels = cost.shape
    for level in range(levels):
        before[level] = cost[y, x, level]
        total[y, x, level] += before[level]
    while True:
        py, px = y, x
        y, x = y + dy, x + dx
        if y < 0 or x < 0 or y >= height or x >= width:
            return
        apart = np.float32(0)
        for c in range(3):
            apart = max(apart, abs(picture[y, x, c] - picture[py, px, c]))
        most = max(leap * EDGE / (EDGE + apart), 2 * slant)
        least = before[0]
        for level in range(1, levels):
            least = min(least, before[level])
        for level in range(levels):
            best = min(before[level], least + most)
            if level > 0:
                best = min(best, before[level - 1] + slant)
            if level + 1 < levels:
                best = min(best, before[level + 1] + slant)
            now[level] = cost[y, x, level] + best - least
            total[y, x, level] += now[level]
        for level in range(levels):
            before[level] = now[level]


@njit(**FAST)
def smooth(cost, picture, slant, leap, total):
    """
    Add up the costs (h, w, D) along eight paths to each pixel into total, which is 0 before.

    A change of one level between neighbours costs `slant`, a greater one `leap`, less where
    picture, float32 (h, w, 3), leaps, too.
    """
    height, width, levels = cost.shape
    before, now = np.empty(levels, np.float32), np.empty(levels, np.float32)
    for y in range(height):
        _add_path(cost, picture, slant, leap, total, y, 0, 0, 1, before, now)
        _add_path(cost, picture, slant, leap, total, y, width - 1, 0, -1, before, now)
        for side in (-1, 1):
            # From the sides; the corners belong to the paths from above and below.
            edge = 0 if side > 0 else width - 1
            if y > 0:
                _add_path(cost, picture, slant, leap, total, y, edge, 1, side, before, now)
            if y < height - 1:
                _add_path(cost, picture, slant, leap, total, y, edge, -1, side, before, now)
    for x in range(width):
        for side in (-1, 0, 1):
            _add_path(cost, picture, slant, leap, total, 0, x, 1, side, before, now)
            _add_path(cost, picture, slant, leap, total, height - 1, x, -1, side, before, now)


@njit(**FAST)
def choose(total, cost, inverse, depth, error):
    """
    Take the level of the least total (h, w, D), interpolated: depth (h, w) metres.

    0 where it is the first or the last one: the least may lie beyond. error (h, w): what the
    images differ there by, grey levels.
    """
    levels = total.shape[2]
    for y in range(total.shape[0]):
        for x in range(total.shape[1]):
            best = 0
            for level in range(1, levels):
                if total[y, x, level] < total[y, x, best]:
                    best = level
            error[y, x] = cost[y, x, best]
            if best == 0 or best == levels - 1:
                depth[y, x] = 0
                continue
            q = inverse[best]
            low, mid, high = total[y, x, best - 1], total[y, x, best], total[y, x, best + 1]
            curve = low - 2 * mid + high
            if curve > 0:
                q += np.float32(0.5) * (low - high) / curve * (inverse[1] - inverse[0])
            depth[y, x] = 1 / q


class Views(NamedTuple):
    """
    N images as in Shots, and what each says of the scene.

    depths float32 (N, h, w): of what contradicts the memory, metres, 0 = nothing, or not known;
    remembered float32 (N, h, w): the memory's, 0 = unknown; contradicted bool (N, h, w).
    """

    images: np.ndarray
    depths: np.ndarray
    remembered: np.ndarray
    contradicted: np.ndarray
    R: np.ndarray
    t: np.ndarray


@njit(**FAST)
def confirm(reference, rays, depth, views, camera, same, most_error, confirmed, votes):
    """
    Let other images vote on what one shows where it contradicts the memory.

    reference float32 (h, w, 3), depth (h, w) metres, 0 = nothing. An image votes for a point if
    it has it at the same depth, to a share of `same`, and the same colour, to three times
    `most_error` grey levels; against it if it sees through it, or another colour there. Where it
    does not contradict the memory, what it sees is as far as the memory says; of another colour,
    or it says nothing.
    Fills confirmed (h, w), the mean of the depths that agree, and votes int8 (h, w, 2).
    """
    images, depths, remembered, contradicted, R, t = views
    height, width = depth.shape
    for y in range(height):
        for x in range(width):
            votes[y, x, 0] = votes[y, x, 1] = 0
            confirmed[y, x] = 0
            d = depth[y, x]
            if d <= 0:
                continue
            px, py, pz = rays[y, x, 0] * d, rays[y, x, 1] * d, rays[y, x, 2] * d
            total, count = d, 1
            for k in range(len(images)):
                u, v, z = project(camera, R, t, k, px, py, pz)
                if z < np.float32(0.05) or not (0 <= u < width and 0 <= v < height):
                    continue
                row, column = int(v), int(u)
                there = depths[k, row, column]
                own = contradicted[k, row, column]
                if not own:
                    there = remembered[k, row, column]
                if there <= 0 or there < z * (1 - same):
                    continue  # Not known, or hidden.
                off = np.float32(0)
                for c in range(3):
                    off = max(off, abs(images[k, row, column, c] - reference[y, x, c]))
                if not own and there > z * (1 + same) and off <= most_error:
                    continue  # What came may have the colour of what is behind it.
                if there > z * (1 + same) or off > 3 * most_error:
                    votes[y, x, 1] += 1
                    continue
                votes[y, x, 0] += 1
                if own:
                    total += d * there / z
                    count += 1
            confirmed[y, x] = total / count
