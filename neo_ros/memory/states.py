"""Things that have changed, and in which of their states images show them."""
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import cv2
from neo_ros.geometry import Intrinsics
from neo_ros.memory.changes import cell_keys, Changes
from neo_ros.memory.kernels import Pinhole
from neo_ros.memory.patch import EVERY, PARTS, Patch
from neo_ros.memory.state_kernels import Look, NEITHER, OTHER, STAYS, weigh
from neo_ros.memory.stereo import Shot
from neo_ros.memory.turn import PAUSE_NS, Record, Turn
import numpy as np

# Of 26 neighbours of a cell those that come behind it.
BEHIND = [offset for offset in product((0, 1), (-1, 0, 1), (-1, 0, 1)) if offset > (0, 0, 0)]


@dataclass(frozen=True)
class StateThresholds:
    """What belongs to one thing, and when it is in another state."""

    # Metres: what lies in neighbouring cells of an image is one part.
    cell: float = 0.2
    # A part belongs to the thing that has this share of its cells, and most of them.
    shared: float = 0.3
    # A pixel has a colour if one around it, to so many pixels, has it to so many grey levels; it
    # has another one if none has it to the second.
    aside: int = 2
    alike: float = 10.0
    different: float = 25.0
    # A thing is in another state if so many samples say so, in so many images at least the last;
    # and this share of all that say anything, and so many times as many as say that it stays.
    # Chairs of the demo flat that were put back: 200 and more in 36 images, shares of 0.6 to 0.9,
    # 3.1 to 26 times as many; a chair that stood, while another came before it: 638, 0.64, 2.0
    # times. Slivers beside a door that was closed: up to 99, before samples were weighed.
    least: int = 100
    images: int = 2
    least_an_image: int = 4
    # Of what has few samples so many times as many as it has, and half of them in an image, are
    # enough: slivers that were learnt beside a chair go with it when it is back.
    each: float = 2.0
    share: float = 0.5
    times: float = 3.0


def parts_of(points: np.ndarray, least: int, limits: StateThresholds) -> np.ndarray:
    """
    Tell which of world points (N, 3) are connected: their part, uint8 (N,), the largest first.

    Parts of fewer points, and what are too many, are one part, the last.
    """
    cells, inverse = np.unique(np.floor(points / limits.cell).astype(np.int64), axis=0,
                               return_inverse=True)
    number = {tuple(cell): index for index, cell in enumerate(cells.tolist())}
    root = list(range(len(cells)))

    def top(index: int) -> int:
        while root[index] != index:
            root[index] = index = root[root[index]]
        return index

    for (x, y, z), index in number.items():
        for right, down, far in BEHIND:
            other = number.get((x + right, y + down, z + far))
            if other is not None:
                root[top(other)] = top(index)
    found, part, count = np.unique(np.array([top(index) for index in range(len(cells))])[
        inverse.ravel()], return_inverse=True, return_counts=True)
    order = np.argsort(-count, kind='stable')
    name = np.full(len(found), PARTS - 1, np.uint8)
    large = order[:PARTS - 1][count[order[:PARTS - 1]] >= least]
    name[large] = np.arange(len(large))
    return name[part.ravel()]


class Things:
    """
    What changes are changes of: parts of patches that lie at the same place are one thing.

    of int64 (PARTS * patches,): the thing that each part belongs to, -1: there is no such part.
    The other arrays are of the samples of all parts, see Samples; part int64 (N,): which one.
    """

    def __init__(self, patches: Sequence[Patch], limits: StateThresholds = StateThresholds()
                 ) -> None:
        samples = [patch.samples for patch in patches]
        self.points, self.colours, self.depths = (
            np.concatenate([getattr(one, name) for one in samples])
            for name in ('points', 'colours', 'depths'))
        self.part = np.concatenate([PARTS * index + one.parts.astype(np.int64)
                                    for index, one in enumerate(samples)])
        self.of = np.full(PARTS * len(patches), -1)
        keys = cell_keys(np.concatenate([one.nearer for one in samples]), limits.cell)
        order = np.argsort(self.part, kind='stable')
        owner: dict[int, int] = {}
        things = 0
        if not len(order):
            return  # Patches of a few pixels, between which the samples lie.
        for some in np.split(order, np.flatnonzero(np.diff(self.part[order])) + 1):
            cells = np.unique(keys[some]).tolist()
            owners = [owner[cell] for cell in cells if cell in owner]
            most = max(set(owners), key=lambda one: (owners.count(one), -one), default=-1)
            if most < 0 or owners.count(most) < limits.shared * len(cells):
                most, things = things, things + 1
            self.of[self.part[some[0]]] = most
            for cell in cells:
                owner.setdefault(cell, most)


def find_turn(shots: Sequence[Shot], changes: Changes, camera: Intrinsics, batch: int,
              begun: int, limits: StateThresholds = StateThresholds()) -> Turn | None:
    """
    Return which parts images show in another state that was known before; None: none.

    begun: the first batch of this visit. What was learnt since, and just now, is asked of no
    image: it is one state with what is learnt next. So is what turned: something else that is
    seen there is learnt. Where a turn explains the most of what contradicts, nothing does any
    more: it is taken out of the shots.
    """
    if not changes.patches or not any(shot.contradicted.any() for shot in shots):
        return None
    things = Things(changes.patches, limits)
    hidden = changes.hidden
    # What was seen is asked for where it is hidden, else what was before.
    other = np.where(things.of < 0, -1, np.where(hidden < 0, 1, 0)).astype(np.int8)
    just_now = shots[0].stamp_ns - PAUSE_NS

    def of_now(record: Record) -> bool:
        return record.batch >= begun and record.stamp_ns > just_now

    learnt = np.repeat([of_now(patch) for patch in changes.patches], PARTS) & (hidden < 0)
    turns = [number for number, record in enumerate(changes.records)
             if isinstance(record, Turn) and of_now(record)]
    other[learnt | np.isin(hidden, turns) | np.isin(changes.again, turns)] = -1
    looks = [_look(shot) for shot in shots]
    votes = np.stack([_weigh(things, other, look, camera, limits)[0] for look in looks])
    turned = _turned(votes, things.of, changes, limits) & (other >= 0)
    if not turned.any():
        return None
    other[~turned] = -1
    for shot, look in zip(shots, looks):
        explained = _explained(_weigh(things, other, look, camera, limits)[1], look.contradicted)
        shot.contradicted[explained] = False
        shot.depth[explained] = 0
    return Turn(np.flatnonzero(turned).astype(np.uint32), shots[-1].stamp_ns, batch)


def _turned(votes: np.ndarray, things: np.ndarray, changes: Changes, limits: StateThresholds
            ) -> np.ndarray:
    """Return which parts turn, bool (parts,), by votes (images, parts, 3) of parts of things."""
    turned = np.zeros(len(things), bool)
    stamps = np.repeat([patch.stamp_ns for patch in changes.patches], PARTS)
    sizes = np.concatenate([np.bincount(samples.parts[samples.depths[:, 1] > 0], minlength=PARTS)
                            for samples in (patch.samples for patch in changes.patches)])
    for thing in np.unique(things[votes[..., OTHER].any(0)]):
        own = np.flatnonzero(things == thing)
        hidden = changes.hidden[own]
        # What one turn hid is shown again together.
        states = [own[hidden == turn] for turn in np.unique(hidden[hidden >= 0])]
        # What was learnt on a visit goes together with what was learnt later.
        shown = own[hidden < 0]
        times = np.unique(stamps[shown])
        begins = times[np.r_[True, np.diff(times) > PAUSE_NS][:len(times)]]
        states += [shown[stamps[shown] >= begin] for begin in begins]
        scores = [_score(votes[:, state], sizes[state], limits) for state in states]
        best = max(range(len(states)), key=lambda index: (scores[index], index))
        if scores[best] > 0:
            turned[states[best]] = True
    # What stands close together may be taken for one thing: what images say of a part itself
    # keeps it hidden, or turns it alone.
    own = votes.sum(0)
    turned[(changes.hidden >= 0) & (own[:, STAYS] > limits.times * own[:, OTHER])] = False
    for part in np.flatnonzero(own[:, OTHER] >= np.minimum(limits.least, limits.each * sizes)):
        turned[part] |= _score(votes[:, [part]], sizes[[part]], limits) > 0
    # Less that is shown of a thing may explain it all: nothing of it comes in the same turn.
    turned[(changes.hidden >= 0) & np.isin(things, things[turned & (changes.hidden < 0)])] = False
    return turned


def _score(votes: np.ndarray, sizes: np.ndarray, limits: StateThresholds) -> float:
    """
    Return how much speaks for another state; 0: not enough.

    votes (images, parts, 3); sizes (parts,): of how many samples the other state is known.
    """
    counts, size = votes.sum(1), float(sizes.sum())
    other, all_of_them = float(counts[:, OTHER].sum()), float(counts.sum())
    enough = (other >= max(min(limits.least, limits.each * size), limits.share * all_of_them,
                           limits.times * counts[:, STAYS].sum())
              and (counts[:, OTHER] >= min(limits.least_an_image, size / 2)).sum()
              >= limits.images and size > 0)
    return 2 * other - all_of_them if enough else 0


def _explained(said: np.ndarray, contradicted: np.ndarray) -> np.ndarray:
    """Return what another state explains of what contradicts, bool (h, w); said: as `weigh`'s."""
    count, labels = cv2.connectedComponents(contradicted.view(np.uint8))
    near = cv2.dilate(said[OTHER].view(np.uint8), np.ones((2 * EVERY + 1,) * 2, np.uint8)) > 0
    area, covered, speaks, speaks_not = (np.bincount(labels[where], minlength=count) for where in (
        contradicted, near & contradicted, said[OTHER], said[NEITHER]))
    # Between the samples nothing is asked; of half a region they tell.
    whole = 2 * covered > area
    return contradicted & (speaks > speaks_not)[labels] & (near | whole[labels])


def _look(shot: Shot) -> Look:
    T = shot.pose.inverse()
    return Look(shot.image, shot.depth, shot.contradicted,
                np.ascontiguousarray(T[:3, :3], np.float32),
                np.ascontiguousarray(T[:3, 3], np.float32))


def _weigh(things: Things, other: np.ndarray, look: Look, camera: Intrinsics,
           limits: StateThresholds) -> tuple[np.ndarray, np.ndarray]:
    """Return votes float32 (parts, 3), and where the image gives them, bool (3, h, w)."""
    votes = np.zeros((len(other), 3), np.float32)
    said = np.zeros((3, *look.depth.shape), bool)
    weigh(things.points, things.colours, things.depths, things.part, other, look,
          Pinhole(*map(np.float32, (camera.fx, camera.fy, camera.cx, camera.cy))),
          limits.aside, np.float32(limits.alike), np.float32(limits.different), votes, said)
    return votes, said
