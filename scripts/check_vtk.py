"""Opens files written by hydrograd with the programs they are meant for.

Not part of the tests. Needs: pip install pyvista h5py safetensors numpy

    HYDROGRAD_SAMPLES=/tmp/samples cargo test --release io::samples_for_python
    python3 scripts/check_vtk.py /tmp/samples            # the samples above: every value is compared
    python3 scripts/check_vtk.py --series runs/x/particles.pvd   # any series: opened and listed
"""

import sys
from pathlib import Path

import numpy as np


def check_series_of_samples(folder: Path) -> None:
    import pyvista

    points = [[0.1, 1.1, 0.0], [0.2, 1.2, 0.0], [0.3, 1.3, 0.0]]
    reader = pyvista.get_reader(folder / "series.pvd")
    assert list(reader.time_values) == [0.25, 0.75], reader.time_values
    for time in reader.time_values:
        reader.set_active_time_value(time)
        mesh = reader.read()[0]
        assert mesh.n_points == mesh.n_verts == 3, mesh
        assert mesh.points.dtype == np.float64
        np.testing.assert_array_equal(mesh.points, points)
        np.testing.assert_array_equal(mesh["velocity"], [[1, -1, 0], [2, -2, 0], [3, -3, 0]])
        np.testing.assert_array_equal(mesh["temperature"], [1.0, 1.1, 1.23])
        assert mesh["tag"].dtype == np.uint8 and mesh["tag"].tolist() == [0, 1, 3]
        assert mesh.field_data["TimeValue"].tolist() == [time]

    three = pyvista.read(folder / "three.vtp")
    np.testing.assert_array_equal(three.points, [[0.1, 1.1, 0.1], [0.2, 1.2, 0.2], [0.3, 1.3, 0.3]])
    np.testing.assert_array_equal(three["velocity"][0], np.float32([1.1, 0.1, 1.1]))
    assert three["temperature"].dtype == np.float32
    assert pyvista.read(folder / "none.vtp").n_points == 0
    print("PyVista: points, arrays, times are right")


def check_state(path: Path) -> None:
    import h5py

    count = np.arange(2000)
    with h5py.File(path) as file:
        position = file["position"]
        assert position.shape == (2000, 2)
        assert position.compression == "gzip" and position.compression_opts == 4 and position.shuffle
        np.testing.assert_allclose(position[:, 0], np.sin(count), rtol=1e-14, atol=1e-15)
        np.testing.assert_allclose(file["velocity"][:, 1], 0.7 * np.sin(count), rtol=1e-14, atol=1e-15)
        for name in ("temperature", "density", "pressure", "mass"):
            assert file[name].shape == (2000,) and file[name].dtype == np.float64
        assert file["tag"].dtype == np.uint8 and file["tag"][5] == 1
        attributes = dict(file.attrs)
        assert attributes["time"] == 0.1 + 0.2 and attributes["step"] == 12345
        assert attributes["seed"] == 2**64 - 1 and attributes["dx"] == 0.02
        assert attributes["box_size"].tolist() == [1.0, 0.32]
        assert attributes["version"] == "0.1.0"
        assert attributes["configuration"].startswith("[fluid]\nviscosity = 0.01 # µ\n")
        assert len(attributes["configuration"]) == 5000 * len("[fluid]\nviscosity = 0.01 # µ\n")
    print("h5py: datasets and attributes are right")


def check_tensors(path: Path) -> None:
    from safetensors import safe_open

    with safe_open(path, "numpy") as file:
        assert sorted(file.keys()) == ["a_single", "counter", "empty", "position"]
        position = file.get_tensor("position")
        assert position.dtype == np.float64 and position.shape == (2, 3)
        np.testing.assert_array_equal(position, [[0.1, 1e-310, -0.0], [np.nan, np.inf, 6.0]])
        assert file.get_tensor("a_single").dtype == np.float32
        assert file.get_tensor("counter").item() == 2**64 - 1
        assert file.get_tensor("empty").shape == (0, 4)
        assert file.metadata() == {"config": '[a]\nb = "µ"', "version": "0.1.0", "z": ""}
    print("safetensors: tensors and metadata are right")


def list_series(path: Path) -> None:
    import pyvista

    reader = pyvista.get_reader(path)
    print(f"{path}: {len(reader.time_values)} frames")
    for time in reader.time_values:
        reader.set_active_time_value(time)
        mesh = reader.read()[0]
        ranges = {name: mesh.get_data_range(name) for name in mesh.array_names if name != "TimeValue"}
        print(f"  time {time:g}: {mesh.n_points} particles, bounds {mesh.bounds}, ranges {ranges}")


if __name__ == "__main__":
    if len(sys.argv) == 3 and sys.argv[1] == "--series":
        list_series(Path(sys.argv[2]))
    elif len(sys.argv) == 2:
        samples = Path(sys.argv[1])
        check_series_of_samples(samples)
        check_state(samples / "state.h5")
        check_tensors(samples / "checkpoint.safetensors")
    else:
        sys.exit(__doc__)
