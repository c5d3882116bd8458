"""The process that opens HDF5 files nobody vouches for; started by `hdf5_isolated`, never imported.

The HDF5 library can crash, loop or take all memory on a damaged file, so that it is kept out of the user's process. The
request is one JSON object on the command line. On standard output it gives one line of JSON that lists the variables;
then, for each name that comes as a line of JSON on standard input, one line of JSON and the bytes of that array.
"""

import json
import os
import resource
import sys

DIMENSION_ONLY = b"This is a netCDF dimension but not a netCDF variable"


def main():
    """Answer until standard input ends."""
    request = json.loads(sys.argv[1])
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # nothing that a library prints may mix with the answers
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_CPU, (request["seconds"], request["seconds"] + 1))
    limit_memory(request["memory"])
    sys.path[:] = request["modules"]
    try:
        import h5py

        with h5py.File(request["path"], "r", locking=False) as file:
            say(answers, list_variables(file))
            for line in sys.stdin:
                name = json.loads(line)
                send(answers, file[name], request["memory"])
    except BrokenPipeError:
        os._exit(0)
    except MemoryError:
        say(answers, {"error": "it needs more memory than a file of its size should"})
    except Exception as error:  # noqa: BLE001  # whatever h5py makes of the file, the parent gets one sentence
        say(answers, {"error": str(error) or type(error).__name__})


def limit_memory(size):
    """Let the process take this many bytes."""
    resource.setrlimit(resource.RLIMIT_AS, (size, resource.getrlimit(resource.RLIMIT_AS)[1]))


def say(answers, value):
    """One line of JSON."""
    answers.write(json.dumps(value).encode() + b"\n")
    answers.flush()


def list_variables(file):
    """What there is at the top of the file, by name."""
    import h5py

    mark = file.attrs.get("_NCProperties", b"")
    mark = mark.decode(errors="replace") if isinstance(mark, bytes) else str(mark)
    variables = {}
    for name in file:
        link = file.get(name, getlink=True)
        if isinstance(link, h5py.ExternalLink):
            variables[name] = {"problem": "a link to another file"}
            continue
        item = file[name]
        if isinstance(item, h5py.Group):
            if not name.startswith("#"):  # MATLAB keeps the contents of cells there
                sparse = "MATLAB_sparse" in item.attrs
                what = "a sparse array; save full(...) of it" if sparse else "a struct; save its fields as variables"
                variables[name] = {"problem": what}
        elif isinstance(item, h5py.Dataset) and not attribute(item, "NAME").startswith(DIMENSION_ONLY):
            variables[name] = describe(item)
    return {"variables": variables, "provenance": mark, "attrs": plain_attributes(file)}


def describe(item):
    """Shape, type, dimensions and attributes of an array, or why it cannot be read."""
    matlab = attribute(item, "MATLAB_class").decode(errors="replace")
    return {
        "shape": list(item.shape or ()),
        "dtype": item.dtype.str,
        "dims": dimensions(item),
        "attrs": plain_attributes(item),
        "matlab": matlab,
        "problem": problem(item, matlab),
    }


def problem(item, matlab):
    """Why an array cannot be read, or nothing."""
    import h5py

    if item.external or item.is_virtual:
        return "kept in another file"
    if (item.dtype.names and set(item.dtype.names) == {"real", "imag"}) or item.dtype.kind == "c":
        return "complex numbers; save their real part or their magnitude"
    if matlab == "cell" or h5py.check_ref_dtype(item.dtype):
        return "a cell array; save the array inside it as a variable of its own"
    if matlab == "char" or h5py.check_string_dtype(item.dtype):
        return "text"
    if item.shape is None or "MATLAB_empty" in item.attrs:
        return "empty"
    if item.dtype.kind not in "fiub" or item.dtype.itemsize > 8:
        return "not an array of real numbers"
    return ""


def attribute(item, name):
    """An attribute that may be text, as bytes."""
    value = item.attrs.get(name, b"")
    return value.encode() if isinstance(value, str) else bytes(value) if isinstance(value, bytes) else b""


def plain_attributes(item):
    """Attributes that are numbers or short texts."""
    import numpy as np

    plain = {}
    for name in item.attrs:
        try:
            value = item.attrs[name]
        except (OSError, TypeError, ValueError):  # of a type that h5py does not know
            continue
        if isinstance(value, bytes):
            value = value.decode(errors="replace")
        if isinstance(value, (np.ndarray, np.generic)) and value.dtype.kind in "fiu" and value.size <= 10_000:
            value = value.item() if value.size == 1 else value.tolist()
        if isinstance(value, (str, int, float, list)):
            plain[name] = value
    return plain


def dimensions(item):
    """Names of the NetCDF dimensions along the axes, or None."""
    if attribute(item, "CLASS") == b"DIMENSION_SCALE":
        return [item.name.strip("/")] if len(item.shape or ()) == 1 else None
    if "DIMENSION_LIST" not in item.attrs:
        return None
    scales = [list(axis.values()) for axis in item.dims]
    return [axis[0].name.strip("/") for axis in scales] if all(scales) else None


def send(answers, item, memory):
    """The bytes of an array, row by row of the file's order."""
    import numpy as np

    limit_memory(memory + 3 * item.size * item.dtype.itemsize)
    array = np.ascontiguousarray(item[...])
    say(answers, {"bytes": array.nbytes})
    answers.write(array.reshape(-1).view(np.uint8).data)
    answers.flush()


if __name__ == "__main__":
    main()
