"""Learned codes: an imager as a function of code and cube that PyTorch differentiates by both."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

from shadowgram.operators.torch_adapter import array_of, load_torch

from .code_gradient import CodedForm, CodedImager

if TYPE_CHECKING:
    from collections.abc import Callable

    from torch import Tensor  # pyright: ignore[reportMissingImports]
    from torch.nn import Module  # pyright: ignore[reportMissingImports]

_CODE, _CUBE, _SNAPSHOTS = range(3)


def torch_imager(imager: CodedImager) -> Module:
    """Imager as a `torch.nn.Module`, differentiable by the code as well as by the cube.

    Called with a code (shot, …) of `imager.code_shape` and cubes (…, band, y, x), it gives snapshots (…, shot, y, x): one code for
    a whole batch. Its method ``adjoint(code, snapshots)`` is the transpose for a given code, for unrolled solvers, and is
    differentiable too. Derivatives of any order; float32 and float64 are kept, and tensors on a GPU are computed on the processor.

    Parameters
    ----------
    imager : `SSCSI`, `CASSI`, `DualCASSI` or `ColoredCASSI`.

    Returns
    -------
    torch.nn.Module
        Without parameters: make the code one, such as ``torch.sigmoid(theta)``, which keeps it between closed and open. Values
        outside of [0, 1] are not refused. Code and cubes have the same dtype.

    Raises
    ------
    ValueError
        If PyTorch is missing, or, when called, if shapes or dtypes do not fit.
    TypeError
        If the imager is of another kind.

    Examples
    --------
    ::

        camera = sg.spectral.torch_imager(sg.CASSI(cube_shape=(24, 64, 64), wavelengths=(450, 650)))
        theta = torch.zeros(2, 64, 64, requires_grad=True)
        code = torch.sigmoid(theta)
        estimate = camera.adjoint(code, camera(code, cubes))
        ((estimate - cubes) ** 2).mean().backward()  # theta.grad
    """
    form = CodedForm.of(imager)
    load_torch()
    return _module_class()(form)


def _shape(form: CodedForm, slot: int) -> tuple[int, ...]:
    """Shape of code, cube or snapshots, without shots and batches."""
    return (form.code_shape, form.cube_shape, form.detector_shape)[slot]


def _derivative(form: CodedForm, slot: int, a: Tensor, b: Tensor) -> Tensor:
    """Derivative of T by what `slot` names; a and b are the other two, in the order code, cube, snapshots.

    Cubes and snapshots have the same batch axes, over which the derivative by the code is summed.
    """
    if slot == _CODE:
        batch, shots = a.shape[:-3].numel(), b.shape[-3]
        cubes = array_of(a).reshape(batch, *form.cube_shape)
        snaps = array_of(b).reshape(batch, shots, *form.detector_shape)
        out = a.new_zeros((shots, *form.code_shape), device="cpu")
        one = out.numpy().copy()
        for cube, snap in zip(cubes, snaps, strict=True):
            form.code(cube, snap, one)
            out.numpy()[...] += one
        return out.to(a.device)
    code, batch = array_of(a), b.shape[:-3]
    if slot == _SNAPSHOTS:
        shape, run = (len(code), *form.detector_shape), form.snapshots
    else:
        shape, run = form.cube_shape, form.cube
    given = array_of(b).reshape(batch.numel(), *b.shape[-3:])
    out = a.new_empty((batch.numel(), *shape), device="cpu")
    for one, result in zip(given, out.numpy(), strict=True):
        run(code, one, result)
    return out.reshape(*batch, *shape).to(b.device)


def _check(form: CodedForm, code: Tensor, other: Tensor, slot: int) -> None:
    wanted = _shape(form, _CODE)
    if code.ndim != len(wanted) + 1 or tuple(code.shape[1:]) != wanted:
        raise ValueError(f"the code must have the shape (shot, {', '.join(map(str, wanted))}), got {tuple(code.shape)}")
    wanted = form.cube_shape if slot == _CUBE else (len(code), *form.detector_shape)
    if other.ndim < 3 or tuple(other.shape[-3:]) != wanted:
        name = "cubes" if slot == _CUBE else "snapshots"
        raise ValueError(f"{name} must have the shape (…, {', '.join(map(str, wanted))}), got {tuple(other.shape)}")
    if code.dtype != other.dtype:
        raise ValueError(f"code and images must have the same dtype, got {code.dtype} and {other.dtype}")


@cache
def _apply() -> Callable[[CodedForm, int, Tensor, Tensor], Tensor]:
    """`_derivative` as a function that autograd knows. T is linear in each of its three, so its derivatives give each other's."""
    torch = load_torch()

    class Derivative(torch.autograd.Function):
        @staticmethod
        def forward(form: CodedForm, slot: int, a: Tensor, b: Tensor) -> Tensor:
            return _derivative(form, slot, a, b)

        @staticmethod
        def setup_context(ctx: Any, inputs: tuple[CodedForm, int, Tensor, Tensor], output: Tensor) -> None:  # noqa: ARG004
            ctx.form, ctx.slot = inputs[:2]
            ctx.save_for_backward(*inputs[2:])

        @staticmethod
        def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
            others = [slot for slot in (_CODE, _CUBE, _SNAPSHOTS) if slot != ctx.slot]
            values = dict(zip(others, ctx.saved_tensors, strict=True)) | {ctx.slot: gradient}

            def by(slot: int) -> Tensor:
                return Derivative.apply(ctx.form, slot, *(values[s] for s in sorted(values) if s != slot))

            needed = ctx.needs_input_grad[2:]
            return None, None, *(by(slot) if wanted else None for slot, wanted in zip(others, needed, strict=True))

    return Derivative.apply


@cache
def _module_class() -> type[Module]:
    torch = load_torch()

    class ImagerModule(torch.nn.Module):
        """An imager of shadowgram: code and cubes → snapshots."""

        def __init__(self, form: CodedForm) -> None:
            super().__init__()
            self.form = form

        def forward(self, code: Tensor, cubes: Tensor) -> Tensor:
            _check(self.form, code, cubes, _CUBE)
            return _apply()(self.form, _SNAPSHOTS, code, cubes)

        def adjoint(self, code: Tensor, snapshots: Tensor) -> Tensor:
            _check(self.form, code, snapshots, _SNAPSHOTS)
            return _apply()(self.form, _CUBE, code, snapshots)

    return ImagerModule
