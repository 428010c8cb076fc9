"""Configuration, simulation, gradients, optimisation."""

import json
import os
import pickle
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import hydrograd
import numpy as np
import pytest

ROOT = Path(__file__).parents[2]


def test_built_in_scenes_are_listed():
    names = hydrograd.scenes()
    assert {"heated-channel", "taylor-green", "custom"} <= set(names)
    assert all(names.values()) and hydrograd.presets()
    assert hydrograd.__version__ in (ROOT / "Cargo.toml").read_text()


def test_settings_of_every_type_arrive():
    settings = {
        "resolution.dx": np.float64(0.025),
        "optimise.epochs": np.int64(7),
        "optimise.method": "adam",
        "optimise.memory": "20MB",
        "design.nodes": None,
        "objective": {"window": 0.25},
    }
    scene = hydrograd.Scene("heated-channel", settings=settings, **{"run.seed": 3})
    assert all(line in scene.text for line in ("dx = 0.025", "epochs = 7", 'method = "adam"', "seed = 3", "window = 0.25"))
    assert "run.seed" in repr(scene)
    again = pickle.loads(pickle.dumps(scene))
    assert again.text == scene.text
    # Keywords win over settings, and lists are lists.
    offsets = np.linspace(0.0, 0.01, len(scene.design))
    scene = hydrograd.Scene(settings={"run.seed": 1, "design.nodes": scene.nodes}, **{"run.seed": 2, "design.offsets": offsets})
    assert "seed = 2" in scene.text
    np.testing.assert_array_equal(scene.design, offsets)
    with pytest.raises(TypeError, match="set"):
        hydrograd.Scene(settings={"run.seed": {1, 2}})


@pytest.mark.parametrize(
    ("scene", "settings", "parts"),
    [
        ("heated-chanel", {}, ["heated-chanel", "allowed:", "heated-channel"]),
        ("heated-channel", {"resolution.dy": 1}, ["resolution.dy", "allowed:"]),
        ("heated-channel", {"resolution.dx": -1}, ["resolution.dx", "-1", "allowed:"]),
        ("heated-channel", {"resolution.dx": "wide"}, ["resolution.dx", "wide"]),
        ("taylor-green", {"design.bound": 1}, ["design.bound", "taylor-green"]),
    ],
)
def test_wrong_configurations_are_value_errors(scene, settings, parts):
    with pytest.raises(ValueError) as error:
        hydrograd.Scene(scene, settings=settings)
    assert all(part in str(error.value) for part in parts), error.value


def test_a_file_is_a_scene(tmp_path):
    file = tmp_path / "my.toml"
    file.write_text(hydrograd.Scene(settings={"resolution.dx": 0.025}).text)
    scene = hydrograd.Scene(file)
    assert scene.name == "heated-channel" and "dx = 0.025" in scene.text


def test_a_design_knows_its_limits(scene):
    design, bounds, nodes = scene.design, scene.bounds, scene.nodes
    assert design.shape == nodes.shape and bounds.shape == (len(design), 2) and (bounds[:, 0] < bounds[:, 1]).all()
    assert (scene.symbol, scene.quantity, scene.variables, scene.nodes_z) == ("Q", "outflowing heat", [], None)
    # It is the caller's own.
    design[:] = 9
    assert (scene.design == 0).all()
    for bad, part in [(design[1:], "a design of"), (design, "out of bounds"), (design * np.nan, "not a number")]:
        with pytest.raises(ValueError, match=part):
            scene.value_and_gradient(bad)
    with pytest.raises(ValueError, match="one axis"):
        scene.value_and_gradient(design[None])
    with pytest.raises(ValueError, match="array of numbers"):
        scene.objective("flat")
    nearest = scene.nearest(design)
    assert (bounds[:, 0] <= nearest).all() and (nearest <= bounds[:, 1]).all()
    scene.wall(nearest)
    # Single precision rounds limits up.
    scene.objective(np.full(len(design), bounds[0, 1], dtype=np.float32))
    with pytest.raises(ValueError, match="has no design"):
        _ = hydrograd.Scene("taylor-green").design


def test_simulate_gives_arrays(moving):
    steps = []
    run = moving.simulate(frames=5, progress=lambda step, of: steps.append((step, of)))
    n = len(run.tag)
    assert run.position.shape == run.velocity.shape == (n, 2)
    assert all(a.shape == (n,) for a in (run.temperature, run.density, run.pressure, run.mass))
    assert steps[-1] == (run.step, run.step) and run.time == pytest.approx(0.3, rel=0.05)
    assert run.q == run.figures["q"] > 0 and run.is_fluid.any() and not run.is_fluid.all()
    assert np.isfinite(run.position).all() and run.velocity[run.is_fluid, 0].max() > 0
    # Views of numbers that were moved, not copied.
    assert run.position.base is not None and not run.position.flags.owndata
    frames = run.frames
    assert frames.position.shape == (len(frames.time), n, 2) and len(frames.time) >= 5
    np.testing.assert_array_equal(frames.position[-1], run.position)
    np.testing.assert_array_equal(frames.temperature[-1], run.temperature)
    assert (np.diff(run.history["time"]) > 0).all() and set(run.history) == {"time", "q", "flow_rate"}
    assert moving.simulate().frames is None


def test_simulate_is_the_command_line(moving, tmp_path):
    sets = [f"--set={key}={value}" for key, value in moving._arguments[2].items()]
    command = [sys.executable, "-m", "hydrograd", "simulate", *sets, "--out", str(tmp_path)]
    subprocess.run(command, check=True, capture_output=True)
    told = json.loads((tmp_path / "summary.json").read_text())
    run = moving.simulate()
    for key in ("q", "flow_rate", "mean_density", "u_max", "steps", "time_step"):
        assert run.figures[key] == told[key], key


def test_another_design_is_another_flow(moving):
    design = np.linspace(-0.01, 0.01, len(moving.design))
    run = moving.simulate(design)
    assert run.q != moving.simulate().q
    own = hydrograd.Scene(settings={**moving._arguments[2], "design.nodes": moving.nodes, "design.offsets": design})
    assert own.simulate().q == run.q


def test_a_flow_with_an_exact_solution():
    run = hydrograd.Scene("taylor-green", settings={"resolution.dx": 0.05, "time.end": 0.1}).simulate()
    assert run.q is None and run.temperature is None and 0 < run.figures["velocity_error"] < 0.1


def test_three_dimensions():
    settings = {"resolution.dx": 2 * np.pi / 16, "time.end": 0.1}
    run = hydrograd.Scene("taylor-green-3d", settings=settings).simulate(frames=2)
    assert run.position.shape[1] == 3 and run.frames.position.shape[2] == 3


@pytest.mark.parametrize("which", ["scene", "moving"])
def test_the_gradient_is_that_of_differences(which, request):
    scene = request.getfixturevalue(which)
    design = 0.2 * scene.bounds[:, 1] * np.sin(np.arange(len(scene.design)))
    design = scene.nearest(design)
    q, gradient = scene.value_and_gradient(design)
    assert gradient.shape == design.shape and gradient.dtype == np.float64
    assert scene.objective(design) == pytest.approx(q, rel=1e-12)
    k = len(design) // 2
    step = np.zeros_like(design)
    step[k] = 1e-5
    difference = (scene.objective(design + step) - scene.objective(design - step)) / 2e-5
    # A small entry is off by a share of the whole.
    assert gradient[k] == pytest.approx(difference, rel=1e-5, abs=1e-7 * np.linalg.norm(gradient))
    # The same numbers again, and by a number.
    np.testing.assert_array_equal(scene.vjp(design, -2.0), -2.0 * scene.value_and_gradient(list(design))[1])
    loss, of_loss = scene.loss_and_gradient(design)
    assert loss == pytest.approx(-q, rel=0.2) and np.dot(of_loss, gradient) < 0


def test_single_precision_is_a_setting(scene):
    single = hydrograd.Scene(settings={"resolution.dx": 0.025, "run.precision": "f32"})
    q, gradient = single.value_and_gradient()
    exact, derivative = scene.value_and_gradient()
    assert q == pytest.approx(exact, rel=1e-3) and q != exact
    assert np.linalg.norm(gradient - derivative) < 0.05 * np.linalg.norm(derivative)
    assert single.simulate().position.dtype == np.float64


def test_numbers_of_shapes_are_a_design():
    scene = hydrograd.Scene(ROOT / "data/scenes/examples/cylinder.toml", settings={"time.end": 0.2, "objective.window": 0.1})
    assert scene.variables and len(scene.variables) == len(scene.design)
    q, gradient = scene.value_and_gradient()
    assert np.isfinite(q) and (gradient != 0).all()
    design = scene.design
    design[0] += 0.1 if design[0] < 0.5 else -0.1
    assert scene.simulate(design).figures["q"] != scene.simulate(scene.design).figures["q"]


def test_optimise_improves_the_wall(scene, tmp_path):
    told = []
    found = scene.optimise(epochs=4, progress=lambda *epoch: told.append(epoch))
    assert found.q_best == max(found.q_per_epoch) > found.q_per_epoch[0]
    assert told == [(k + 1, 4, q) for k, q in enumerate(found.q_per_epoch)]
    assert found.designs.shape == (len(told), len(scene.design))
    np.testing.assert_array_equal(found.designs[found.best], found.design_best)
    assert scene.objective(found.design_best) == pytest.approx(found.q_best, rel=1e-12)
    assert "->" in repr(found)
    # As the command line does.
    command = ["optimize", "--set=resolution.dx=0.025", "--epochs=4", "--no-verify", f"--out={tmp_path}"]
    subprocess.run([sys.executable, "-m", "hydrograd", *command], check=True, capture_output=True)
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["offsets_best"] == found.design_best.tolist()
    assert summary["q_per_epoch"] == found.q_per_epoch.tolist()
    assert summary["loss_per_epoch"] == found.loss_per_epoch.tolist()
    assert summary["gradient_norm_per_epoch"] == found.gradient_norm_per_epoch.tolist()
    # From another one.
    other = scene.optimise(found.design_best, epochs=1)
    np.testing.assert_array_equal(other.designs, [found.design_best])


def test_optimise_by_a_learned_model_is_the_command_s(tmp_path):
    settings = {"optimise.dynamics": "surrogate", "surrogate.trust": "check", "surrogate.check_every": 2, "surrogate.steps": 2}
    found = hydrograd.Scene(settings=settings).optimise(epochs=2)
    command = ["optimize", "--epochs=2", "--no-verify", f"--out={tmp_path}", *(f"--set={key}={value}" for key, value in settings.items())]
    subprocess.run([sys.executable, "-m", "hydrograd", *command], check=True, capture_output=True)
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["best_epoch"] == found.best and summary["q"] == found.q_best
    for key, values in {
        "q_per_epoch": found.q_per_epoch,
        "q_predicted_per_epoch": found.q_predicted_per_epoch,
        "q_solver_per_epoch": found.q_solver_per_epoch,
    }.items():
        assert summary[key] == [None if np.isnan(x) else x for x in values.tolist()], key


def test_errors_of_figures_are_those_of_the_command():
    scene = hydrograd.Scene("taylor-green", **{"resolution.dx": 0.1, "time.steps": 20})
    found = scene.errors()
    energy = next(one for one in found["errors"] if one["name"] == "kinetic_energy")
    assert energy["value"] == found["kinetic_energy"] == pytest.approx(scene.simulate().figures["kinetic_energy"], rel=1e-12)
    assert 0 < energy["error"] < 0.5 * energy["value"]
    assert energy["error"] == pytest.approx(sum(energy["parts"].values()))
    with pytest.raises(ValueError, match="between 0 and 1"):
        scene.errors(accuracy=2.0)


def test_verify_finds_what_is_left_of_a_gain(moving):
    best = moving.nearest(moving.design + 0.005)
    shares = []
    found = moving.verify(best, progress=lambda share, of: shares.append(share / of))
    gains = [check["gain"] for check in found["verification"]]
    assert len(gains) == 5 and found["gain"] == gains[1]
    assert found["gain_survives"] == pytest.approx(found["gain"] - sum(found["gain_error_parts"].values()), abs=1e-15)
    assert found["proved"] == (found["gain_survives"] > 0)
    assert shares == sorted(shares) and found["verification_reference"] == "the first design"
    assert found["verification"][0]["q_best"] == pytest.approx(moving.objective(best), rel=1e-6)
    with pytest.raises(ValueError, match="a design of 2 numbers"):
        moving.verify([0.0, 0.0])


def test_scipy_improves_the_wall(scene):
    optimize = pytest.importorskip("scipy.optimize")

    def minus(design):
        q, gradient = scene.value_and_gradient(scene.nearest(design))
        return -q, -gradient

    found = optimize.minimize(minus, scene.design, jac=True, method="L-BFGS-B", bounds=scene.bounds, options={"maxiter": 3})
    assert -found.fun > scene.objective()


def test_divergence_says_where():
    settings = {"time.cfl": 4.0, "time.end": 2.0, "resolution.dx": 0.025, "method.name": "consistent"}
    scene = hydrograd.Scene(settings=settings)
    with pytest.raises(hydrograd.Diverged) as error:
        scene.simulate()
    found = error.value
    assert isinstance(found, RuntimeError) and "likely cause" in str(found) and "try:" in str(found)
    assert found.step > 0 and found.particle >= 0 and len(found.position) == 2 and found.quantity
    assert isinstance(found.value, float)


def test_an_error_in_the_callback_ends_the_run():
    scene = hydrograd.Scene(settings={"time.end": 1000})

    def stop(step, of):
        raise KeyError("enough")

    clock = time.monotonic()
    with pytest.raises(KeyError, match="enough"):
        scene.simulate(progress=stop)
    assert time.monotonic() - clock < 10


@pytest.mark.parametrize("what", ["simulate", "gradient", "steady", "optimise"])
def test_control_c_ends_a_run(what):
    """Each of these would take minutes."""
    settings = {
        "simulate": {"time.end": 1000},
        "gradient": {"time.end": 100, "optimise.search": "scene"},
        "steady": {"resolution.dx": 0.0025},
        "optimise": {"time.end": 100, "optimise.search": "scene"},
    }[what]
    call = {"simulate": "simulate", "optimise": "optimise"}.get(what, "value_and_gradient")
    code = f"""
import hydrograd, sys, time
scene = hydrograd.Scene(settings={settings!r})
scene.design
print("ready", flush=True)
try:
    scene.{call}()
except KeyboardInterrupt:
    print("stopped", flush=True)
# The process is as good as new.
assert hydrograd.Scene(settings={{"time.end": 0.1, "objective.window": 0.05, "resolution.dx": 0.025}}).simulate().q is not None
print("goes on")
"""
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "ready\n"
    time.sleep(1.5)
    assert process.poll() is None, "it was too quick to be stopped"
    clock = time.monotonic()
    process.send_signal(signal.SIGINT)
    assert process.stdout.readline() == "stopped\n"
    assert time.monotonic() - clock < 5
    assert process.stdout.readline() == "goes on\n" and process.wait(30) == 0


def test_the_interpreter_goes_on_meanwhile():
    """While a run computes, another thread of Python counts, and runs do not disturb each other."""
    scene = hydrograd.Scene(settings={"time.end": 2, "resolution.dx": 0.025})
    alone = scene.simulate()
    found, counted = [], [0]
    threads = [threading.Thread(target=lambda: found.append(scene.simulate())) for _ in range(2)]
    for thread in threads:
        thread.start()
    while any(thread.is_alive() for thread in threads):
        counted[0] += 1
        time.sleep(0.001)
    assert counted[0] > 20
    for run in found:
        np.testing.assert_array_equal(run.position, alone.position)


def test_progress_of_a_gradient():
    scene = hydrograd.Scene(settings={"time.end": 2, "optimise.search": "scene", "resolution.dx": 0.02})
    shares = []
    clock = time.monotonic()
    scene.value_and_gradient(progress=lambda share, of: shares.append(share / of))
    seconds = time.monotonic() - clock
    assert shares and shares == sorted(shares) and 0 < shares[0] and shares[-1] <= 1
    assert len(shares) <= 10 * seconds + 2


def test_threads_are_chosen_before_the_first_run():
    code = """
import hydrograd, numpy
hydrograd.set_threads(1)
scene = hydrograd.Scene(settings={"resolution.dx": 0.025})
print(repr(scene.value_and_gradient()[0]))
try:
    hydrograd.set_threads(2)
except ValueError as error:
    assert "first run" in str(error)
else:
    raise SystemExit(1)
"""
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert float(done.stdout) == hydrograd.Scene(settings={"resolution.dx": 0.025}).value_and_gradient()[0]


def test_the_command_line_comes_with_the_package():
    with tempfile.TemporaryDirectory() as folder:
        def run(*arguments):
            return subprocess.run([sys.executable, "-m", "hydrograd", *arguments], capture_output=True, text=True, cwd=folder)

        assert run("--version").stdout.split()[1] == hydrograd.__version__
        assert run("scenes").returncode == 0
        bad = run("simulate", "--set", "resolution.dx=-1")
        assert bad.returncode == 2 and "resolution.dx" in bad.stderr and not os.listdir(folder)


def test_a_steady_flow_of_a_dict_has_its_exact_gradient():
    scene = hydrograd.Scene(
        {
            "method": {"name": "fixed"},
            "region": {"size": [1.0, 0.4], "periodic": [True, False], "acceleration": [1.0, 0.0]},
            "fluid": {"viscosity": 0.006},
            "resolution": {"dx": 0.04},
            "objective": {"kind": "drag"},
            "shapes": [{"kind": "ellipse", "centre": [0.5, 0.2], "axes": [0.08, 0.05], "angle": 20}],
            "variables": [{"number": "shapes[0].axes[0]", "lower": 0.05, "upper": 0.1}, {"number": "shapes[0].angle", "lower": -40, "upper": 40}],
        }
    )
    flow = scene.steady()
    assert flow.variables == ["shapes[0].axes[0]", "shapes[0].angle"]
    assert flow.position.shape == flow.velocity.shape == (len(flow.pressure), 2)
    assert flow.objective == pytest.approx(flow.figures["shapes"][0]["force"][0])
    for k, step in enumerate([1e-5, 1e-2]):
        up, down = ([x + sign * step * (i == k) for i, x in enumerate(flow.numbers)] for sign in (1, -1))
        difference = (scene.steady(up, gradient=False).objective - scene.steady(down, gradient=False).objective) / (2 * step)
        assert flow.gradient[k] == pytest.approx(difference, rel=1e-5)
