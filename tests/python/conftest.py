"""Scenes that run in a fraction of a second, built once."""

import hydrograd
import pytest

#: Coarser than a user would take it, so that a gradient takes a tenth of a second.
COARSE = {"resolution.dx": 0.04, "channel.length": 1.0}
#: The gradient of a run of moving particles, step by step.
MOVING = {"optimise.search": "scene", "time.end": 0.3, "objective.window": 0.1, "resolution.dx": 0.04}


@pytest.fixture(scope="session")
def scene() -> hydrograd.Scene:
    """The heated channel as `hydrograd optimize` searches in it: fixed particles, their steady state."""
    return hydrograd.Scene("heated-channel", settings={"resolution.dx": 0.04})


@pytest.fixture(scope="session")
def moving() -> hydrograd.Scene:
    """The heated channel with moving particles, a short run."""
    return hydrograd.Scene("heated-channel", settings=MOVING)
