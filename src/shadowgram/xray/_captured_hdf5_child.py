"""The process that opens MATLAB 7.3 files for their cell arrays; started by `_captured_cells`, never imported.

The request is one JSON object on the command line. The answer is one line of JSON, with the name, shape and type of each cell array
whose cells are arrays of one shape, and then the bytes of all of them.
"""

import json
import os
import resource
import sys


def main():
    """Answer once."""
    request = json.loads(sys.argv[1])
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # nothing that a library prints may mix with the answer
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_CPU, (request["seconds"], request["seconds"] + 1))
    resource.setrlimit(resource.RLIMIT_AS, (request["memory"], resource.getrlimit(resource.RLIMIT_AS)[1]))
    sys.path[:] = request["modules"]
    arrays = []
    try:
        arrays = read(request["path"], request["most"])
        cells = [{"name": name, "shape": list(array.shape), "dtype": array.dtype.str} for name, array in arrays]
        said = {"cells": cells}
    except MemoryError:
        arrays, said = [], {"error": "it needs more memory than a file of its size should"}
    except Exception as error:  # noqa: BLE001  # whatever h5py makes of the file, the parent gets one sentence
        arrays, said = [], {"error": str(error) or type(error).__name__}
    answers.write(json.dumps(said).encode() + b"\n")
    for _, array in arrays:
        answers.write(array.tobytes())
    answers.flush()


def read(path, most):
    """(name, array) of every cell array."""
    import h5py

    found = []
    with h5py.File(path, "r", locking=False) as file:
        for name in file:
            if isinstance(file.get(name, getlink=True), h5py.ExternalLink):
                continue
            item = file[name]
            if not isinstance(item, h5py.Dataset) or h5py.check_ref_dtype(item.dtype) is not h5py.Reference:
                continue
            array = stacked([file[reference] for reference in item[...].ravel()], most)
            if array is not None:
                most -= array.nbytes
                found.append((name, array))
    return found


def stacked(cells, most):
    """The cells as one array of at most so many bytes, or None where they are not alike."""
    import numpy as np

    if not cells or not all(plain(cell, cells[0]) for cell in cells):
        return None
    if len(cells) * cells[0].size * cells[0].dtype.itemsize > most:
        raise ValueError("its cell arrays are out of proportion to its size")
    return np.stack([cell[...] for cell in cells])


def plain(cell, first):
    """Whether a cell is an array of real numbers, of the shape of the first one, kept in this file."""
    import h5py

    if not isinstance(cell, h5py.Dataset) or cell.external or cell.is_virtual or cell.shape is None:
        return False
    return cell.shape == first.shape and cell.dtype.kind in "fiub" and "MATLAB_empty" not in cell.attrs


if __name__ == "__main__":
    main()
