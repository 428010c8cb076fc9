"""Flow from a velocity field to a velocity field, and its Tesseract."""

from pathlib import Path

import hydrograd
import numpy as np
import pytest


def vortices(n, dimension=2):
    """Those of Taylor and Green."""
    x = np.arange(n) * 2 * np.pi / n
    places = np.meshgrid(*[x] * dimension, indexing="ij")
    depth = np.cos(places[2]) if dimension == 3 else 1.0
    u, v = np.sin(places[0]) * np.cos(places[1]) * depth, -np.cos(places[0]) * np.sin(places[1]) * depth
    return np.stack([u, v] + [0 * u] * (dimension - 2), axis=-1)


def test_vortices_decay():
    start = vortices(16)
    flow = hydrograd.periodic_flow(start, viscosity=0.05, time=1.0)
    np.testing.assert_allclose(flow.velocity, start * np.exp(-0.1), atol=1e-13)
    assert flow.pressure.shape == (16, 16) and flow.temperature is None and np.isclose(flow.sizes.sum(), 1.0)
    fits = hydrograd.periodic_flow(start, viscosity=0.05, time=1.0, derivatives="fits")
    error = np.abs(fits.velocity - start * np.exp(-0.1)).max()
    assert 1e-6 < error < 1e-3
    # Nothing happens in no time, but that a divergence goes.
    still = hydrograd.periodic_flow(start, viscosity=0.05, time=0.0)
    np.testing.assert_allclose(still.velocity, start, atol=1e-14)


@pytest.mark.parametrize("dimension", [2, 3])
def test_gradients_are_those_of_differences(dimension):
    rng = np.random.default_rng(3)
    n = 8 if dimension == 2 else 6
    start = vortices(n, dimension) + 0.2 * rng.standard_normal((n,) * dimension + (dimension,))
    temperature = rng.standard_normal((n,) * dimension)
    weights, warm = rng.standard_normal(start.shape), rng.standard_normal(temperature.shape)
    more = {"buoyancy": ([0.3] * dimension, 0.1), "step": 0.05}

    def run(velocity=0.0, temperature_by=0.0, viscosity=0.0, diffusivity=0.0, force=0.0, time=0.0):
        return hydrograd.periodic_flow(
            start + velocity,
            temperature=temperature + temperature_by,
            viscosity=0.03 + viscosity,
            diffusivity=0.02 + diffusivity,
            force=np.array([0.1] * dimension) + force,
            time=0.2 * (1 + time),
            **{**more, "step": 0.05 * (1 + time)},
        )

    def value(flow):
        return np.sum(weights * flow.velocity) + np.sum(warm * flow.temperature)

    found = run().vjp(weights, warm)
    assert found.velocity.shape == start.shape and found.temperature.shape == temperature.shape
    ways = {
        "velocity": rng.standard_normal(start.shape),
        "temperature_by": rng.standard_normal(temperature.shape),
        "viscosity": 1.0,
        "diffusivity": 1.0,
        "force": rng.standard_normal(dimension),
        "time": 1.0,
    }
    for name, way in ways.items():
        h = 1e-4
        difference = (value(run(**{name: h * way})) - value(run(**{name: -h * way}))) / (2 * h)
        by = getattr(found, name.removesuffix("_by"))
        exact = np.sum(by * way) * (0.2 if name == "time" else 1.0)
        assert abs(exact - difference) < 1e-6 * max(1.0, abs(difference)), name


def test_wrong_input_is_refused():
    start = vortices(8)
    wrong = [
        (start[..., 0], {}, "[N, N, 2]"),
        (start[:4, :4], {}, "5 particles or more"),
        (start * np.nan, {}, "finite numbers"),
        (start, {"viscosity": -1.0}, "viscosity = -1"),
        (start, {"time": -1.0}, "time = -1"),
        (start, {"size": [1.0, 2.0]}, "same spacing"),
        (start, {"tolerance": 0.0}, "tolerance = 0"),
        (start, {"derivatives": "guesses"}, "spectral, fits"),
        (start, {"force": [1.0]}, "force"),
        (start, {"temperature": np.zeros(3)}, "temperature of shape"),
    ]
    for field, more, message in wrong:
        with pytest.raises(ValueError, match=message.replace("[", r"\[").replace("]", r"\]")):
            hydrograd.periodic_flow(field, **{"viscosity": 0.01, "time": 0.1, **more})
    flow = hydrograd.periodic_flow(start, viscosity=0.01, time=0.1)
    with pytest.raises(ValueError, match="none without heat"):
        flow.vjp(start, temperature=start[..., 0])
    with pytest.raises(ValueError, match="that of the flow"):
        hydrograd.periodic_flow(start, viscosity=0.01, time=0.1).vjp(start[1:])


def api():
    pytest.importorskip("tesseract_core.runtime", reason="tesseract-core[runtime] is not installed")
    return Path(hydrograd.__file__).parent / "navier_stokes_grid" / "tesseract_api.py"


def test_it_is_a_tesseract():
    path = api()
    from tesseract_core import Tesseract

    tesseract = Tesseract.from_tesseract_api(path)
    start = vortices(8).astype(np.float32)[:, :, None, :]
    inputs = {"v0": start, "viscosity": np.float32([0.05]), "dt": np.float32([0.1]), "steps": 5, "domain_extent": 2 * np.pi}
    result = np.asarray(tesseract.apply(inputs)["result"])
    assert result.dtype == np.float32 and result.shape == start.shape
    np.testing.assert_allclose(result, start * np.exp(-0.05), atol=1e-6)
    back = tesseract.vector_jacobian_product(inputs, ["v0", "viscosity", "dt"], ["result"], {"result": 2 * result})
    assert np.asarray(back["v0"]).shape == start.shape
    energy = float((result.astype(float) ** 2).sum())
    np.testing.assert_allclose(back["viscosity"], [-4 * 0.5 * energy], rtol=1e-5)
    np.testing.assert_allclose(back["dt"], [-4 * 0.05 * 5 * energy], rtol=1e-5)
    for more, message in [
        ({"boundary_conditions": {"x_lo": {"type": "neumann"}}}, "boundary_conditions.x_lo"),
        ({"inflow_profile": np.ones(8, np.float32)}, "inflow_profile"),
    ]:
        with pytest.raises(Exception, match=message):
            tesseract.apply({**inputs, **more})


def around(profile, **more):
    face = {"type": "no_slip"}
    return {
        "v0": np.full((32, 32, 1, 2), 0.5, np.float32),
        "viscosity": np.float32([0.0025]),
        "dt": np.float32([0.02]),
        "steps": 200,
        "domain_extent": 1.0,
        "boundary_conditions": {"y_lo": face, "y_hi": face},
        "obstacle": {"shape": "cylinder", "center": [0.5, 0.5], "radius": 0.05},
        "inflow_profile": profile.astype(np.float32),
        **more,
    }


def test_a_body_has_a_drag_and_its_gradient():
    path = api()
    from tesseract_core import Tesseract

    tesseract = Tesseract.from_tesseract_api(path)
    flat = np.full(32, 0.5)
    found = tesseract.apply(around(flat))
    # Finite volumes on 256 x 256 cells (Mosaic's task drag_opt): 0.0346.
    drag = float(np.asarray(found["drag"])[0])
    assert abs(drag / 0.0346 - 1) < 0.03
    result = np.asarray(found["result"])
    assert not result[16, 16].any() and abs(result[3, 16, 0, 0] - 0.5) < 0.1 and abs(result[10, 0, 0, 0]) < 0.05
    back = tesseract.vector_jacobian_product(around(flat), ["inflow_profile", "v0", "viscosity"], ["drag"], {"drag": np.float32([1.0])})
    gradient = np.asarray(back["inflow_profile"], dtype=float)
    assert not np.asarray(back["v0"]).any() and gradient[12:20].min() > 2 * np.abs(gradient[:8]).max()
    way = np.cos(np.arange(32.0) / 3)
    ends = [float(np.asarray(tesseract.apply(around(flat + h * way))["drag"])[0]) for h in (0.02, -0.02)]
    np.testing.assert_allclose((ends[0] - ends[1]) / 0.04, gradient @ way, rtol=2e-3)
    ends = [float(np.asarray(tesseract.apply(around(flat, viscosity=np.float32([nu])))["drag"])[0]) for nu in (0.00255, 0.00245)]
    np.testing.assert_allclose((ends[0] - ends[1]) / 0.0001, float(np.asarray(back["viscosity"])[0]), rtol=2e-3)
    for more, message in [
        ({"viscosity": np.float32([0.0001])}, "Reynolds number of 500"),
        ({"boundary_conditions": {}}, "y_lo"),
        ({"obstacle": {"shape": "box", "radius": 0.1}}, "two half_widths"),
        ({"inflow_profile": None, "boundary_conditions": {"x_lo": {"type": "no_slip"}, "y_lo": {"type": "no_slip"}, "y_hi": {"type": "no_slip"}}}, "x_lo"),
        ({"inflow_profile": None, "v0": np.zeros((32, 32, 1, 2), np.float32)}, "at rest"),
        ({"v0": np.zeros((8, 8, 8, 3), np.float32)}, "two dimensions"),
    ]:
        with pytest.raises(Exception, match=message):
            tesseract.apply(around(flat, **more))
    with pytest.raises(Exception, match="derivative by dt"):
        tesseract.vector_jacobian_product(around(flat), ["dt"], ["result"], {"result": np.ones_like(result)})
    # The derivative of the field.
    weights = np.sin(np.arange(result.size)).reshape(result.shape).astype(np.float32)
    back = tesseract.vector_jacobian_product(around(flat), ["inflow_profile"], ["result"], {"result": weights})
    sums = [np.sum(weights * np.asarray(tesseract.apply(around(flat + h * way))["result"], dtype=float)) for h in (0.02, -0.02)]
    np.testing.assert_allclose((sums[0] - sums[1]) / 0.04, np.asarray(back["inflow_profile"], dtype=float) @ way, rtol=5e-3)
    # A run that is too short to become steady: the mean of its last half.
    short = [tesseract.apply(around(flat + h * way, steps=10)) for h in (0.0, 0.02, -0.02)]
    ends = [float(np.asarray(run["drag"])[0]) for run in short]
    assert 1.1 * drag < ends[0] < 1.4 * drag
    back = tesseract.vector_jacobian_product(around(flat, steps=10), ["inflow_profile"], ["drag"], {"drag": np.float32([1.0])})
    np.testing.assert_allclose((ends[1] - ends[2]) / 0.04, np.asarray(back["inflow_profile"], dtype=float) @ way, rtol=5e-3)


@pytest.mark.parametrize("obstacle", [{"shape": "cylinder", "radius": 0.1}, {"shape": "box", "half_widths": [0.1, 0.15]}])
def test_a_flow_that_nothing_drives_slows_down_behind_a_body(obstacle):
    path = api()
    from tesseract_core import Tesseract

    tesseract = Tesseract.from_tesseract_api(path)
    x, y = np.meshgrid(*[np.arange(16) / 16] * 2, indexing="ij")
    start = np.stack([1 + 0.2 * np.sin(2 * np.pi * x) * y, 0.1 * np.cos(2 * np.pi * x)], axis=-1)[:, :, None]

    def inputs(v0):
        case = around(np.zeros(1), v0=v0.astype(np.float32), viscosity=np.float32([0.01]), steps=20)
        return {**case, "inflow_profile": None, "obstacle": {"center": [0.5, 0.5], **obstacle}}

    found = tesseract.apply(inputs(start))
    result = np.asarray(found["result"], dtype=float)
    assert not result[8, 8].any() and float(np.asarray(found["drag"])[0]) > 0 and 0.3 < result[0, :, 0, 0].mean() < 0.9
    # Incompressible between walls: as much passes in front of the body as half a period away (by sums over 16 points, and a field between them).
    assert abs(result[0, :, 0, 0].mean() / result[4, :, 0, 0].mean() - 1) < 0.02
    way = np.cos(np.arange(start.size)).reshape(start.shape)
    weights = np.sin(np.arange(start.size)).reshape(start.shape).astype(np.float32)
    back = tesseract.vector_jacobian_product(
        inputs(start), ["v0"], ["result", "drag"], {"result": weights, "drag": np.float32([3.0])}
    )
    ends = [tesseract.apply(inputs(start + h * way)) for h in (0.01, -0.01)]
    sums = [np.sum(weights * np.asarray(e["result"], dtype=float)) + 3 * float(np.asarray(e["drag"])[0]) for e in ends]
    # Steps in time are chosen anew for each.
    np.testing.assert_allclose((sums[0] - sums[1]) / 0.02, np.sum(np.asarray(back["v0"], dtype=float) * way), rtol=1e-2)
