"""Reading and writing datacubes: native NetCDF, MATLAB and NumPy files.

`native`, `hdf5_isolated`, `mat5` and `numpy_files` each list the variables of one kind of file; `choose` picks the
cube, its axes and its wavelengths among them; `cube` has the two public doors.
"""

from .arrays import read_array as read_array
from .cube import read as read
from .cube import write as write
from .frames import Frames as Frames
from .frames import read_frames as read_frames

__all__ = ["Frames", "read", "read_array", "read_frames", "write"]
