"""Operators on tensors, as physics of deepinv, and back; learned codes."""

import copy
import pickle
import re
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest

import shadowgram as sg
from shadowgram.operators import SpectralResponse, as_deepinv, as_matrix, as_torch, from_torch, norm, stack
from shadowgram.spectral import torch_imager

NM = (450.0, 650.0)
PAGE = Path(__file__).parents[2] / "docs" / "torch.md"


@pytest.fixture(scope="module")
def torch():
    torch = pytest.importorskip("torch", reason="PyTorch is not installed: pip install shadowgram[torch]")
    with warnings.catch_warnings(), torch.autograd.forward_ad.dual_level():
        warnings.simplefilter("ignore")  # it warns of parts of its own when forward derivatives are first used
        torch.autograd.forward_ad.make_dual(torch.zeros(1), torch.zeros(1))
    return torch


@pytest.fixture(scope="module")
def deepinv(torch):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what its dependencies warn about when they are imported
        return pytest.importorskip("deepinv", reason="deepinv is not installed: pip install shadowgram[torch]")


def sscsi(shape, ratio=1, s=0.25):
    return sg.SSCSI(detector_shape=shape, detector_pitch=10.0 * ratio, code_pitch=10.0, mask_position=s, wavelengths=NM)


IMAGERS = {
    "cassi odd": sg.CASSI(cube_shape=(3, 5, 7), wavelengths=NM),
    "cassi even": sg.CASSI(cube_shape=(4, 6, 4), wavelengths=NM, shear="exact"),
    "dual odd": sg.DualCASSI(cube_shape=(3, 7, 5), wavelengths=NM),
    "dual even": sg.DualCASSI(cube_shape=(2, 4, 8), wavelengths=NM, shear="exact"),
    "colored odd": sg.ColoredCASSI(cube_shape=(5, 3, 3), wavelengths=NM),
    "colored even": sg.ColoredCASSI(cube_shape=(2, 4, 6), wavelengths=NM),
    "sscsi odd": sscsi((5, 9)),
    "sscsi even": sscsi((4, 8)),
    "super-resolving odd": sscsi((3, 5), ratio=2),
    "super-resolving even": sscsi((2, 6), ratio=2),
}
SMALL = {
    "cassi": sg.CASSI(cube_shape=(2, 1, 3), wavelengths=NM),
    "dual": sg.DualCASSI(cube_shape=(2, 2, 2), wavelengths=NM, shear="exact"),
    "colored": sg.ColoredCASSI(cube_shape=(2, 1, 2), wavelengths=NM),
    "sscsi": sscsi((1, 4), s=0.4),
    "super-resolving": sscsi((1, 2), ratio=2),
}


def code_of(imager, seed=0):
    return np.random.default_rng(seed).random((2, *imager.code_shape)) > 0.5


def operator(name):
    if name == "cxbi odd":
        return sg.CXBI(shape=(5, 7)).operator(np.random.default_rng(0).random((5, 27)) > 0.4)
    if name == "cxbi even":
        return sg.CXBI(shape=(4, 6), penumbra=(1.0, 0.5)).operator(np.random.default_rng(0).random((9, 4, 6)) > 0.4)
    if name == "stack":
        H = operator("cassi odd")
        return stack(H, SpectralResponse.pan(H.in_shape), noise=(2.0, 0.5))
    return IMAGERS[name].operator(code_of(IMAGERS[name]))


NAMES = (*IMAGERS, "cxbi odd", "cxbi even", "stack")


@pytest.mark.parametrize("name", NAMES)
def test_a_module_is_the_operator_and_its_gradient_the_adjoint(torch, name):
    A = operator(name)
    module, rng = as_torch(A), np.random.default_rng(1)
    x, y = rng.standard_normal((2, 3, *A.in_shape)), rng.standard_normal((2, 3, *A.out_shape))
    tensor = torch.tensor(x, requires_grad=True)
    images = module(tensor)
    assert images.shape == y.shape
    assert images.dtype == torch.float64
    (gradient,) = torch.autograd.grad(images, tensor, torch.tensor(y))
    for at in np.ndindex(2, 3):
        np.testing.assert_array_equal(images[at].detach().numpy(), A.forward(x[at]))
        np.testing.assert_array_equal(gradient[at].numpy(), A.adjoint(y[at]))
    np.testing.assert_array_equal(module.adjoint(torch.tensor(y)).numpy(), gradient.numpy())
    single = module(torch.tensor(x[0, 0], dtype=torch.float32))
    assert (single.dtype, single.shape) == (torch.float32, A.out_shape)


@pytest.mark.parametrize("name", ["cassi even", "dual odd", "sscsi odd", "super-resolving even", "cxbi odd"])
def test_gradients_by_finite_differences(torch, name):
    A = operator(name)
    x = torch.tensor(np.random.default_rng(0).random(A.in_shape), requires_grad=True)
    assert torch.autograd.gradcheck(as_torch(A), x, fast_mode=True, check_forward_ad=True)
    assert torch.autograd.gradgradcheck(as_torch(A), x, fast_mode=True)
    loss = (as_torch(A)(x) ** 2).sum() / 2
    (gradient,) = torch.autograd.grad(loss, x, create_graph=True)
    (curvature,) = torch.autograd.grad(gradient, x, torch.ones_like(x))
    np.testing.assert_allclose(curvature.numpy(), A.adjoint(A.forward(np.ones(A.in_shape))), rtol=1e-12)


def test_transforms_of_torch_func(torch):
    A = operator("dual odd")
    x = torch.tensor(np.random.default_rng(0).random((4, *A.in_shape)))
    torch.testing.assert_close(torch.func.vmap(as_torch(A), in_dims=0)(x), as_torch(A)(x))
    moved = torch.func.vmap(as_torch(A), in_dims=2, out_dims=1)(x.movedim(0, 2))
    torch.testing.assert_close(moved, as_torch(A)(x).movedim(0, 1))
    rows = torch.func.jacrev(as_torch(A))(x[0]).reshape(np.prod(A.out_shape), -1)
    np.testing.assert_allclose(rows.numpy(), as_matrix(A), atol=1e-12)


def test_tensors_are_not_copied_and_any_layout_is_taken(torch):
    from shadowgram.operators.torch_adapter import array_of

    x = torch.rand(3, 4)
    assert array_of(x).ctypes.data == x.data_ptr()
    A = operator("dual odd")
    crossed = torch.rand(*A.in_shape[::-1], dtype=torch.float64).permute(2, 1, 0)
    np.testing.assert_array_equal(as_torch(A)(crossed).numpy(), A.forward(crossed.numpy()))
    assert as_torch(A)(torch.zeros(0, *A.in_shape)).shape == (0, *A.out_shape)


def test_modules_are_copied_and_pickled(torch):
    module = as_torch(operator("sscsi odd"))
    x = torch.rand(module.operator.in_shape)
    for other in (copy.deepcopy(module), pickle.loads(pickle.dumps(module))):
        torch.testing.assert_close(other(x), module(x))
    assert list(module.parameters()) == []
    assert "SSCSIOperator: (3, 5, 9) → (2, 5, 9)" in repr(torch.nn.Sequential(module))


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda t, H: H(t.zeros(3, 7, 6)), ValueError, r"\(…, 3, 7, 5\), got \(3, 7, 6\)"),
        (lambda t, H: H(t.zeros(5)), ValueError, r"got \(5,\)"),
        (lambda t, H: H.adjoint(t.zeros(3, 7, 5)), ValueError, r"\(…, 2, 7, 5\)"),
        (lambda t, H: H(t.zeros(3, 7, 5, dtype=t.float16)), TypeError, "float16: convert it"),
        (lambda t, H: H(t.zeros(3, 7, 5, dtype=t.complex64)), TypeError, "complex64"),
    ],
)
def test_misuse(torch, call, error, message):
    with pytest.raises(error, match=message):
        call(torch, as_torch(operator("dual odd")))


@pytest.mark.parametrize("name", NAMES)
def test_physics_by_the_tests_of_deepinv(torch, deepinv, name):
    A = operator(name)
    physics = as_deepinv(A)
    assert isinstance(physics, deepinv.physics.LinearPhysics)
    image = A.in_shape if len(A.in_shape) == 3 else (1, *A.in_shape)
    x = torch.randn(2, *image, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    assert abs(float(physics.adjointness_test(x))) < 1e-12
    torch.manual_seed(0)
    root = {"squared": False} if "squared" in deepinv.physics.LinearPhysics.compute_norm.__code__.co_varnames else {}
    found = float(physics.compute_norm(x[:1], max_iter=2000, tol=1e-6, verbose=False, **root))
    largest = np.linalg.norm(as_matrix(A), 2)
    assert found == pytest.approx(largest if root else largest**2, rel=1e-3)
    np.testing.assert_array_equal(physics.A(x)[1].numpy(), A.forward(x[1].numpy().reshape(A.in_shape)))


def test_least_squares_of_deepinv(torch, deepinv):
    A = operator("dual odd")
    physics, rng = as_deepinv(A), np.random.default_rng(0)
    z, y = rng.standard_normal((1, *A.in_shape)), rng.standard_normal((1, *A.out_shape))
    found = physics.prox_l2(torch.tensor(z), torch.tensor(y), 0.5, max_iter=200, tol=1e-10)
    M = as_matrix(A)
    wanted = np.linalg.solve(0.5 * M.T @ M + np.eye(M.shape[1]), 0.5 * M.T @ y.ravel() + z.ravel())
    np.testing.assert_allclose(found.numpy().ravel(), wanted, atol=1e-6)


def test_noise_and_combinations_of_physics(torch, deepinv):
    A = operator("sscsi even")
    physics = as_deepinv(A, noise_model=deepinv.physics.GaussianNoise(sigma=0.1))
    x = torch.zeros(8, *A.in_shape)
    assert float(physics(x).std()) == pytest.approx(0.1, rel=0.1)
    assert float(physics(x, sigma=0.5).std()) == pytest.approx(0.5, rel=0.1)
    pan = as_deepinv(SpectralResponse.pan(A.in_shape))
    both = deepinv.physics.stack(physics, pan)
    assert [part.shape for part in both.A(x)] == [(8, 2, 4, 8), (8, 1, 4, 8)]
    with pytest.raises(ValueError, match=r"images \(batch, 2, 4, 8\), got \(8, 3, 4, 8\)"):
        physics(torch.zeros(8, 3, 4, 8))


@pytest.mark.parametrize("double", [False, True])
def test_physics_of_deepinv_as_an_operator(torch, deepinv, double):
    kernel = torch.tensor(np.random.default_rng(0).random((1, 1, 3, 3)), dtype=torch.float32)
    blur = deepinv.physics.Blur(filter=kernel, padding="circular")
    A = from_torch(blur.double() if double else blur, (2, 6, 7), (2, 6, 7))
    x = np.random.default_rng(1).random((2, 6, 7))
    wanted = blur.A(torch.tensor(x)[None].to(torch.float64 if double else torch.float32))[0].numpy()
    np.testing.assert_array_equal(A.forward(x), wanted)
    assert A.forward(x.astype(np.float32)).dtype == np.float32
    assert sg.testing.dot_test(A) < (1e-12 if double else 1e-5)
    singular = np.linalg.norm(as_matrix(A), 2)
    assert norm(A) == pytest.approx(singular, rel=1e-2)
    solution = sg.solve(sg.EigenTV(noise=1e-3, max_iter=5), A, A.forward(x))
    assert np.isfinite(solution.x).all()


def test_a_module_gets_its_adjoint_by_differentiation(torch):
    torch.manual_seed(0)
    A = from_torch(torch.nn.Conv2d(2, 3, 3, stride=2, bias=False).double(), (2, 7, 8), (3, 3, 3))
    assert sg.testing.dot_test(A) < 1e-12
    flip = from_torch(torch.nn.Upsample(scale_factor=2), (1, 3, 3), (1, 6, 6))  # without parameters: any precision
    assert sg.testing.dot_test(flip) < 1e-12
    assert sg.testing.dot_test(flip, np.float32) < 1e-5


def test_there_and_back(torch, deepinv):
    A = operator("cxbi odd")
    assert from_torch(as_torch(A), A.in_shape, A.out_shape) is A
    assert from_torch(as_deepinv(A), A.in_shape, A.out_shape) is A
    with_channel = from_torch(as_deepinv(A).double(), (1, *A.in_shape), A.out_shape)
    np.testing.assert_allclose(as_matrix(with_channel), as_matrix(A), atol=1e-12)
    np.testing.assert_allclose(as_matrix(with_channel.H), as_matrix(A).T, atol=1e-12)


def test_another_module_that_holds_an_operator(torch):
    class Twice(torch.nn.Module):
        def __init__(self, A):
            super().__init__()
            self.operator = A

        def forward(self, x):
            return 2 * as_torch(self.operator)(x)

    A = operator("dual odd")
    np.testing.assert_array_equal(as_matrix(from_torch(Twice(A), A.in_shape, A.out_shape)), 2 * as_matrix(A))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda nn: from_torch(nn.Conv2d(1, 1, 3), (1, 5, 5), (1, 3, 3)), "needs a linear module"),
        (lambda nn: from_torch(nn.ReLU(), (1, 5, 5), (1, 5, 5)), "needs a linear module"),
        (
            lambda nn: from_torch(nn.Flatten(), (1, 5, 5), (1, 5, 5)),
            r"gives \(1, 25\) for \(1, 1, 5, 5\), not \(1, 1, 5, 5\)",
        ),
    ],
)
def test_modules_that_are_no_operators(torch, make, message):
    with pytest.raises(ValueError, match=message):
        make(torch.nn)


@pytest.mark.parametrize("name", SMALL)
def test_gradients_by_the_code(torch, name):
    imager = SMALL[name]
    camera, rng = torch_imager(imager), np.random.default_rng(0)
    code = torch.tensor(rng.random((2, *imager.code_shape)), requires_grad=True)
    H = imager.operator(code_of(imager))
    cubes = torch.tensor(rng.random((3, *H.in_shape)), requires_grad=True)
    snapshots = torch.tensor(rng.random((3, *H.out_shape)), requires_grad=True)
    assert torch.autograd.gradcheck(camera, (code, cubes))
    assert torch.autograd.gradcheck(camera.adjoint, (code, snapshots))
    assert torch.autograd.gradgradcheck(camera, (code, cubes))
    assert torch.autograd.gradgradcheck(camera.adjoint, (code, snapshots))


@pytest.mark.parametrize("name", IMAGERS)
def test_a_camera_is_its_operator(torch, name):
    imager = IMAGERS[name]
    camera, code = torch_imager(imager), code_of(imager)
    H, rng = imager.operator(code), np.random.default_rng(0)
    for dtype, tolerance in ((np.float64, 1e-12), (np.float32, 1e-5)):
        cubes, snapshots = (rng.standard_normal((2, 3, *s)).astype(dtype) for s in (H.in_shape, H.out_shape))
        found = camera(torch.tensor(code.astype(dtype)), torch.tensor(cubes))
        back = camera.adjoint(torch.tensor(code.astype(dtype)), torch.tensor(snapshots))
        for at in np.ndindex(2, 3):
            np.testing.assert_allclose(found[at].numpy(), H.forward(cubes[at]), atol=tolerance, rtol=tolerance)
            np.testing.assert_allclose(back[at].numpy(), H.adjoint(snapshots[at]), atol=tolerance, rtol=tolerance)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda t, c: c(t.ones(7, 8), t.ones(3, 7, 5)), r"code must have the shape \(shot, 7, 7\), got \(7, 8\)"),
        (lambda t, c: c(t.ones(1, 7, 7), t.ones(3, 7, 6)), r"cubes must have the shape \(…, 3, 7, 5\)"),
        (lambda t, c: c.adjoint(t.ones(2, 7, 7), t.ones(1, 7, 5)), r"snapshots must have the shape \(…, 2, 7, 5\)"),
        (lambda t, c: c(t.ones(1, 7, 7), t.ones(3, 7, 5).double()), "same dtype"),
    ],
)
def test_misuse_of_a_camera(torch, call, message):
    with pytest.raises(ValueError, match=message):
        call(torch, torch_imager(IMAGERS["dual odd"]))


def test_the_page_runs_and_a_code_is_learned(torch, deepinv):
    names = {}
    for block in re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL):
        exec(compile(block, str(PAGE), "exec"), names)
    assert names["losses"][-1] < 0.5 * names["losses"][0]
    assert 0 <= names["code"].min() < names["code"].max() <= 1
    learned, boolean = (
        names["error"](names[code], names[step], names["unseen"]).item()
        for code, step in (("code", "step"), ("boolean", "boolean_step"))
    )
    assert learned < 0.8 * boolean


def test_without_pytorch_a_clear_message():
    """In a process in which PyTorch cannot be imported."""
    program = """
import sys
sys.modules["torch"] = None
import numpy as np, shadowgram as sg
imager = sg.CASSI(cube_shape=(2, 3, 4), wavelengths=(450, 650))
A = imager.operator(np.ones(imager.code_shape))
for call in (lambda: sg.operators.as_torch(A), lambda: sg.operators.as_deepinv(A), lambda: sg.spectral.torch_imager(imager)):
    try:
        call()
    except ValueError as error:
        print(error)
"""
    out = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
    assert out.splitlines() == ['this needs PyTorch: pip install "shadowgram[torch]"'] * 3
