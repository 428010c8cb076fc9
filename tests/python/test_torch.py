"""The solver in PyTorch."""

import hydrograd
import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="PyTorch is not installed")


def design_of(scene):
    design = 0.2 * scene.bounds[:, 1] * np.cos(np.arange(len(scene.design)))
    return scene.nearest(design)


@pytest.mark.parametrize("which", ["scene", "moving"])
def test_gradient_is_ours_to_the_bit(which, request):
    scene = request.getfixturevalue(which)
    numbers = design_of(scene)
    q, gradient = scene.value_and_gradient(numbers)
    design = torch.tensor(numbers, requires_grad=True)
    found = hydrograd.torch.objective(scene)(design)
    found.backward()
    assert found.item() == q and found.dtype == torch.float64 and found.shape == ()
    np.testing.assert_array_equal(design.grad.numpy(), gradient)
    with torch.no_grad():
        assert hydrograd.torch.objective(scene)(design).item() == q


def test_it_is_part_of_a_loss(scene):
    numbers = design_of(scene)
    _, gradient = scene.value_and_gradient(numbers)
    parameters = torch.tensor(numbers / 0.01, requires_grad=True)
    q = hydrograd.torch.objective(scene)
    (3 * q(0.01 * parameters) + parameters.square().sum()).backward()
    np.testing.assert_allclose(parameters.grad.numpy(), 0.03 * gradient + 2 * parameters.detach().numpy(), rtol=1e-12)
    loss, of_loss = scene.loss_and_gradient(numbers)
    design = torch.tensor(numbers, requires_grad=True)
    found = hydrograd.torch.objective(scene, loss=True)(design)
    found.backward()
    assert found.item() == loss
    np.testing.assert_array_equal(design.grad.numpy(), of_loss)


def test_single_precision_is_rounded(scene):
    numbers = design_of(scene).astype(np.float32)
    q, gradient = scene.value_and_gradient(numbers)
    design = torch.tensor(numbers, requires_grad=True)
    found = hydrograd.torch.objective(scene)(design)
    found.backward()
    assert found.dtype == design.grad.dtype == torch.float32 and found.item() == np.float32(q)
    np.testing.assert_array_equal(design.grad.numpy(), gradient.astype(np.float32))


def test_differences_agree(moving):
    design = torch.tensor(design_of(moving), requires_grad=True)
    assert torch.autograd.gradcheck(hydrograd.torch.objective(moving), (design,), eps=1e-5, atol=1e-6, rtol=1e-2, fast_mode=True)


def test_second_derivatives_are_refused(scene):
    design = torch.tensor(design_of(scene), requires_grad=True)
    (first,) = torch.autograd.grad(hydrograd.torch.objective(scene)(design), design, create_graph=True)
    with pytest.raises(NotImplementedError, match="first derivatives only"):
        first.sum().backward()


def test_what_can_not_be_a_design_is_refused(scene):
    q = hydrograd.torch.objective(scene)
    with pytest.raises(TypeError, match="torch.Tensor"):
        q(scene.design)
    with pytest.raises(TypeError, match="floating-point"):
        q(torch.zeros(3, dtype=torch.int64))
    with pytest.raises(ValueError, match="a design of 3 numbers"):
        q(torch.zeros(3, dtype=torch.float64))
    with pytest.raises(ValueError, match="has no design"):
        hydrograd.torch.objective(hydrograd.Scene("taylor-green"))


def test_an_optimiser_improves_the_wall(scene):
    q = hydrograd.torch.objective(scene)
    design = torch.tensor(scene.design, requires_grad=True)
    optimiser = torch.optim.LBFGS([design], lr=0.2, max_iter=3, line_search_fn="strong_wolfe")
    before = q(design).item()

    def closure():
        optimiser.zero_grad()
        with torch.no_grad():
            design.copy_(torch.from_numpy(scene.nearest(design.numpy())))
        loss = -q(design)
        loss.backward()
        return loss

    optimiser.step(closure)
    assert q(torch.from_numpy(scene.nearest(design.detach().numpy()))).item() > before
