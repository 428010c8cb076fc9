"""hydrograd's designs as a Tesseract."""

from pathlib import Path

import hydrograd
import numpy as np
import pytest


def inputs_of(scene, **more):
    design = scene.nearest(0.2 * scene.bounds[:, 1] * np.cos(np.arange(len(scene.design))))
    return {"scene": "heated-channel", "settings": {"resolution.dx": 0.025}, "design": design, **more}


def test_apply_and_vjp_are_ours_to_the_bit(scene):
    inputs = inputs_of(scene)
    q, gradient = scene.value_and_gradient(inputs["design"])
    found = hydrograd.tesseract.apply(inputs)
    assert list(found) == ["q"] and found["q"].shape == () and float(found["q"]) == q
    back = hydrograd.tesseract.vjp(inputs, {"design"}, {"q"}, {"q": np.asarray(-3.0)})
    np.testing.assert_array_equal(back["design"], -3.0 * gradient)
    assert hydrograd.tesseract.vector_jacobian_product is hydrograd.tesseract.vjp
    assert hydrograd.mosaic.apply is hydrograd.tesseract.apply, "the former name"
    assert hydrograd.tesseract.abstract_eval(inputs) == {"q": {"shape": (), "dtype": "float64"}}


def test_wrong_names_are_refused(scene):
    inputs = inputs_of(scene)
    with pytest.raises(ValueError, match="unknown input 'colour'"):
        hydrograd.tesseract.apply({**inputs, "colour": 1})
    with pytest.raises(ValueError, match="'settings' can not be differentiated"):
        hydrograd.tesseract.vjp(inputs, {"settings"}, {"q"}, {"q": 1.0})
    with pytest.raises(ValueError, match="'t' can not be differentiated"):
        hydrograd.tesseract.vjp(inputs, {"design"}, {"t"}, {"t": 1.0})
    assert hydrograd.tesseract.vjp(inputs, set(), {"q"}, {"q": 1.0}) == {}
    assert not hydrograd.tesseract.vjp(inputs, {"design"}, set(), {})["design"].any()


def test_it_is_a_tesseract(scene, tmp_path: Path):
    core = pytest.importorskip("tesseract_core", reason="tesseract-core[runtime] is not installed")
    pytest.importorskip("tesseract_core.runtime", reason="tesseract-core[runtime] is not installed")
    api = tmp_path / "tesseract_api.py"
    api.write_text("from hydrograd.tesseract import *\n")
    inputs = inputs_of(scene)
    q, gradient = scene.value_and_gradient(inputs["design"])
    tesseract = core.Tesseract.from_tesseract_api(api)
    assert float(tesseract.apply(inputs)["q"]) == q
    back = tesseract.vector_jacobian_product(inputs, ["design"], ["q"], {"q": np.float64(2.0)})
    np.testing.assert_array_equal(back["design"], 2.0 * gradient)


CHANNEL = """
scene = "custom"
method.name = "fixed"
region = { size = [0.6, 0.4], acceleration = [1.0, 0.0] }
resolution = { dx = 0.04 }
objective = { kind = "drag" }
[[shapes]]
kind = "disc"
centre = [0.25, 0.2]
radius = 0.06
[[variables]]
number = "shapes[0].radius"
lower = 0.05
upper = 0.08
"""


def test_scenes_of_ones_own_and_all_figures(tmp_path):
    own = tmp_path / "own.toml"
    own.write_text(CHANNEL)
    inputs = {"scene": str(own), "figures": True}
    found = hydrograd.tesseract.apply(inputs)
    assert found["figures"]["flow_rate"] > 0 and abs(found["figures"]["shapes"][0]["force"][0] - found["q"]) < 1e-12
    back = hydrograd.tesseract.vjp({**inputs, "design": [0.06]}, {"design"}, {"q"}, {"q": 2.0})
    ends = [float(hydrograd.tesseract.apply({**inputs, "design": [0.06 + h]})["q"]) for h in (1e-4, -1e-4)]
    np.testing.assert_allclose(back["design"], [2 * (ends[0] - ends[1]) / 2e-4], rtol=1e-4)
    moving = {"scene": "heated-channel", "figures": True, "settings": {"resolution.dx": 0.025, "time.end": 0.2, "objective.window": 0.1}}
    found = hydrograd.tesseract.apply(moving)
    assert found["figures"]["flow_rate"] > 0 and found["q"] > 0
