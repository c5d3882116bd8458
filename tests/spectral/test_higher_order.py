"""Oblique footprints, real shears and measured dispersion of the CASSI family, against dense matrices from the integral."""

import dataclasses
import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import shadowgram as sg
from shadowgram.measurement import imager_from_json, imager_to_json
from shadowgram.operators import as_matrix, norm, shot_gram

KINDS = [sg.CASSI, sg.DualCASSI, sg.ColoredCASSI]
WAVELENGTHS = (450.0, 650.0)
# Steeper in the blue, as glass is; it begins inside the range of the imager and ends inside it, so both ends are extended.
PRISM = ((460.0, 3.0), (500.0, 6.1), (540.0, 8.0), (600.0, 9.9), (640.0, 10.6))

LAWS = [
    *({"band_shift": shift} for shift in (0.6, 1, 1.5, 2, 2.37, 0.25)),
    {"dispersion": PRISM},
    {"dispersion": ((400.0, -4.0), (700.0, 5.5))},
]
SHAPES = [(3, 4, 6), (4, 3, 7), (1, 3, 5), (7, 2, 3)]


def make(kind, shape=(4, 3, 7), **changes):
    return kind(**({"cube_shape": shape, "wavelengths": WAVELENGTHS} | changes))


def make_code(imager, seed=0, shots=3):
    if isinstance(imager, sg.ColoredCASSI):
        return sg.codes.colored(shots=shots, shape=imager.code_shape, seed=seed)
    return sg.codes.boolean(shots=shots, shape=imager.code_shape, seed=seed)


def slope_at(i, nm, px):
    """Derivative of the monotone cubic in point i: Fritsch and Butland's inside, at the ends three points', never negative."""
    h = [b - a for a, b in itertools.pairwise(nm)]
    d = [(b - a) / c for (a, b), c in zip(itertools.pairwise(px), h, strict=True)]
    if len(d) == 1:
        return d[0]
    if 0 < i < len(d):
        w1, w2 = 2 * h[i] + h[i - 1], h[i] + 2 * h[i - 1]
        return (w1 + w2) / (w1 / d[i - 1] + w2 / d[i])
    (h0, h1), (d0, d1) = (h[:2], d[:2]) if i == 0 else (h[:-3:-1], d[:-3:-1])
    return max(0.0, ((2 * h0 + h1) * d0 - h0 * d1) / (h0 + h1))


def on_curve(curve, wavelength):
    """Displacement at one wavelength, by the Hermite form of the cubic."""
    nm, px = zip(*curve, strict=True)
    if wavelength < nm[0]:
        return px[0] + slope_at(0, nm, px) * (wavelength - nm[0])
    if wavelength > nm[-1]:
        return px[-1] + slope_at(len(nm) - 1, nm, px) * (wavelength - nm[-1])
    i = max(j for j in range(len(nm) - 1) if nm[j] <= wavelength)
    h, t = nm[i + 1] - nm[i], (wavelength - nm[i]) / (nm[i + 1] - nm[i])
    ends = (1 + 2 * t) * (1 - t) ** 2 * px[i] + t * t * (3 - 2 * t) * px[i + 1]
    return ends + h * (t * (1 - t) ** 2 * slope_at(i, nm, px) - t * t * (1 - t) * slope_at(i + 1, nm, px))


def displaced(imager, law, position, bands):
    """D at `position` bands, of which there are `bands`, from the shortest wavelength."""
    if "band_shift" in law:
        return law["band_shift"] * (position - 0.5)
    low, high = imager.wavelengths
    at = [on_curve(law["dispersion"], low + (high - low) * p / bands) for p in (position, 0.5)]
    return at[0] - at[1]


def share(pixel, a, b):
    """Part of the voxel [0, 1] that lies on [pixel, pixel + 1] when it is displaced evenly by a to b.

    The overlap is piecewise linear in the displacement, so the trapezoid rule between its breaks is exact.
    """

    def overlap(d):
        return max(0.0, 1 - abs(d - pixel))

    if a == b:
        return overlap(a)
    breaks = sorted({a, b, *(c for c in (pixel - 1, pixel, pixel + 1) if a < c < b)})
    return sum((v - u) * (overlap(u) + overlap(v)) / 2 for u, v in itertools.pairwise(breaks)) / (b - a)


def band_displacements(imager, law, bands):
    """(a, b) of each band by the equation; `bands` is what the law counts in."""
    count = imager.cube_shape[0]
    if imager.shear == "centre":
        return [(displaced(imager, law, (k + 0.5) * bands / count, bands),) * 2 for k in range(count)]
    edges = [displaced(imager, law, k * bands / count, bands) for k in range(count + 1)]
    return list(itertools.pairwise(edges))


def sensing_matrix(imager, code, law, bands=None):
    """H from g(x, y) = ∫ t f (x − D(λ), y, λ) dλ, or ∫ t(x + D(λ), y) f(x, y, λ) dλ, by plain loops."""
    count, ny, nx = imager.cube_shape
    bands = bands or count
    extra = math.ceil(displaced(imager, law, bands - 0.5, bands) - 1e-9)
    dual = isinstance(imager, sg.DualCASSI)
    H = np.zeros((len(code), ny, nx if dual else nx + extra, count, ny, nx))
    for (k, (a, b)), x, m in itertools.product(
        enumerate(band_displacements(imager, law, bands)), range(nx), range(nx + extra)
    ):
        part = share(m - x, a, b)
        for q, y in itertools.product(range(len(code)), range(ny)):
            if dual:
                H[q, y, x, k, y, x] += part * code[q, y, m]
            else:
                H[q, y, m, k, y, x] = part * (code[q, k, y, x] if code.ndim == 4 else code[q, y, x])
    return H.reshape(math.prod(H.shape[:3]), -1)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("law", LAWS, ids=str)
@pytest.mark.parametrize("shear", ["centre", "exact"])
def test_operator_equals_the_dense_matrix(kind, law, shear):
    for shape, gray in itertools.product(SHAPES, (False, True)):
        imager = make(kind, shape, shear=shear, **law)
        code = make_code(imager)
        if gray:
            code = np.random.default_rng(0).random(code.shape, dtype=np.float32)
        H = imager.operator(code)
        wanted = sensing_matrix(imager, code.astype(float), law)
        assert np.abs(as_matrix(H) - wanted).max() < 1e-12
        assert np.abs(as_matrix(H.H) - wanted.T).max() < 1e-12
        assert sg.testing.dot_test(H) < 1e-12
        assert sg.testing.dot_test(H, np.float32) < 1e-5


@pytest.mark.parametrize("shots", [1, 2, 9])
@pytest.mark.parametrize("kind", KINDS)
def test_any_number_of_shots(kind, shots):
    imager = make(kind, band_shift=1.3, shear="exact")
    code = make_code(imager, shots=shots)
    wanted = sensing_matrix(imager, code, {"band_shift": 1.3})
    assert np.abs(as_matrix(imager.operator(code)) - wanted).max() < 1e-12


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("law", [LAWS[2], LAWS[6]], ids=str)
def test_finer_bands_on_the_same_instrument(kind, law):
    imager = make(kind, (3, 2, 5), **law)
    fine = imager.finer(4)
    code = make_code(fine)
    wanted = sensing_matrix(fine, code, law, bands=3)
    assert np.abs(as_matrix(fine.operator(code)) - wanted).max() < 1e-12
    assert fine.cube_shape == (12, 2, 5)
    assert fine.operator(code).out_shape == imager.operator(make_code(imager)).out_shape
    assert fine.code_shape[-2:] == imager.code_shape[-2:]
    assert imager.finer(2).finer(2) == fine
    centres = fine.displacements.reshape(3, 4)
    assert centres[0, 0] < 0
    assert (centres[:, 0] < imager.displacements).all()
    assert (centres[:, -1] > imager.displacements).all()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("shift", [0.6, 1, 2, 2.37])
def test_finer_bands_of_a_flat_spectrum_measure_like_the_exact_shear(kind, shift):
    imager = make(kind, (4, 5, 11), band_shift=shift, shear="exact")
    code, cube = make_code(imager), np.random.default_rng(0).random((4, 5, 11))
    repeated = np.repeat(code, 64, axis=1) if kind is sg.ColoredCASSI else code
    measured = imager.finer(64).operator(repeated).forward(np.repeat(cube, 64, axis=0)) / 64
    np.testing.assert_allclose(measured, imager.operator(code).forward(cube), rtol=1e-12, atol=1e-12)
    first_order = dataclasses.replace(imager, shear="centre").operator(code).forward(cube)
    assert np.abs(measured - first_order).max() > 0.05


def test_finer_bands_see_the_bend_of_a_curve_within_a_band():
    # Between its edges the exact shear takes a band as evenly spread, and the curve is not: the error falls with the bands' width.
    errors = []
    for bands in (4, 8, 16):
        imager = make(sg.CASSI, (bands, 1, 30), dispersion=PRISM, shear="exact")
        cube = np.ones((bands, 1, 30))
        code = np.random.default_rng(0).random((1, 1, 30))
        measured = imager.finer(64).operator(code).forward(np.repeat(cube, 64, axis=0)) / 64
        errors.append(np.abs(measured - imager.operator(code).forward(cube)).mean() / bands)
    assert errors[0] > 2 * errors[1] > 4 * errors[2] > 0


@pytest.mark.parametrize("kind", KINDS)
def test_whole_shifts_of_the_centre_are_the_classical_model(kind):
    cube = np.random.default_rng(0).random((5, 3, 8), dtype=np.float32)
    straight = ((400.0, 10.0), (800.0, 30.0))  # 2 px over the 40 nm of a band
    imagers = [
        make(kind, cube.shape, **law) for law in ({"band_shift": 2}, {"band_shift": 2.0}, {"dispersion": straight})
    ]
    code = make_code(imagers[0])
    wanted = np.zeros((3, 3, 8 if kind is sg.DualCASSI else 16), np.float32)
    for q, k, y, x in itertools.product(range(3), range(5), range(3), range(8)):
        seen = code[q, k, y, x] if code.ndim == 4 else code[q, y, x + 2 * k] if kind is sg.DualCASSI else code[q, y, x]
        wanted[q, y, x if kind is sg.DualCASSI else x + 2 * k] += seen * cube[k, y, x]
    for imager in imagers:
        H = imager.operator(code)
        assert type(H).__name__ in {"ShiftOperator", "ColoredOperator"}
        assert np.array_equal(H.forward(cube), wanted)


def test_footprint_of_a_unit_shift():
    imager = make(sg.CASSI, (3, 1, 3), shear="exact")
    H = imager.operator(np.ones((1, 3)))
    point = np.zeros((3, 1, 3))
    point[1, 0, 1] = 1
    np.testing.assert_allclose(H.forward(point)[0, 0], [0, 1 / 8, 3 / 4, 1 / 8, 0], atol=1e-15)
    assert imager.band_shift == 1


def test_two_pixels_a_band_as_in_the_kaist_captures():
    imager = make(sg.CASSI, (28, 4, 16), band_shift=2, shear="exact")
    H = imager.operator(np.ones((4, 16)))
    assert H.out_shape == (1, 4, 16 + 54)
    point = np.zeros(H.in_shape)
    point[9, 2, 7] = 1
    assert dict(enumerate(H.forward(point)[0, 2].round(14))) == dict.fromkeys(range(70), 0.0) | {
        24: 0.25,
        25: 0.5,
        26: 0.25,
    }


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("law", LAWS, ids=str)
@pytest.mark.parametrize("shear", ["centre", "exact"])
def test_vignetting_is_the_light_that_an_open_code_loses(kind, law, shear):
    imager = make(kind, (4, 2, 6), shear=shear, **law)
    for one, cells in ((imager, 4), (imager.finer(3), 12)):
        H = one.operator(np.ones(one.code_shape))
        kept = H.adjoint(np.ones(H.out_shape)).mean(axis=(1, 2))
        np.testing.assert_allclose(one.resolution.vignetted, 1 - kept, atol=1e-12)
        assert len(one.resolution.vignetted) == cells
    if shear == "centre":
        assert imager.resolution.vignetted == (0.0,) * 4
    else:
        assert imager.resolution.vignetted[0] > 0


def test_vignetting_of_the_unit_shift():
    # An eighth of the first column in the first band falls left of the detector; likewise on the right in the last band.
    imager = make(sg.CASSI, (5, 1, 8), shear="exact")
    np.testing.assert_allclose(imager.resolution.vignetted, [1 / 64, 0, 0, 0, 1 / 64], atol=1e-15)
    assert imager.resolution.spectral_extents == (40.0, 40.0)


@settings(deadline=None, max_examples=60)
@given(
    kind=st.sampled_from(KINDS),
    shift=st.one_of(st.floats(1e-12, 9), st.floats(0.5, 4).map(lambda d: round(d) + 1e-10)),
    shape=st.tuples(st.integers(1, 5), st.integers(1, 2), st.integers(1, 7)),
    shear=st.sampled_from(["centre", "exact"]),
    factor=st.integers(0, 5),
    seed=st.integers(0, 99),
)
def test_complementary_shots_keep_the_light(kind, shift, shape, shear, factor, seed):
    imager = make(kind, shape, band_shift=shift, shear=shear)
    imager = imager.finer(factor) if factor else imager
    H = imager.operator(make_code(imager, seed))
    cube = np.random.default_rng(seed).random(H.in_shape)
    snapshots = H.forward(cube)
    opened = imager.operator(np.ones(imager.code_shape)).forward(cube)
    assert (snapshots >= 0).all()
    np.testing.assert_allclose(snapshots.sum(axis=0), opened[0], rtol=1e-12, atol=1e-12)
    if not any(imager.resolution.vignetted):
        assert snapshots.sum() == pytest.approx(cube.sum(), rel=1e-8)
    assert sg.testing.dot_test(H) < 1e-12


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("shift", [0.6, 1, 2.37])
def test_gram_and_norm(kind, shift):
    imager = make(kind, (4, 2, 5), band_shift=shift, shear="exact")
    H = imager.operator(np.random.default_rng(0).random((2, *imager.code_shape)))
    M, gram = as_matrix(H), shot_gram(H)
    if kind is not sg.DualCASSI:
        assert gram is None
        assert norm(H) == pytest.approx(np.linalg.norm(M, 2), rel=0.01)
        return
    wanted = (M @ M.T).reshape(*H.out_shape, *H.out_shape)
    pixels = np.indices(H.out_shape[1:])
    full = np.zeros_like(wanted)
    for a, b in itertools.product(range(2), repeat=2):
        full[a, pixels[0], pixels[1], b, pixels[0], pixels[1]] = gram[a, b]
    assert np.abs(full - wanted).max() < 1e-12
    assert norm(H) == pytest.approx(np.linalg.norm(M, 2), rel=1e-10)


@pytest.mark.parametrize("law", LAWS, ids=str)
def test_effective_code_is_the_code_that_each_voxel_sees(law):
    dual = make(sg.DualCASSI, shear="exact", **law)
    code = np.random.default_rng(0).random((3, *dual.code_shape))
    cube = np.random.default_rng(1).random(dual.cube_shape)
    snapshots = dual.operator(code.astype(np.float32)).forward(cube)
    np.testing.assert_allclose((dual.effective_code(code) * cube).sum(axis=1), snapshots, rtol=1e-12)
    single = make(sg.CASSI, shear="exact", **law)
    assert np.array_equal(
        single.effective_code(code[:, :, :7]), np.repeat(code[:, None, :, :7].astype(np.float32), 4, 1)
    )


def test_curve_goes_through_its_points_and_is_straight_beyond():
    points = ((400.0, -3.0), (500.0, 1.0), (600.0, 7.0))
    imager = make(sg.CASSI, (7, 1, 2), wavelengths=(325.0, 675.0), dispersion=points)
    # centres at 350, 400, …, 650; the ends' slopes are those of the parabola through the three points
    rise = np.array([0.0, 0.03 * 50, np.nan, 0.03 * 50 + 4, np.nan, 0.03 * 50 + 10, 0.03 * 50 + 10 + 0.07 * 50])
    known = ~np.isnan(rise)
    np.testing.assert_allclose(imager.displacements[known], rise[known], rtol=1e-12)
    assert (np.diff(imager.displacements) > 0).all()


def test_a_curve_that_flattens_quickly_goes_on_beyond_its_end():
    points = ((400.0, 0.0), (450.0, 20.0), (700.0, 45.0))  # the parabola through them has its top before 700 nm
    imager = make(sg.CASSI, (16, 1, 2), wavelengths=(400.0, 800.0), dispersion=points)
    assert np.diff(imager.displacements).min() > 0.5  # a third of the last 0.1 px/nm, over 25 nm


def test_a_curve_of_arrays_and_lists_becomes_pairs():
    for curve in (np.array(PRISM), [list(pair) for pair in PRISM]):
        assert make(sg.CASSI, dispersion=curve) == make(sg.CASSI, dispersion=PRISM)
        assert hash(make(sg.CASSI, dispersion=curve)) == hash(make(sg.CASSI, dispersion=PRISM))


def test_a_straight_curve_is_an_even_shift():
    straight = make(sg.CASSI, shear="exact", dispersion=((450.0, 5.0), (650.0, 10.2)))
    even = make(sg.CASSI, shear="exact", band_shift=1.3)
    code = make_code(even)
    assert np.abs(as_matrix(straight.operator(code)) - as_matrix(even.operator(code))).max() < 1e-12


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("law", [{}, *LAWS], ids=str)
def test_imagers_survive_json(kind, law):
    for imager in (make(kind, **law), make(kind, shear="exact", **law), make(kind, **law).finer(3)):
        assert imager_from_json(imager_to_json(imager)) == imager


@pytest.mark.parametrize("kind", KINDS)
def test_files_of_the_first_version_are_read(kind):
    text = '{"type": "%s", "cube_shape": [4, 3, 7], "wavelengths": [450, 650], "pitch": 10.0, "band_shift": 1}'
    assert imager_from_json(text % kind.__name__) == make(kind)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"band_shift": 0}, "band_shift must be a positive number of pixels"),
        ({"band_shift": -1.5}, "band_shift must be a positive number"),
        ({"band_shift": math.nan}, "band_shift must be a positive number"),
        ({"band_shift": math.inf}, "band_shift must be a positive number"),
        ({"band_shift": 10**400}, "band_shift must be a positive number"),
        ({"band_shift": True}, "band_shift must be a positive number"),
        ({"band_shift": "2"}, "band_shift must be a positive number"),
        ({"band_shift": 4000.0}, "over 1.6e.04 pixels, more than 10000"),
        ({"cube_shape": (10**9, 1, 1)}, "1000000000 bands, more than 10000"),
        ({"shear": "center"}, "shear must be one of 'centre', 'exact', got 'center'"),
        ({"reference_bands": 0}, "reference_bands must be a whole number"),
        ({"band_shift": 1, "dispersion": PRISM}, "band_shift or dispersion, not both"),
        ({"dispersion": PRISM[:1]}, "at least two pairs"),
        ({"dispersion": ()}, "at least two pairs"),
        ({"dispersion": 3.0}, "at least two pairs"),
        ({"dispersion": "prism"}, "at least two pairs"),
        ({"dispersion": ((450.0, 1.0, 2.0), (650.0, 2.0, 3.0))}, "at least two pairs"),
        ({"dispersion": np.zeros((2, 2, 2))}, "at least two pairs"),
        ({"dispersion": ((450.0, 0.0), (550.0, math.nan), (650.0, 2.0))}, r"finite numbers, got \(550.0, nan\)"),
        ({"dispersion": ((450.0, 0.0), (math.inf, 2.0))}, r"finite numbers, got \(inf, 2.0\)"),
        ({"dispersion": ((450.0, 0.0), (650.0, 4.0), (550.0, 5.0))}, "must ascend, got 550 nm after 650 nm"),
        ({"dispersion": ((450.0, 0.0), (450.0, 4.0))}, "must ascend, got 450 nm after 450 nm"),
        ({"dispersion": ((450.0, 9.0), (550.0, 4.0), (650.0, 1.0))}, "mirror the images"),
        (
            {"dispersion": ((450.0, 0.0), (550.0, 4.0), (600.0, 3.0), (650.0, 9.0))},
            "got 3 px at 600 nm after 4 px at 550",
        ),
        ({"dispersion": ((450.0, 0.0), (550.0, 4.0), (650.0, 4.0))}, "measure these points again"),
        (
            {"dispersion": ((551.0, 0.0), (650.0, 4.0))},
            "extended to 501.5 to 699.5 nm, which does not hold the imager's 450",
        ),
        ({"dispersion": ((450.0, 0.0), (550.0, 4.0))}, "extended to 400 to 600 nm"),
        ({"dispersion": ((450.0, 0.0), (650.0, 1e5))}, "over 1e.05 pixels, more than 10000"),
        ({"dispersion": ((450.0, -1e308), (650.0, 1e308))}, "pixels, more than 10000"),
        ({"dispersion": ((549.9999999999999, 0.0), (550.0, 1e308), (700.0, 1.1e308))}, "got 550 nm after 550 nm"),
    ],
)
def test_impossible_dispersions(kind, changes, message):
    with pytest.raises(ValueError, match=message) as caught:
        make(kind, **changes)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("factor", [0, 1.5, True, -2])
def test_impossible_factors(kind, factor):
    with pytest.raises(ValueError, match="factor must be a whole number"):
        make(kind).finer(factor)


@pytest.mark.parametrize("kind", KINDS)
def test_results_do_not_depend_on_threads(kind):
    imager = make(kind, (5, 40, 9), band_shift=1.4, shear="exact")
    H = imager.operator(make_code(imager))
    cube = np.random.default_rng(0).random(H.in_shape, dtype=np.float32)
    with sg.threads(1):
        snapshots = H.forward(cube)
        back = H.adjoint(snapshots)
    with sg.threads(3):
        assert np.array_equal(H.forward(cube), snapshots)
        assert np.array_equal(H.adjoint(snapshots), back)
