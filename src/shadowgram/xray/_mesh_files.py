"""Reading triangle meshes from STL, OBJ and PLY files."""

from __future__ import annotations

import io
import math
import os
import struct
import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

LARGEST_FILE = 2 << 30
"""Bytes; a binary STL file of this size holds 43 million triangles."""

_KINDS = {".stl": "stl", ".obj": "obj", ".ply": "ply"}


def read_mesh(path: str | os.PathLike[str], scale: float = 1.0) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    r"""Read a triangle mesh from a file as it is; `check_mesh` says whether it bounds a body.

    Parameters
    ----------
    path : an STL (binary or text), OBJ or PLY file, told by its suffix. Colours, textures and normals are ignored.
    scale : mm per unit of the file; such files do not say their unit.

    Returns
    -------
    vertices : (vertex, 3), mm.
    faces : (face, 3), indices of vertices.

    Raises
    ------
    ValueError
        If the file is of another kind, damaged, too large, or holds no triangle or a coordinate that is not finite.
    OSError
        If there is no such file, or it cannot be opened.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "one.obj"
    >>> _ = path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    >>> vertices, faces = read_mesh(path, scale=10)
    >>> vertices.max(), faces.tolist()
    (np.float64(10.0), [[0, 1, 2]])
    """
    path = Path(path)
    if not (math.isfinite(scale) and scale > 0):
        raise ValueError(f"scale must be a positive number of mm per unit of the file, got {scale}")
    try:
        kind = _kind(path)
        vertices, faces = _parsed(path.read_bytes(), kind)
        _check(vertices, faces)
    except ValueError as error:
        raise ValueError(f"cannot read {path}: {error}") from error
    return vertices * scale, faces


def _kind(path: Path) -> str:
    """The format; raise if the file cannot hold a mesh that we read."""
    if path.is_dir():
        raise IsADirectoryError(f"{path} is a folder; give a file in it")
    if not path.exists():
        raise FileNotFoundError(f"there is no file {path}")
    if not path.is_file():
        raise OSError(f"{path} is not a file")
    if path.suffix.lower() not in _KINDS:
        raise ValueError("its name must end with .stl, .obj or .ply")
    size = path.stat().st_size
    if size == 0:
        raise ValueError("it is empty")
    if size > LARGEST_FILE:
        raise ValueError(
            f"it has {size / 2**30:.1f} GB, more than the {LARGEST_FILE >> 30} GB that are read; simplify it"
        )
    return _KINDS[path.suffix.lower()]


def _parsed(content: bytes, kind: str) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    import trimesh

    if kind == "stl":
        _check_stl(content)
    options = {} if kind == "stl" else {"skip_materials": True}  # textures are other files, which nobody asked for
    try:
        with warnings.catch_warnings():
            # Where NumPy stops in the middle of a text it only warns.
            warnings.simplefilter("error")
            mesh = trimesh.load_mesh(io.BytesIO(content), file_type=kind, process=False, **options)
        vertices = np.array(mesh.vertices, np.float64).reshape(-1, 3)
        faces = np.array(getattr(mesh, "faces", ()), np.int64).reshape(-1, 3)
    except Exception as error:  # its parsers raise whatever they stumble on
        raise ValueError(f"it is damaged or not {_article(kind)} file") from error
    return vertices, faces


def _article(kind: str) -> str:
    return f"{'a' if kind == 'ply' else 'an'} {kind.upper()}"


def _check_stl(content: bytes) -> None:
    """Raise if an STL file is cut: its binary kind says how long it is, its text kind how it ends."""
    if content.lstrip()[:5].lower() == b"solid" and b"facet" in content[:1024].lower():
        if b"endsolid" not in content[-1024:].lower():
            raise ValueError("it is cut: an STL text ends with 'endsolid'; copy or export it again")
        return
    # The count of triangles behind the binary header has a zero byte in all files below 800 MB, a text has none.
    if len(content) < 84 or (content[:84].isascii() and 0 not in content[:84]):
        raise ValueError(
            "it is not an STL file: it has neither a binary header nor 'solid' and 'facet' in its first lines"
        )
    (count,) = struct.unpack("<I", content[80:84])
    if len(content) != 84 + 50 * count:
        raise ValueError(
            f"its header promises {count} triangles in {84 + 50 * count} bytes, but it has {len(content)}; copy or export it again"
        )


def _check(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> None:
    if len(faces) == 0:
        raise ValueError("it holds no triangles")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise ValueError(f"a triangle names vertex {faces.max()}, but there are only {len(vertices)}")
    bad = len(vertices) - int(np.isfinite(vertices).all(axis=1).sum())
    if bad:
        raise ValueError(f"{bad} of its {len(vertices)} vertices have coordinates that are not finite")
