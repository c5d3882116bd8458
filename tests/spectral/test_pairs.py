"""The tables that code design is made with, against HᵀH of dense matrices, for codes of any transmittance."""

import numpy as np
import pytest

import shadowgram as sg
from shadowgram.operators import as_matrix

# The displacement curve of a prism, px; both ends are extended.
PRISM = ((460.0, 0.0), (500.0, 0.7), (560.0, 1.5), (640.0, 2.1))


def camera(ny, nx, s, ratio=1, **changes):
    geometry = {"detector_shape": (ny, nx), "detector_pitch": 10.0 * ratio, "code_pitch": 10.0, "mask_position": s}
    return sg.SSCSI(wavelengths=(450.0, 650.0), **(geometry | changes))


def cassi(kind, *shape, **changes):
    return kind(cube_shape=shape, wavelengths=(450.0, 650.0), **changes)


LAWS = [{}, {"shear": "exact"}, {"band_shift": 1.3}, {"band_shift": 0.6, "shear": "exact"}, {"dispersion": PRISM}]
CURVED = {"dispersion": PRISM, "shear": "exact"}
SSCSIS = [
    camera(ny, nx, s, ratio, shear=shear)
    for ny, nx, s, ratio in [
        (2, 9, 0.3, 1),
        (3, 6, 0.0, 1),
        (2, 5, 0.3, 2),
        (1, 6, 0.5, 2),
        (2, 4, 0.6, 2),
        (1, 3, 0.4, 3),
    ]
    for shear in ("edge", "centre", "exact")
]
IMAGERS = [
    *SSCSIS,
    camera(2, 9, 0.3, dispersion_ratio=1.7),
    camera(2, 9, 0.4, dispersion_ratio=0.5),
    camera(2, 4, 0.25, 2, dispersion_ratio=2.5),
    camera(2, 9, 0.2, bands=5),
    camera(2, 8, 0.3, bands=2, shear="edge"),
    *(cassi(kind, 4, 2, 7, **law) for kind in (sg.CASSI, sg.DualCASSI) for law in (*LAWS, CURVED)),
    cassi(sg.CASSI, 3, 2, 6, band_shift=2.6, shear="exact"),
    cassi(sg.CASSI, 3, 2, 6, band_shift=8),
    *(cassi(kind, 1, 2, 5, shear=shear) for kind in (sg.CASSI, sg.DualCASSI) for shear in ("centre", "exact")),
    cassi(sg.CASSI, 2, 2, 6).finer(3),
    cassi(sg.DualCASSI, 2, 2, 6).finer(3),
]


def name(imager):
    parts = [type(imager).__name__, "x".join(map(str, imager.code_shape)), imager.shear]
    parts += [getattr(imager, "mask_position", ""), getattr(imager, "band_shift", "")]
    return "-".join(map(str, parts))


def shared_by(table, code):
    """Function of two rows and two first columns: the J² sums E over the shots; elements beside the code are closed."""
    J = table.window
    width = table.first + len(table.pairs) + table.pairs.shape[1] + J
    padded = np.zeros((*code.shape[:2], max(width, code.shape[2]) - min(table.first, 0)))
    padded[:, :, -min(table.first, 0) :][:, :, : code.shape[2]] = code
    offset = table.first - min(table.first, 0)

    def shared(y, a, yy, b):
        left, right = padded[:, y, offset + a :][:, :J], padded[:, yy, offset + b :][:, :J]
        return (left.T @ right).ravel()

    return shared


def from_table(table, code):
    """Σ_{v≠v'} (HᵀH)²_vv', Σ_v (HᵀH)²_vv and Σ_v (HᵀH)_vv, by plain loops over rows, columns and distances."""
    shared = shared_by(table, code)
    size, reach = table.pairs.shape[:2]
    apart = squares = trace = 0.0
    for y in range(code.shape[1]):
        rows = [yy for yy in range(code.shape[1]) if yy // table.rows == y // table.rows]
        for a in range(size):
            own = shared(y, a, y, a)
            squares += own @ table.own[a] @ own
            trace += table.own_linear[a] @ own
            for yy in rows:
                # The same voxel column in another code row is another voxel.
                E = shared(y, a, yy, a)
                apart += E @ table.pairs[a, 0] @ E + (E @ table.own[a] @ E if yy != y else 0)
                for d in range(1, reach):
                    E = shared(y, a, yy, a + d)
                    apart += E @ table.pairs[a, d] @ E
    return apart, squares, trace


@pytest.mark.parametrize("imager", IMAGERS, ids=name)
def test_table_gives_the_gram_cost_of_any_code(imager):
    """Gray codes tell all products of columns apart."""
    table = imager.pair_table()
    code = np.random.default_rng(0).random((2, *imager.code_shape)).astype(np.float32)
    H = as_matrix(imager.operator(code))
    gram = H.T @ H
    own = np.diag(gram)
    assert all(one.dtype == np.float64 for one in (table.pairs, table.own, table.own_linear, table.own_count))
    apart, squares, trace = from_table(table, code.astype(np.float64))
    assert apart == pytest.approx((gram**2).sum() - (own**2).sum(), rel=1e-9)
    assert squares == pytest.approx((own**2).sum(), rel=1e-9)
    assert trace == pytest.approx(own.sum(), rel=1e-9)
    cube = imager.resolution.cube_shape
    assert table.own_count.sum() * imager.code_shape[0] == np.prod(cube)
    assert (table.shape, table.bands) == (imager.code_shape, cube[0])
    assert table.rows == getattr(imager, "pitch_ratio", 1)


@pytest.mark.parametrize("law", [*LAWS, CURVED, {"band_shift": 2.6, "shear": "exact"}, {"band_shift": 9}], ids=str)
@pytest.mark.parametrize("shape", [(4, 2, 6), (3, 3, 5), (1, 2, 4)], ids=str)
def test_voxel_pairs_are_those_of_the_dispersion(shape, law):
    """With a code open everywhere, H is the dispersion alone."""
    imager = cassi(sg.ColoredCASSI, *shape, **law)
    bands, ny, nx = shape
    D = as_matrix(imager.operator(np.ones((1, *shape), np.uint8)))
    gram = (D.T @ D).reshape(bands, ny, nx, bands, ny, nx)
    pairs = imager.voxel_pairs()
    assert pairs.shape == shape
    row = gram[:, 0, :, :, 0].reshape(bands * nx, bands * nx)
    assert np.abs(gram[:, 0, :, :, 1]).max() == 0
    found = np.zeros_like(row)
    for v in range(bands * nx):
        part = slice(pairs.start[v], pairs.start[v + 1])
        assert v not in pairs.partner[part]
        assert len(set(pairs.partner[part])) == part.stop - part.start
        found[v, pairs.partner[part]] = pairs.square[part]
    assert np.abs(pairs.own - np.diag(row)).max() < 1e-12
    assert np.abs(found - row**2 + np.diag(np.diag(row) ** 2)).max() < 1e-12


@pytest.mark.parametrize(
    ("imager", "columns"),
    [
        (camera(4, 16, 0.5, bands=2), 5),
        (camera(2, 8, 0.25, 2, bands=1), 5),
        (cassi(sg.DualCASSI, 3, 4, 9, band_shift=1.6, shear="exact"), 4),
    ],
    ids=str,
)
def test_windows_too_wide(imager, columns):
    with pytest.raises(ValueError, match=f"a voxel sees {columns} code columns at once, and .* at most 3"):
        imager.pair_table()
