"""Seeded random numbers: one independent stream for each seed, purpose, episode and block.

Philox is a counter-based generator, and each stream is a section of its counter. Streams therefore
do not overlap, do not depend on how much of another stream was read, and need not be stored.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cablebot_gym.kinematics import Array

BLOCK = 32
"""Number of rows of normal numbers in a block; a block is drawn at once."""


class Purpose(IntEnum):
    """Purpose of a stream. Give a new purpose a new number, so that the other streams do not
    change."""

    PAYLOAD = 0
    START = 1
    PARAMETERS = 2
    WRENCH_FACTOR = 3
    WRENCH = 4
    SENSORS = 5
    SENSOR_BIAS = 6
    DELAY = 7


NOISE = (Purpose.WRENCH, Purpose.SENSORS)
"""Purposes whose numbers are drawn for every control step, from the noise seed. All other numbers
are drawn once per episode, from the seed."""


class Streams:
    """Random streams of N environments. Environments with equal seeds and episode number read the
    same numbers."""

    def __init__(self, count: int) -> None:
        self.seeds: NDArray[np.object_] = np.zeros(count, object)
        """Seed of each environment, (N,)."""
        self.noise_seeds: NDArray[np.object_] = np.zeros(count, object)
        """Seed of the :data:`NOISE` of each environment, (N,)."""
        self.episodes = np.full(count, -1, np.int64)
        """Number of each environment's present episode since it was seeded, from 0; −1 before the
        first. Shape (N,)."""
        self._philox = np.random.Philox(0)
        self._state = self._philox.state
        self._generator = np.random.Generator(self._philox)

    def seed(self, env_indices: NDArray[np.int64], seeds: Sequence[int | None]) -> None:
        """Seeds each of the environments ``env_indices``; its next episode is number 0. None changes
        nothing.

        The seed is also the noise seed, until another one is set.
        """
        for env_index, seed in zip(env_indices, seeds, strict=True):
            if seed is not None:
                self.seeds[env_index] = self.noise_seeds[env_index] = seed
                self.episodes[env_index] = -1

    def start_episode(self, env_indices: NDArray[np.int64]) -> None:
        """Advances the environments ``env_indices`` to their next episode."""
        self.episodes[env_indices] += 1

    def state(self) -> tuple[NDArray[np.object_], NDArray[np.object_], NDArray[np.int64]]:
        """Copies of seeds, noise seeds and episode numbers, for :meth:`restore`."""
        return self.seeds.copy(), self.noise_seeds.copy(), self.episodes.copy()

    def restore(
        self, state: tuple[NDArray[np.object_], NDArray[np.object_], NDArray[np.int64]]
    ) -> None:
        """Restores seeds, noise seeds and episode numbers from :meth:`state`."""
        self.seeds, self.noise_seeds, self.episodes = state

    def uniform(self, env_indices: NDArray[np.int64], purpose: Purpose, size: int) -> Array:
        """Uniform numbers in [0, 1) for the present episodes of ``env_indices``, (len(env_indices),
        size)."""
        first = np.zeros(len(env_indices), np.int64)
        return self._draw(self._generator.random, env_indices, purpose, first, (size,))

    def normal(
        self,
        env_indices: NDArray[np.int64],
        purpose: Purpose,
        blocks: NDArray[np.int64],
        shape: tuple[int, ...],
    ) -> Array:
        """Standard normal numbers of one block for each environment, (len(env_indices),) + shape."""
        draw = self._generator.standard_normal
        return self._draw(draw, env_indices, purpose, blocks, shape)

    def _draw(
        self,
        draw: Callable[..., Any],
        env_indices: NDArray[np.int64],
        purpose: Purpose,
        blocks: NDArray[np.int64],
        shape: tuple[int, ...],
    ) -> Array:
        """Numbers of one block for each environment, (len(env_indices),) + shape."""
        numbers = np.empty((len(env_indices), *shape))
        first_rows: dict[tuple[int, int, int], int] = {}
        # arrays inside the state, which is set at the start of each stream
        counter = self._state["state"]["counter"]
        key = self._state["state"]["key"]
        seeds = self.seeds
        if purpose in NOISE:
            seeds = self.noise_seeds
        episodes = self.episodes[env_indices].tolist()
        streams = zip(seeds[env_indices], episodes, blocks.tolist(), strict=True)
        for row, (seed, episode, block) in enumerate(streams):
            first_row = first_rows.setdefault((seed, episode, block), row)
            if first_row < row:  # equal streams have equal numbers
                numbers[row] = numbers[first_row]
                continue
            key[:] = _key(seed)
            counter[:] = 0, block, episode, purpose
            self._philox.state = self._state
            draw(out=numbers[row])
        return numbers


def _key(seed: int) -> Sequence[int]:
    """Philox key, two words: the seed itself, or a hash of a seed of more than 128 bits."""
    if seed < 2**128:
        return seed & (2**64 - 1), seed >> 64
    return np.random.SeedSequence(seed).generate_state(2, np.uint64).tolist()


class NormalRows:
    """Standard normal numbers (N, width), new in every interval and drawn in blocks."""

    def __init__(self, streams: Streams, purpose: Purpose, count: int, width: int) -> None:
        self._streams = streams
        self._purpose = purpose
        self._values = np.zeros((count, BLOCK, width))
        self._blocks = np.full(count, -1, np.int64)  # blocks of the values; −1 for none

    def restart(self, env_indices: NDArray[np.int64]) -> None:
        """Discards the numbers drawn ahead; call it when the environments ``env_indices`` start an
        episode."""
        self._blocks[env_indices] = -1

    def at(self, env_indices: NDArray[np.int64], interval: NDArray[np.int64]) -> Array:
        """Numbers of ``env_indices``, (len(env_indices), width), each in its ``interval``, counted
        from 0 in each episode."""
        blocks = interval // BLOCK
        stale = np.flatnonzero(self._blocks[env_indices] != blocks)
        if stale.size:
            renewed = env_indices[stale]
            shape = self._values.shape[1:]
            self._values[renewed] = self._streams.normal(
                renewed, self._purpose, blocks[stale], shape
            )
            self._blocks[renewed] = blocks[stale]
        rows: Array = self._values[env_indices, interval % BLOCK]
        return rows
