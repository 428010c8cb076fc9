"""Reads a data set of `hydrograd generate` with h5py and with LagrangeBench's own H5Dataset.

Not part of the tests. Needs: pip install numpy h5py; for the second part jax and `pip install --no-deps lagrangebench`
(scripts/peers/run.sh makes such an environment: ~/.cache/hydrograd/peers/bin/python).

    hydrograd generate heated-channel --trajectories 4/2/2 --out /tmp/heated
    python3 scripts/read_dataset.py /tmp/heated

LagrangeBench's reader is the file lagrangebench/data/data.py of the installed package, unchanged. The rest of the package
(training, three frameworks of graph networks) is not imported: where torch is missing, its `Dataset`, an empty base class,
is stood in for, and so is the list of particle types.
"""

import enum
import importlib.util
import json
import sys
import types
from pathlib import Path

import h5py
import numpy as np

FLUID, SOLID_WALL, MOVING_WALL = 0, 1, 2


def displacements(position, metadata):
    """Steps from frame to frame, minimum image in periodic directions, in double precision."""
    step = np.diff(position.astype(np.float64), axis=0)
    bounds = np.asarray(metadata["bounds"])
    for d, periodic in enumerate(metadata["periodic_boundary_conditions"][: step.shape[-1]]):
        if periodic:
            size = bounds[d, 1] - bounds[d, 0]
            step[..., d] -= size * np.round(step[..., d] / size)
    return step


def read_with_h5py(folder: Path) -> None:
    metadata = json.loads((folder / "metadata.json").read_text())
    bounds = np.asarray(metadata["bounds"])
    velocity, acceleration = [], []
    for split in ("train", "valid", "test"):
        with h5py.File(folder / f"{split}.h5") as file:
            assert list(file) == [f"{i:05}" for i in range(metadata[f"num_trajs_{split}"])], list(file)
            for name, group in file.items():
                position, kind = group["position"][:], group["particle_type"][:]
                frames, particles, dimension = position.shape
                assert position.dtype == np.float32 and kind.dtype == np.int32 and kind.shape == (particles,)
                assert group["position"].compression == "gzip" and group["position"].shuffle
                assert dimension == metadata["dim"] and particles <= metadata["num_particles_max"]
                assert np.isfinite(position).all() and set(np.unique(kind)) <= {FLUID, SOLID_WALL, MOVING_WALL}
                assert (position >= np.float32(bounds[:, 0])).all() and (position <= np.float32(bounds[:, 1])).all()
                if "temperature" in group:
                    assert group["temperature"].shape == (frames, particles)
                    wall = group["wall_temperature"][:]
                    assert np.isnan(wall[kind == FLUID]).all()
                    assert group["wall_x"].shape == group["wall_offset"].shape
                for attribute in ("configuration", "seed", "version", "wall"):
                    assert attribute in group.attrs, attribute
                if split == "train":
                    step = displacements(position[:, kind == FLUID], metadata)
                    velocity.append(step.reshape(-1, dimension))
                    acceleration.append(np.diff(step, axis=0).reshape(-1, dimension))
            print(f"{split}: {len(file)} trajectories")
    for name, values in (("vel", velocity), ("acc", acceleration)):
        values = np.concatenate(values)
        deviation = values.std(axis=0)
        np.testing.assert_allclose(metadata[f"{name}_mean"], values.mean(axis=0), rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(metadata[f"{name}_std"], np.where(deviation < 1e-7, 1.0, deviation), rtol=1e-9)
    print("h5py: layout and statistics as written")


def lagrangebench_reader():
    """The class H5Dataset of the installed package; None if there is none."""
    try:
        package = importlib.util.find_spec("lagrangebench")
    except (ImportError, ValueError):
        package = None
    if package is None:
        return None
    if importlib.util.find_spec("torch") is None:
        torch, utils, data = (types.ModuleType(name) for name in ("torch", "torch.utils", "torch.utils.data"))
        data.Dataset = type("Dataset", (), {})
        sys.modules.update({"torch": torch, "torch.utils": utils, "torch.utils.data": data})
    parent, kinds = types.ModuleType("lagrangebench"), types.ModuleType("lagrangebench.utils")
    kinds.NodeType = enum.IntEnum("NodeType", {"PAD_VALUE": -1, "FLUID": 0, "SOLID_WALL": 1, "MOVING_WALL": 2})
    sys.modules.update({"lagrangebench": parent, "lagrangebench.utils": kinds})
    file = Path(package.submodule_search_locations[0]) / "data" / "data.py"
    spec = importlib.util.spec_from_file_location("lagrangebench.data", file)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.H5Dataset


def read_with_lagrangebench(folder: Path) -> None:
    reader = lagrangebench_reader()
    if reader is None:
        print("lagrangebench is not installed: pip install --no-deps lagrangebench")
        return
    windows = reader("train", str(folder), input_seq_length=6)
    with h5py.File(folder / "train.h5") as file:
        position = [group["position"][:] for group in file.values()]
        kind = [group["particle_type"][:] for group in file.values()]
    per_trajectory = len(position[0]) - 7
    assert len(windows) == per_trajectory * len(position), len(windows)
    for index in {0, 1, per_trajectory - 1, len(windows) // 2, len(windows) - 1}:
        trajectory, start = divmod(index, per_trajectory)
        found, kinds = windows[index]
        np.testing.assert_array_equal(found, position[trajectory][start : start + 7].transpose(1, 0, 2))
        np.testing.assert_array_equal(kinds, kind[trajectory])
    rollouts = reader("valid", str(folder), input_seq_length=6, is_rollout=True)
    with h5py.File(folder / "valid.h5") as file:
        for index, group in enumerate(file.values()):
            np.testing.assert_array_equal(rollouts[index][0], group["position"][:].transpose(1, 0, 2))
    print(f"LagrangeBench's H5Dataset: {len(windows)} training windows, {len(rollouts)} validation trajectories, the same numbers")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    read_with_h5py(Path(sys.argv[1]))
    read_with_lagrangebench(Path(sys.argv[1]))
