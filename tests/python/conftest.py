"""Scenes that run in a fraction of a second, built once."""

import os

# Threads that share a run wait for each other, so on a busy machine one is the quickest; no number depends on it.
for pool in ("CANDLE_NUM_THREADS", "RAYON_NUM_THREADS"):
    os.environ.setdefault(pool, "1")

import hydrograd  # noqa: E402
import pytest  # noqa: E402

#: The gradient of a run of moving particles, step by step.
MOVING = {"optimise.search": "scene", "time.end": 0.3, "objective.window": 0.1, "resolution.dx": 0.025}


@pytest.fixture(scope="session")
def scene() -> hydrograd.Scene:
    """The heated channel as `hydrograd optimize` searches in it: fixed particles, their steady state."""
    return hydrograd.Scene("heated-channel", settings={"resolution.dx": 0.025})


@pytest.fixture(scope="session")
def moving() -> hydrograd.Scene:
    """The heated channel with moving particles, a short run."""
    return hydrograd.Scene("heated-channel", settings=MOVING)
