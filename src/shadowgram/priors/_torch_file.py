"""Read the tensors of a PyTorch ``.pth`` file without torch, and without unpickling it.

Such a file holds a pickle that names its tensors, and their numbers. The pickle is a list of operations for a stack machine;
`_Machine` is one that makes dictionaries, lists, tuples and records of tensors, and refuses all else: it can call nothing.
Files of torch before 1.6 are four pickles and the numbers one after another; later ones are zip archives.
Formats: torch/serialization.py of PyTorch.
"""

from __future__ import annotations

import io
import math
import pickletools
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

LARGEST = 64 * 2**20  # bytes; the networks that this is for have 2 to 4 MB
_OLD_MAGIC = 0x1950A86A20F9469CFC6C
_DTYPES = {
    "DoubleStorage": "<f8",
    "FloatStorage": "<f4",
    "HalfStorage": "<f2",
    "LongStorage": "<i8",
    "IntStorage": "<i4",
}


@dataclass
class _Storage:
    kind: Any
    key: Any
    count: Any


@dataclass
class _Tensor:
    storage: Any
    offset: Any
    shape: Any
    strides: Any


def tensors(content: bytes) -> dict[str, np.ndarray]:
    """Give the tensors of a file by name, in their order.

    Raises
    ------
    ValueError
        If the content is cut short, is not a dictionary of tensors, or asks for anything else.
    """
    if len(content) > LARGEST:
        raise ValueError(f"it has {len(content) >> 20} MB; weights of an FFDNet have less than {LARGEST >> 20} MB")
    try:
        records, numbers = (_zipped if content.startswith(b"PK") else _legacy)(content)
        return {name: _array(record, numbers) for name, record in _flat(records).items()}
    except _Refused:
        raise
    except Exception as error:  # a broken pickle or archive may raise anything
        raise ValueError("it is not a whole file of weights saved by torch.save") from error


class _Refused(ValueError):  # noqa: N818 - what is wrong has been said
    """An error that has its sentence already."""


@dataclass(frozen=True)
class _Name:
    """Something that the pickle names and that stands for a record of ours."""

    module: str
    name: str


_NAMES = {
    _Name("collections", "OrderedDict"),
    _Name("torch._utils", "_rebuild_tensor"),
    _Name("torch._utils", "_rebuild_tensor_v2"),
    _Name("torch._utils", "_rebuild_parameter"),
    *(_Name("torch", kind) for kind in _DTYPES),
}
_NOTHING = {"PROTO", "FRAME", "STOP"}
_CONSTANTS = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False}
_LITERALS = {
    "BININT", "BININT1", "BININT2", "LONG1", "BINFLOAT", "BINUNICODE", "SHORT_BINUNICODE", "BINSTRING", "SHORT_BINSTRING",
}  # fmt: skip
_SHORT_TUPLES = {"EMPTY_TUPLE": 0, "TUPLE1": 1, "TUPLE2": 2, "TUPLE3": 3}


class _Machine:
    """Follow the operations of one pickle; nothing in what it makes has been checked."""

    def __init__(self) -> None:
        self.stack: list[Any] = []
        self.marks: list[int] = []
        self.memo: dict[int, Any] = {}

    def follow(self, operation: str, argument: Any) -> None:
        """Do one operation."""
        if operation in _NOTHING:
            return
        if operation in _CONSTANTS:
            self.stack.append(_CONSTANTS[operation])
        elif operation in _LITERALS:
            self.stack.append(argument)
        elif operation in _SHORT_TUPLES:
            count = _SHORT_TUPLES[operation]
            self.stack.append(tuple(reversed([self.stack.pop() for _ in range(count)])))
        else:
            does = getattr(self, f"_{operation.lower()}", None)
            if does is None:
                raise _Refused("it is not a dictionary of tensors")
            does(argument)

    def _since_mark(self) -> list[Any]:
        start = self.marks.pop()
        items = self.stack[start:]
        del self.stack[start:]
        return items

    def _mark(self, _: object) -> None:
        self.marks.append(len(self.stack))

    def _tuple(self, _: object) -> None:
        self.stack.append(tuple(self._since_mark()))

    def _empty_dict(self, _: object) -> None:
        self.stack.append({})

    def _empty_list(self, _: object) -> None:
        self.stack.append([])

    def _setitem(self, _: object) -> None:
        value, key = self.stack.pop(), self.stack.pop()
        self.stack[-1][key] = value

    def _setitems(self, _: object) -> None:
        items = self._since_mark()
        self.stack[-1].update(zip(items[::2], items[1::2], strict=True))

    def _append(self, _: object) -> None:
        value = self.stack.pop()
        self.stack[-1].append(value)

    def _appends(self, _: object) -> None:
        items = self._since_mark()
        self.stack[-1].extend(items)

    def _binput(self, place: int) -> None:
        self.memo[place] = self.stack[-1]

    _long_binput = _binput

    def _memoize(self, _: object) -> None:
        self.memo[len(self.memo)] = self.stack[-1]

    def _binget(self, place: int) -> None:
        self.stack.append(self.memo[place])

    _long_binget = _binget

    def _global(self, named: str) -> None:
        module, name = named.split(" ", 1)
        if _Name(module, name) not in _NAMES:
            raise _Refused(f"it asks for {module}.{name}, which is more than weights; nothing of it was run")
        self.stack.append(_Name(module, name))

    def _stack_global(self, _: object) -> None:
        name, module = self.stack.pop(), self.stack.pop()
        self._global(f"{module} {name}")

    def _binpersid(self, _: object) -> None:
        """A record of where a tensor's numbers are."""
        named = self.stack.pop()
        if not isinstance(named, tuple) or len(named) < 5 or named[0] != "storage" or not isinstance(named[1], _Name):
            raise _Refused("it is not a dictionary of tensors")
        self.stack.append(_Storage(named[1].name, named[2], named[4]))

    def _reduce(self, _: object) -> None:
        """A dictionary, a tensor, or the tensor of a parameter."""
        arguments, named = self.stack.pop(), self.stack.pop()
        if named.name == "OrderedDict":
            self.stack.append(dict(*arguments))
        elif isinstance(arguments[0], _Tensor):
            self.stack.append(arguments[0])
        else:
            self.stack.append(_Tensor(*arguments[:4]))

    def _build(self, _: object) -> None:
        """Attributes of a dictionary, such as torch's versions of modules: not needed."""
        self.stack.pop()


def _load(stream: io.BytesIO) -> Any:
    """What the next pickle of a stream describes."""
    machine = _Machine()
    for operation, argument, _ in pickletools.genops(stream):
        machine.follow(operation.name, argument)
    return machine.stack.pop()


def _zipped(content: bytes) -> tuple[object, Callable[[_Storage], bytes]]:
    archive = zipfile.ZipFile(io.BytesIO(content))
    if sum(one.file_size for one in archive.infolist()) > LARGEST:
        raise _Refused(f"unpacked it has more than {LARGEST >> 20} MB; weights of an FFDNet have less")
    (listed,) = (name for name in archive.namelist() if name.endswith("/data.pkl"))
    records = _load(io.BytesIO(archive.read(listed)))
    folder = listed.removesuffix("data.pkl")
    return records, lambda storage: archive.read(f"{folder}data/{storage.key}")


def _legacy(content: bytes) -> tuple[object, Callable[[_Storage], bytes]]:
    stream = io.BytesIO(content)
    if _load(stream) != _OLD_MAGIC:
        raise _Refused("it is not a file of weights saved by torch.save")
    _load(stream)  # version of the protocol
    _load(stream)  # sizes of whole numbers on the machine
    records = _load(stream)
    keys = _load(stream)
    sizes = {tensor.storage.key: _dtype(tensor.storage).itemsize for tensor in _flat(records).values()}
    found = {}
    for key in keys:
        count = int.from_bytes(stream.read(8), "little")
        found[key] = stream.read(count * sizes[key])
    return records, lambda storage: found[storage.key]


def _flat(records: object) -> dict[str, _Tensor]:
    """Tensors of a dictionary, or of the one inside it that has them, as training programs save it."""
    if isinstance(records, dict):
        for key in ("state_dict", "params"):
            if isinstance(records.get(key), dict):
                return _flat(records[key])
        if records and all(isinstance(k, str) and isinstance(v, _Tensor) for k, v in records.items()):
            return records
    raise _Refused("it is not a dictionary of tensors")


def _dtype(storage: _Storage) -> np.dtype:
    return np.dtype(_DTYPES[storage.kind])


def _array(record: _Tensor, numbers: Callable[[_Storage], bytes]) -> np.ndarray:
    """Numbers of a tensor. All that the record says is checked here, where it is used."""
    offset, shape, strides = record.offset, record.shape, record.strides
    if not (isinstance(shape, tuple) and isinstance(strides, tuple) and len(shape) == len(strides) <= 8):
        raise _Refused("it is not a dictionary of tensors")
    if not (
        isinstance(record.storage, _Storage) and all(isinstance(n, int) and n >= 0 for n in (offset, *shape, *strides))
    ):
        raise _Refused("it is not a dictionary of tensors")
    values = np.frombuffer(numbers(record.storage), _dtype(record.storage))
    if len(values) < record.storage.count:
        raise _Refused("it is cut short")
    reach = offset + sum((n - 1) * s for n, s in zip(shape, strides, strict=True)) + 1
    if math.prod(shape) > len(values) or (math.prod(shape) > 0 and reach > len(values)):
        raise _Refused("a tensor reaches beyond its numbers")
    steps = tuple(s * values.itemsize for s in strides)
    return np.lib.stride_tricks.as_strided(values[offset:], shape, steps, writeable=False).copy()
