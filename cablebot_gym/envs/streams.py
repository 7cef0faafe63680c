"""Seeded random numbers of many episodes: a stream for each lane's seed, purpose, episode and block.

Philox is a counter-based generator: each stream is a place in its counter, so that no stream depends on how much of
another one was read, none overlaps, and none has to be kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from cablebot_gym.kinematics import Array

BLOCK = 32
"""Rows of normal numbers drawn at once."""


class Purpose(IntEnum):
    """What a stream is for. A new purpose takes a new number, so that no other stream changes."""

    PAYLOAD = 0
    START = 1
    PARAMETERS = 2
    WRENCH_FACTOR = 3
    WRENCH = 4
    SENSORS = 5


class Streams:
    """Random streams of N lanes. Lanes of the same seed in the same episode read the same numbers."""

    def __init__(self, count: int) -> None:
        self.seeds: NDArray[np.object_] = np.zeros(count, object)
        """Of each lane."""
        self.episodes = np.full(count, -1, np.int64)
        """Number of each lane's present episode since it was seeded, from 0; −1 before the first."""
        self._philox = np.random.Philox(0)
        self._state = self._philox.state
        self._generator = np.random.Generator(self._philox)

    def seed(self, lanes: Sequence[int], seeds: Sequence[int]) -> None:
        """Restarts the streams of ``lanes``, each from its own of the seeds."""
        for lane, seed in zip(lanes, seeds, strict=True):
            self.seeds[lane] = seed
            self.episodes[lane] = -1

    def begin(self, lanes: NDArray[np.int64]) -> None:
        """Moves ``lanes`` on to their next episode."""
        self.episodes[lanes] += 1

    def standing(self) -> tuple[NDArray[np.object_], NDArray[np.int64]]:
        """Where the streams stand, for :meth:`restore`."""
        return self.seeds.copy(), self.episodes.copy()

    def restore(self, standing: tuple[NDArray[np.object_], NDArray[np.int64]]) -> None:
        """Puts the streams back to ``standing``, where they stood."""
        self.seeds, self.episodes = standing

    def uniform(self, lanes: NDArray[np.int64], purpose: Purpose, size: int) -> Array:
        """Numbers in [0, 1) for the lanes' present episodes, (len(lanes), size)."""
        return self._drawn(lanes, purpose, np.zeros(len(lanes), np.int64), (size,), normal=False)

    def normal(self, lanes: NDArray[np.int64], purpose: Purpose, blocks: NDArray[np.int64], width: int) -> Array:
        """Standard normal numbers, one block of :data:`BLOCK` rows for each lane, (len(lanes), BLOCK, width)."""
        return self._drawn(lanes, purpose, blocks, (BLOCK, width), normal=True)

    def _drawn(
        self,
        lanes: NDArray[np.int64],
        purpose: Purpose,
        blocks: NDArray[np.int64],
        shape: tuple[int, ...],
        *,
        normal: bool,
    ) -> Array:
        numbers = np.empty((len(lanes), *shape))
        known: dict[tuple[int, int, int], int] = {}
        counter, key = self._state["state"]["counter"], self._state["state"]["key"]
        draw = self._generator.standard_normal if normal else self._generator.random
        episodes, places = self.episodes[lanes].tolist(), blocks.tolist()
        for row, (seed, episode, block) in enumerate(zip(self.seeds[lanes], episodes, places, strict=True)):
            first = known.setdefault((seed, episode, block), row)
            if first < row:
                numbers[row] = numbers[first]
                continue
            key[:] = _key(seed)
            counter[:] = 0, block, episode, purpose
            self._philox.state = self._state
            draw(out=numbers[row])
        return numbers


def _key(seed: int) -> Sequence[int]:
    """Two words: the seed itself, or, of one that is longer, a hash."""
    if seed < 2**128:
        return seed & (2**64 - 1), seed >> 64
    return np.random.SeedSequence(seed).generate_state(2, np.uint64).tolist()


class NormalRows:
    """Standard normal numbers (N, width) that are new in every interval, read ahead in blocks."""

    def __init__(self, streams: Streams, purpose: Purpose, count: int, width: int) -> None:
        self._streams, self._purpose = streams, purpose
        self._values = np.zeros((count, BLOCK, width))
        self._blocks = np.full(count, -1, np.int64)

    def restart(self, lanes: NDArray[np.int64]) -> None:
        """Forgets what was read ahead, when a lane begins an episode."""
        self._blocks[lanes] = -1

    def at(self, lanes: NDArray[np.int64], interval: NDArray[np.int64]) -> Array:
        """Rows of ``lanes`` at their intervals, counted from 0 in each episode, (len(lanes), width)."""
        blocks = interval // BLOCK
        if (stale := np.flatnonzero(self._blocks[lanes] != blocks)).size:
            late = lanes[stale]
            self._values[late] = self._streams.normal(late, self._purpose, blocks[stale], self._values.shape[-1])
            self._blocks[late] = blocks[stale]
        rows: Array = self._values[lanes, interval % BLOCK]
        return rows
