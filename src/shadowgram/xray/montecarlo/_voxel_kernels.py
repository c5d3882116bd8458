"""The material at a place in a voxel volume."""

from __future__ import annotations

import numpy as np

from ._jit import kernel


@kernel
def _cell(x, pitch, cells):
    """The cell along one axis; places outside belong to the cell at the border."""
    return min(max(np.int64(x / pitch), 0), cells - 1)


@kernel
def voxel_material(voxels, volume, x, y, z):
    """The index of the material at a place in the volume's own frame, mm."""
    nx, ny, nz = voxels.shape[volume, 0], voxels.shape[volume, 1], voxels.shape[volume, 2]
    ix = _cell(x, voxels.pitch[volume, 0], nx)
    iy = _cell(y, voxels.pitch[volume, 1], ny)
    iz = _cell(z, voxels.pitch[volume, 2], nz)
    return np.int64(voxels.material[voxels.start[volume] + (ix * ny + iy) * nz + iz])
