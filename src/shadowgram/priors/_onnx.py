"""Write and look into ONNX files of plain convolutional networks, without the package `onnx`.

ONNX is a protobuf message: fields of (number, wire type), here only whole numbers (type 0) and bytes (type 2).
Source of the field numbers: onnx.proto of the ONNX project, IR version 8.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

IR_VERSION, OPSET = 8, 13
_FLOAT, _INT, _STRING, _INTS = 1, 2, 3, 7  # TensorProto.FLOAT; AttributeProto.INT, STRING, INTS


def model(graph: bytes, properties: Mapping[str, str]) -> bytes:
    """Give the bytes of a file from a `graph`, with its metadata properties."""
    parts = [
        _whole(1, IR_VERSION),
        _text(2, "shadowgram"),
        _bytes(7, graph),
        _bytes(8, _text(1, "") + _whole(2, OPSET)),
    ]
    parts += [_bytes(14, _text(1, key) + _text(2, value)) for key, value in properties.items()]
    return b"".join(parts)


def graph(
    name: str,
    nodes: Sequence[bytes],
    weights: Mapping[str, np.ndarray],
    inputs: Mapping[str, Sequence[int | str]],
    outputs: Mapping[str, Sequence[int | str]],
) -> bytes:
    """Give a graph: nodes in the order of work, float32 weights, and the shapes of what goes in and out; free sizes are names."""
    parts = [_bytes(1, one) for one in nodes]
    parts.append(_text(2, name))
    parts += [_bytes(5, _tensor(key, value)) for key, value in weights.items()]
    parts += [_bytes(11, _value(key, shape)) for key, shape in inputs.items()]
    parts += [_bytes(12, _value(key, shape)) for key, shape in outputs.items()]
    return b"".join(parts)


def node(kind: str, inputs: Sequence[str], output: str, **attributes: int | str | Sequence[int]) -> bytes:
    """Give one operation of a graph; `attributes` are those of the ONNX operator."""
    parts = [_text(1, name) for name in inputs]
    parts += [_text(2, output), _text(3, output), _text(4, kind)]
    parts += [_bytes(5, _attribute(key, value)) for key, value in attributes.items()]
    return b"".join(parts)


def _attribute(name: str, value: int | str | Sequence[int]) -> bytes:
    if isinstance(value, int):
        return _text(1, name) + _whole(3, value) + _whole(20, _INT)
    if isinstance(value, str):
        return _text(1, name) + _text(4, value) + _whole(20, _STRING)
    return _text(1, name) + b"".join(_whole(8, one) for one in value) + _whole(20, _INTS)


def _tensor(name: str, values: np.ndarray) -> bytes:
    sizes = b"".join(_whole(1, size) for size in values.shape)
    return sizes + _whole(2, _FLOAT) + _text(8, name) + _bytes(9, np.ascontiguousarray(values, "<f4").tobytes())


def _value(name: str, shape: Sequence[int | str]) -> bytes:
    sizes = [_whole(1, one) if isinstance(one, int) else _text(2, one) for one in shape]
    tensor = _whole(1, _FLOAT) + _bytes(2, b"".join(_bytes(1, size) for size in sizes))
    return _text(1, name) + _bytes(2, _bytes(1, tensor))


def _whole(field: int, value: int) -> bytes:
    return _varint(field << 3) + _varint(value)


def _bytes(field: int, value: bytes) -> bytes:
    return _varint(field << 3 | 2) + _varint(len(value)) + value


def _text(field: int, value: str) -> bytes:
    return _bytes(field, value.encode())


def _varint(value: int) -> bytes:
    """Seven bits a byte, the lowest first; all but the last byte have the eighth bit set."""
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)
