"""Data sets and rollouts."""

import json
import subprocess
import sys

import hydrograd
import numpy as np
import pytest


@pytest.fixture(scope="session")
def data(tmp_path_factory):
    """A small data set of the heated channel."""
    folder = tmp_path_factory.mktemp("data")
    sizes = ["--trajectories", "1/1/1", "--frames", "12", "--set", "resolution.dx=0.025"]
    command = [sys.executable, "-m", "hydrograd", "generate", "heated-channel", *sizes, "--out", str(folder)]
    subprocess.run(command, check=True, capture_output=True)
    return folder


def test_commands_that_start_themselves_again(data, tmp_path):
    def run(*arguments):
        command = [sys.executable, "-m", "hydrograd", *arguments, "--json"]
        done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)["result"]

    sizes = ["--set", "model.latent=8", "--set", "model.rounds=1", "--set", "validation_steps=4"]
    studied = run("study", "--data", str(data), "--grid", "seed=1,2", "--steps", "2", "--threads", "1", *sizes)
    assert studied["trained"] == 2 and [point["error"] for point in studied["points"]] == [None, None]
    measured = run("bench", "step", "--quick", "--filter", "950/f32/1/forward", "--threads", "1")
    assert measured["rows"] and all(row["ms_per_step"] > 0 for row in measured["rows"])
    # A job file starts it as it was started.
    printed = [sys.executable, "-m", "hydrograd", "slurm", "--print", "validate", "--quick"]
    text = subprocess.run(printed, capture_output=True, text=True, check=True, cwd=tmp_path).stdout
    assert f"set -- {sys.executable} -m hydrograd validate --quick" in text


def test_a_trajectory_is_arrays(data):
    found = hydrograd.read_trajectory(data, "test")
    t, n, d = found.position.shape
    assert t >= 12 and d == 2 and found.kind.shape == (n,) and found.temperature.shape == (t, n)
    assert found.position.dtype == np.float32 and found.frame_time > 0 and found.spacing == 0.025
    again = hydrograd.read_trajectory(str(data), "test", found.name)
    np.testing.assert_array_equal(again.position, found.position)


def test_constant_velocity_is_what_it_says(data):
    found = hydrograd.rollout("linear", data, frames=3, split="valid")
    truth = hydrograd.read_trajectory(data, "valid")
    assert found.predicted.position.shape == found.truth.position.shape == (3, *truth.position.shape[1:])
    np.testing.assert_array_equal(found.truth.position, truth.position[6:9])
    last, before = truth.position[5].astype(float), truth.position[4].astype(float)
    step = last - before
    # But for particles that went around the box, and walls, which take the truth.
    inside = (found.kind == 0) & (np.abs(step[:, 0]) < 0.1)
    moved = found.predicted.position[0] - last
    near = inside & (np.abs(moved[:, 0]) < 0.1)
    assert near.sum() > 10
    np.testing.assert_allclose(moved[near], step[near], atol=1e-12)
    assert found.broken is None and found.position_error.shape == (3,)


def test_the_own_model_rolls_out_as_the_command_line(data, tmp_path):
    with pytest.warns(UserWarning, match="predictions mean little"):
        # It was trained at half the spacing.
        found = hydrograd.rollout("heated-channel", data, frames=4)
    assert found.predicted.position.shape[0] == 4 and found.predicted.temperature is not None
    assert np.isfinite(found.predicted.position).all() and found.seconds > 0
    still = hydrograd.rollout("still", data, frames=4)
    assert (still.predicted.position[0] == still.predicted.position[-1])[still.kind == 0].all()


@pytest.mark.parametrize(
    ("arguments", "part"),
    [
        ({"model": "nothing.safetensors"}, "nothing.safetensors"),
        ({"data": "nowhere"}, "nowhere"),
        ({"split": "all"}, "train, valid, test"),
        ({"trajectory": "9"}, "no trajectory"),
        ({"frames": 0}, "at least 1"),
        ({"frames": 1000}, "too few"),
    ],
)
def test_wrong_input_is_a_value_error(data, arguments, part):
    with pytest.raises(ValueError, match=part):
        hydrograd.rollout(**{"model": "linear", "data": data, **arguments})
