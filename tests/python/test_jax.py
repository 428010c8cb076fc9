"""The solver in JAX."""

import subprocess
import sys

import hydrograd
import numpy as np
import pytest

jax = pytest.importorskip("jax", reason="JAX is not installed")
jax.config.update("jax_enable_x64", True)
jnp = jax.numpy


def design_of(scene):
    design = 0.2 * scene.bounds[:, 1] * np.cos(np.arange(len(scene.design)))
    return scene.nearest(design)


@pytest.mark.parametrize("which", ["scene", "moving"])
@pytest.mark.parametrize("compiled", [False, True], ids=["plain", "jit"])
def test_gradient_is_ours_to_the_bit(which, compiled, request):
    scene = request.getfixturevalue(which)
    numbers = design_of(scene)
    q, gradient = scene.value_and_gradient(numbers)
    function = hydrograd.jax.objective(scene)
    both = jax.value_and_grad(function)
    value, found = (jax.jit(both) if compiled else both)(jnp.asarray(numbers))
    assert float(value) == q and value.dtype == np.float64
    np.testing.assert_array_equal(np.asarray(found), gradient)
    assert float(function(numbers)) == q


def test_it_is_part_of_a_loss(scene):
    numbers = design_of(scene)
    q, gradient = scene.value_and_gradient(numbers)
    function = hydrograd.jax.objective(scene)
    found = jax.grad(lambda x: 3 * function(0.01 * x) + (x**2).sum())(numbers / 0.01)
    np.testing.assert_allclose(np.asarray(found), 0.03 * gradient + 200 * numbers, rtol=1e-12)
    loss, of_loss = scene.loss_and_gradient(numbers)
    value, found = jax.value_and_grad(hydrograd.jax.objective(scene, loss=True))(numbers)
    assert float(value) == loss
    np.testing.assert_array_equal(np.asarray(found), of_loss)


def test_vmap_goes_one_after_the_other(scene):
    numbers = design_of(scene)
    designs = np.stack([numbers, -numbers, 0 * numbers + 0.001])
    function = hydrograd.jax.objective(scene)
    values, gradients = jax.vmap(jax.value_and_grad(function))(designs)
    for design, value, gradient in zip(designs, values, gradients):
        q, own = scene.value_and_gradient(design)
        assert float(value) == q
        np.testing.assert_array_equal(np.asarray(gradient), own)


def test_what_can_not_be_a_design_is_refused(scene):
    function = hydrograd.jax.objective(scene)
    with pytest.raises(ValueError, match="one axis"):
        function(np.zeros((2, 3)))
    with pytest.raises(TypeError, match="floating-point"):
        function(np.zeros(3, dtype=int))
    with pytest.raises(Exception, match="a design of 3 numbers"):
        function(np.zeros(3)).block_until_ready()
    with pytest.raises(ValueError, match="has no design"):
        hydrograd.jax.objective(hydrograd.Scene("taylor-green"))
    with pytest.raises(Exception, match="JVP"):
        jax.hessian(function)(scene.design)


def test_single_precision_is_rounded_and_warned_of():
    code = """
import hydrograd, jax, numpy as np, warnings
scene = hydrograd.Scene(settings={"resolution.dx": 0.025})
function = hydrograd.jax.objective(scene)
with warnings.catch_warnings(record=True) as told:
    warnings.simplefilter("always")
    value, gradient = jax.value_and_grad(function)(scene.design.astype(np.float32))
    assert not told, told
    function(scene.design)
assert any("jax_enable_x64" in str(one.message) for one in told), told
q, own = scene.value_and_gradient()
assert value.dtype == np.float32 and float(value) == np.float32(q)
assert (np.asarray(gradient) == own.astype(np.float32)).all()
"""
    subprocess.run([sys.executable, "-c", code], check=True)
