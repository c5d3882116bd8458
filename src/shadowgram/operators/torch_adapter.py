"""Operators for PyTorch and deepinv, and back.

Any operator becomes a differentiable function on tensors, whose derivative is the adjoint, or a physics object of deepinv; and any
linear module or physics of theirs becomes an operator for our solvers. PyTorch is imported when a function here is called.

The kernels run on the processor. Tensors there are not copied; those on a GPU are copied to the processor and their result back.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from .base import LinearOperator, Shape

if TYPE_CHECKING:
    from collections.abc import Callable

    from deepinv.physics import LinearPhysics  # pyright: ignore[reportMissingImports]
    from torch import Tensor  # pyright: ignore[reportMissingImports]
    from torch.nn import Module  # pyright: ignore[reportMissingImports]

_DOUBLE_TOLERANCE, _SINGLE_TOLERANCE = 1e-9, 1e-3  # of a test that a module is linear


def as_torch(A: LinearOperator) -> Module:
    """`A` as a differentiable `torch.nn.Module`.

    Called on a tensor (…, *in_shape), with any number of batch axes, it gives (…, *out_shape); its method ``adjoint`` goes back.
    The gradient is the adjoint, and may be differentiated again. float32 and float64 are kept. There are no parameters.
    `torch.func.vmap`, `jvp` and `vjp` work too.

    Raises
    ------
    ValueError
        If PyTorch is missing, or, when called, if a shape does not fit.
    TypeError
        When called with other than float32 and float64.

    Notes
    -----
    Tensors on a GPU are copied to the processor, where the kernels run, and the result back to the GPU.

    Examples
    --------
    ::

        imager = sg.CASSI(cube_shape=(24, 256, 256), wavelengths=(450, 650))
        H = sg.operators.as_torch(imager.operator(sg.codes.boolean(shots=2, shape=imager.code_shape, seed=0)))
        x = torch.zeros(8, 24, 256, 256, requires_grad=True)
        loss = ((H(x) - y) ** 2).sum()
        loss.backward()
    """
    load_torch()
    return _module_class()(A)


def as_deepinv(A: LinearOperator, noise_model: Module | None = None) -> LinearPhysics:
    """`A` as a `deepinv.physics.LinearPhysics`, for the solvers, networks and losses of deepinv.

    Parameters
    ----------
    A : the operator. Its cube (band, y, x) is deepinv's image (channel, height, width), after the batch axis; an image (y, x), as
        of a backscatter imager, gets a channel axis of 1.
    noise_model : such as ``deepinv.physics.GaussianNoise(sigma=0.01)``; none by default.

    Raises
    ------
    ValueError
        If PyTorch or deepinv is missing.

    Examples
    --------
    ::

        physics = sg.operators.as_deepinv(imager.operator(code), noise_model=deepinv.physics.GaussianNoise(0.01))
        y = physics(x)  # (batch, shot, y, x), with noise
        x = physics.A_dagger(y)
    """
    load_torch()
    try:
        import deepinv  # noqa: F401  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise ValueError('as_deepinv needs the package deepinv: pip install "shadowgram[torch]"') from error
    return _physics_class()(A, noise_model)


def from_torch(module: Module, in_shape: Shape, out_shape: Shape) -> LinearOperator:
    """Linear module, or physics of deepinv, as an operator for our solvers.

    Parameters
    ----------
    module : takes a tensor (1, *in_shape) and gives (1, *out_shape). Of a physics object, ``A`` and ``A_adjoint`` are used, without
        its noise; of any other module the adjoint is found by differentiation. It is computed in the precision, and on the device,
        of its parameters and buffers, if it has any.
    in_shape, out_shape : without the batch axis.

    Raises
    ------
    ValueError
        If PyTorch is missing, a shape does not fit, or the module is not linear.

    Examples
    --------
    ::

        blur = deepinv.physics.Blur(filter=kernel, padding="circular")
        A = sg.operators.from_torch(blur, (3, 64, 64), (3, 64, 64))
        solution = sg.solve(sg.EigenTV(), A, y)
    """
    torch = load_torch()
    in_shape, out_shape = tuple(in_shape), tuple(out_shape)
    if type(module).__module__ == __name__ and (module.operator.in_shape, module.operator.out_shape) == (
        in_shape,
        out_shape,
    ):
        return module.operator  # made here: nothing is lost on the way back
    operator = TorchOperator(module, in_shape, out_shape)
    rng = np.random.default_rng(0)
    a, b = rng.standard_normal(in_shape), rng.standard_normal(in_shape)
    with torch.no_grad():
        wanted, found = operator.forward(a) - 2 * operator.forward(b), operator.forward(a - 2 * b)
    precise = operator._dtype in (None, torch.float64)
    allowed = (_DOUBLE_TOLERANCE if precise else _SINGLE_TOLERANCE) * max(np.abs(wanted).max(initial=0.0), 1e-30)
    if not np.abs(found - wanted).max(initial=0.0) <= allowed:
        raise ValueError(
            "from_torch needs a linear module, but f(a − 2b) is not f(a) − 2f(b): remove its bias, noise and nonlinearities"
        )
    return operator


@dataclass(frozen=True, eq=False)
class TorchOperator(LinearOperator):
    """A linear module of PyTorch or physics of deepinv as an operator; made by `from_torch`."""

    module: Module
    _in_shape: Shape
    _out_shape: Shape

    @property
    def in_shape(self) -> Shape:
        """Shape of what `forward` takes."""
        return self._in_shape

    @property
    def out_shape(self) -> Shape:
        """Shape of what `forward` gives."""
        return self._out_shape

    @property
    def _state(self) -> Tensor | None:
        """Any parameter or buffer that holds real numbers."""
        state = (*self.module.parameters(), *self.module.buffers())
        return next((t for t in state if t.is_floating_point()), None)

    @property
    def _dtype(self) -> Any:
        return None if self._state is None else self._state.dtype

    def _tensor(self, a: np.ndarray) -> Tensor:
        tensor = load_torch().from_numpy(a)[None]
        return tensor if self._state is None else tensor.to(self._state)

    def _call(self, x: Tensor) -> Tensor:
        y = self.module.A(x) if hasattr(self.module, "A_adjoint") else self.module(x)
        if tuple(y.shape) != (1, *self.out_shape):
            raise ValueError(f"the module gives {tuple(y.shape)} for {tuple(x.shape)}, not {(1, *self.out_shape)}")
        return y

    def _forward(self, x: np.ndarray, out: np.ndarray) -> None:
        with load_torch().no_grad():
            out[...] = array_of(self._call(self._tensor(x)))[0]

    def _adjoint(self, y: np.ndarray, out: np.ndarray) -> None:
        torch, seen = load_torch(), self._tensor(y)
        if hasattr(self.module, "A_adjoint"):
            with torch.no_grad():
                out[...] = array_of(self.module.A_adjoint(seen)).reshape(out.shape)
            return
        with torch.enable_grad():
            x = seen.new_zeros((1, *self.in_shape)).requires_grad_()
            (gradient,) = torch.autograd.grad(self._call(x), x, seen)
        out[...] = array_of(gradient)[0]


def load_torch() -> Any:
    """Return the module `torch`, or raise if it is not installed."""
    try:
        import torch  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise ValueError('this needs PyTorch: pip install "shadowgram[torch]"') from error
    return torch


def array_of(tensor: Tensor) -> np.ndarray:
    """C-contiguous array of a tensor; of one that is so on the processor, a view."""
    torch = load_torch()
    if tensor.dtype not in (torch.float32, torch.float64):
        raise TypeError(f"operators work on float32 and float64 tensors, got {tensor.dtype}: convert it with .float()")
    return tensor.contiguous().numpy(force=True)


def _applied(x: Tensor, A: LinearOperator) -> Tensor:
    """A on every element of a batch."""
    n = len(A.in_shape)
    if x.ndim < n or tuple(x.shape[x.ndim - n :]) != A.in_shape:
        raise ValueError(
            f"{type(A).__name__} takes tensors of shape (…, {', '.join(map(str, A.in_shape))}), got {tuple(x.shape)}"
        )
    batch = x.shape[: x.ndim - n]
    given = array_of(x).reshape(batch.numel(), *A.in_shape)
    out = load_torch().empty((batch.numel(), *A.out_shape), dtype=x.dtype)
    for one, result in zip(given, out.numpy(), strict=True):
        A.forward(one, out=result)
    return out.reshape(*batch, *A.out_shape).to(x.device)


@cache
def _apply() -> Callable[[Tensor, LinearOperator], Tensor]:
    """The operator as a function that autograd knows: (tensor, operator) → tensor."""
    torch = load_torch()

    class Apply(torch.autograd.Function):
        @staticmethod
        def forward(x: Tensor, A: LinearOperator) -> Tensor:
            return _applied(x, A)

        @staticmethod
        def setup_context(ctx: Any, inputs: tuple[Tensor, LinearOperator], output: Tensor) -> None:  # noqa: ARG004
            ctx.A = inputs[1]

        @staticmethod
        def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None]:
            return Apply.apply(gradient, ctx.A.H), None

        @staticmethod
        def jvp(ctx: Any, tangent: Tensor, _: None) -> Tensor:
            return Apply.apply(tangent, ctx.A)

        @staticmethod
        def vmap(info: Any, in_dims: tuple[int, None], x: Tensor, A: LinearOperator) -> tuple[Tensor, int]:  # noqa: ARG004
            return Apply.apply(x.movedim(in_dims[0], 0), A), 0

    return Apply.apply


@cache
def _module_class() -> type[Module]:
    torch = load_torch()

    class OperatorModule(torch.nn.Module):
        """An operator of shadowgram: (…, *in_shape) → (…, *out_shape)."""

        def __init__(self, A: LinearOperator) -> None:
            super().__init__()
            self.operator = A

        def forward(self, x: Tensor) -> Tensor:
            return _apply()(x, self.operator)

        def adjoint(self, y: Tensor) -> Tensor:
            return _apply()(y, self.operator.H)

        def extra_repr(self) -> str:
            return f"{type(self.operator).__name__}: {self.operator.in_shape} → {self.operator.out_shape}"

        def __reduce__(self) -> tuple:
            # The class is made when PyTorch is first needed, so it has no name that a module copied to another process could find.
            return as_torch, (self.operator,)

    return OperatorModule


@cache
def _physics_class() -> type[LinearPhysics]:
    from deepinv.physics import LinearPhysics  # pyright: ignore[reportMissingImports]

    class OperatorPhysics(LinearPhysics):
        """An operator of shadowgram as physics: (batch, channel, y, x) → (batch, *out_shape)."""

        def __init__(self, A: LinearOperator, noise_model: Module | None) -> None:
            image = A.in_shape if len(A.in_shape) > 2 else (1, *A.in_shape)
            noise = {} if noise_model is None else {"noise_model": noise_model}
            super().__init__(img_size=image, **noise)
            self.operator = A

        def A(
            self, x: Tensor, **_: Any
        ) -> Tensor:  # deepinv hands all arguments of a call to A, also those of the noise
            if tuple(x.shape[1:]) != self.img_size:
                raise ValueError(
                    f"this physics takes images (batch, {', '.join(map(str, self.img_size))}), got {tuple(x.shape)}"
                )
            return _apply()(x.reshape(len(x), *self.operator.in_shape), self.operator)

        def A_adjoint(self, y: Tensor, **_: Any) -> Tensor:
            return _apply()(y, self.operator.H).reshape(len(y), *self.img_size)

    return OperatorPhysics
