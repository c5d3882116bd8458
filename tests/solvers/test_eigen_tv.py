"""EigenTV: its kernels against NumPy, its solution against plain total variation, and what it promises to callers."""

import tracemalloc
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import shadowgram as sg
from shadowgram.operators.base import LinearOperator
from shadowgram.operators.structure import shot_gram
from shadowgram.priors.tv import tv
from shadowgram.solvers import _eigen_tv_kernels as kernels
from shadowgram.solvers._noise_level import noise_level


@dataclass(frozen=True, eq=False)
class Times(LinearOperator):
    """A multiple of another operator, whose Gram matrices are not known."""

    of: LinearOperator
    factor: float = 1.0

    @property
    def in_shape(self):
        return self.of.in_shape

    @property
    def out_shape(self):
        return self.of.out_shape

    def _forward(self, x, out):
        self.of._forward(x, out)
        out *= self.factor

    def _adjoint(self, y, out):
        self.of._adjoint(y, out)
        out *= self.factor


def scene(bands=6, rows=32, columns=40, dtype=np.float32):
    """Two rectangles and a disc with smooth spectra."""
    y, x = np.mgrid[:rows, :columns] / min(rows, columns)
    k = np.linspace(0, 1, bands)[:, None, None]
    cube = 0.3 + 0.2 * k + 0 * x
    cube = np.where((y > 0.2) & (y < 0.6) & (x > 0.1) & (x < 0.5), 0.9 - 0.6 * k, cube)
    cube = np.where((y - 0.5) ** 2 + (x - 0.8) ** 2 < 0.06, 0.2 + 0.7 * np.sin(3 * k), cube)
    return cube.astype(dtype)


def problem(cube, shots=3, imager=sg.DualCASSI, snr_db=None):
    device = imager(cube_shape=cube.shape, wavelengths=(450, 650))
    make = sg.codes.random if shots == 1 else sg.codes.boolean
    H = device.operator(make(shots=shots, shape=device.code_shape, seed=0))
    y = H.forward(cube)
    return H, (y if snr_db is None else sg.noise.awgn(y, snr_db=snr_db, seed=0).astype(cube.dtype))


@pytest.mark.parametrize("shots", [1, 2, 5])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_gram_kernels_equal_numpy(shots, dtype):
    codes = np.random.default_rng(0).random((shots, 4, 6, 7))
    gram = np.einsum("qkij,pkij->qpij", codes, codes).astype(dtype)
    inverse, w = np.empty_like(gram), np.empty((shots, 6, 7), dtype)
    kernels.invert_gram(0, 6, gram, dtype(0.1), inverse)
    expected = np.linalg.inv(np.moveaxis(gram, (0, 1), (2, 3)).astype(float) + 0.1 * np.eye(shots))
    rtol = 1e-12 if dtype is np.float64 else 1e-4
    assert np.allclose(np.moveaxis(inverse, (0, 1), (2, 3)), expected, rtol=rtol, atol=rtol)
    r = np.random.default_rng(1).random((shots, 6, 7)).astype(dtype)
    kernels.apply_gram(0, 6, inverse, r, w)
    assert np.allclose(w, np.einsum("qpij,pij->qij", inverse, r), rtol=rtol, atol=rtol)


@pytest.mark.parametrize("bands", [1, 3, 4, 7, 8, 13])
def test_row_kernels_equal_numpy(bands):
    rng = np.random.default_rng(bands)
    z, t, a = rng.standard_normal((3, bands, 5, 9))
    basis = np.linalg.qr(rng.standard_normal((bands, bands)))[0]
    expected = a + 1.6 * (z - a - t)
    c = np.empty_like(z)
    kernels.to_eigen(0, 5, basis, z, t, 1.6, a, c)
    assert np.allclose(a, expected)
    assert np.allclose(c, np.tensordot(basis, expected, 1))

    before, sums = z.copy(), np.zeros((5, 2))
    new = np.maximum(np.tensordot(basis.T, c, 1), 0)
    kernels.from_eigen(0, 5, np.ascontiguousarray(basis.T), c, a, 0.0, z, sums)
    assert np.allclose(z, new)
    assert np.allclose(c, 2 * new - a)
    assert np.allclose(sums, np.stack([((new - before) ** 2).sum((0, 2)), (new**2).sum((0, 2))], axis=1))

    u = a - z
    kernels.rescale(0, 5, 0.3, z, a, c)
    assert np.allclose(a, z + 0.3 * u)
    assert np.allclose(c, z - 0.3 * u)

    p = rng.standard_normal((bands, 2, 5, 9))
    expected = np.tensordot(basis, p, 1)
    kernels.rotate_duals(0, 5, basis, p)
    assert np.allclose(p, expected)

    moments = np.zeros((5, 2, bands, bands))
    kernels.moments(0, 5, z, moments)
    gx, gy = np.diff(z, axis=2).reshape(bands, -1), np.diff(z, axis=1).reshape(bands, -1)
    flat = z.reshape(bands, -1)
    assert np.allclose(moments.sum(0), [flat @ flat.T, gx @ gx.T + gy @ gy.T])


@pytest.mark.parametrize("imager", [sg.CASSI, sg.DualCASSI, sg.ColoredCASSI])
def test_reconstructs_a_scene_of_flat_patches(imager):
    cube = scene()
    device = imager(cube_shape=cube.shape, wavelengths=(450, 650))
    if imager is sg.ColoredCASSI:
        code = sg.codes.colored(shots=3, shape=device.code_shape, filters="ideal", seed=0)
    else:
        code = sg.codes.boolean(shots=3, shape=device.code_shape, seed=0)
    H = device.operator(code)
    solution = sg.solve(sg.EigenTV(), H, H.forward(cube))
    assert solution.converged
    assert sg.metrics.psnr(solution.x, cube, peak=1.0) > 32
    noisy = sg.solve(sg.EigenTV(), H, sg.noise.awgn(H.forward(cube), snr_db=30, seed=0))
    assert sg.metrics.psnr(noisy.x, cube, peak=1.0) > 30


def test_one_band_seen_directly_is_plain_total_variation():
    image = scene(bands=1, dtype=np.float64) + 0.05 * np.random.default_rng(0).standard_normal((1, 32, 40))
    imager = sg.DualCASSI(cube_shape=image.shape, wavelengths=(450, 650))
    H = imager.operator(np.ones((1, 32, 40)))
    solution = sg.solve(sg.EigenTV(noise=0.05, tol=1e-7, max_iter=1000), H, image)
    assert solution.converged
    expected = tv(image, solution.history["lambda"][-1], tol=1e-9, max_iter=50_000)
    assert np.abs(solution.x - expected).max() < 1e-4


@pytest.mark.parametrize("snr_db", [None, 30])
def test_units_of_light_and_of_the_operator_do_not_matter(snr_db):
    H, y = problem(scene(), snr_db=snr_db)
    x = sg.solve(sg.EigenTV(), H, y).x
    scale = np.abs(x).max()
    assert np.abs(sg.solve(sg.EigenTV(), H, 100 * y).x / 100 - x).max() < 1e-3 * scale
    assert np.abs(sg.solve(sg.EigenTV(), H, y * np.float32(1e-20)).x / 1e-20 - x).max() < 1e-3 * scale
    known = sg.solve(sg.EigenTV(noise=0.01), H, y).x
    assert np.abs(sg.solve(sg.EigenTV(noise=1.0), H, 100 * y).x / 100 - known).max() < 1e-3 * scale
    weak = sg.solve(sg.EigenTV(), Times(H, 0.02), y * np.float32(0.02)).x
    assert np.abs(weak - x).max() < 2e-2 * scale


def test_conjugate_gradients_lead_to_the_same_cube():
    cube = scene()
    for snr_db in (None, 30):
        H, y = problem(cube, snr_db=snr_db)
        assert shot_gram(H) is not None
        assert shot_gram(Times(H)) is None
        direct, iterative = sg.solve(sg.EigenTV(), H, y), sg.solve(sg.EigenTV(), Times(H), y)
        assert iterative.converged
        assert sg.metrics.psnr(iterative.x, direct.x, peak=1.0) > 45


def test_super_resolving_sscsi_is_solved():
    imager = sg.SSCSI(
        detector_shape=(16, 16), detector_pitch=20.0, code_pitch=10.0, mask_position=0.1, wavelengths=(450, 650)
    )
    assert imager.resolution.regime == "super-resolving"
    cube = scene(*imager.resolution.cube_shape)
    H = imager.operator(sg.codes.boolean(shots=8, shape=imager.code_shape, seed=0))
    assert sg.metrics.psnr(sg.solve(sg.EigenTV(), H, H.forward(cube)).x, cube, peak=1.0) > 28


@pytest.mark.parametrize("kind", ["curved dispersion", "beside a picture", "exact shear"])
def test_any_operator_is_solved(kind):
    cube = scene(bands=8, rows=48, columns=48)
    if kind == "exact shear":
        imager = sg.SSCSI(
            detector_shape=(48, 48), detector_pitch=10.0, code_pitch=10.0, mask_position=0.17, wavelengths=(450, 650)
        )
        cube = scene(*imager.resolution.cube_shape)
    else:
        curve = ((450, 0.0), (550, 4.3), (650, 9.7))
        imager = sg.CASSI(cube_shape=cube.shape, wavelengths=(450, 650), dispersion=curve)
    H = imager.operator(sg.codes.boolean(shots=3, shape=imager.code_shape, seed=0))
    if kind == "beside a picture":
        H = sg.operators.stack(H, sg.operators.SpectralResponse.pan(cube.shape))
    assert (shot_gram(H) is None) == (kind != "exact shear")
    solution = sg.solve(sg.EigenTV(), H, H.forward(cube))
    assert solution.converged
    assert sg.metrics.psnr(solution.x, cube, peak=1.0) > 30


def test_a_narrow_thing_keeps_one_place_in_all_bands_of_a_single_disperser():
    bands, columns = 16, np.arange(72)
    spectrum = np.linspace(0.3, 1, bands, dtype=np.float32)[:, None, None]
    ripple = 0.7 + 0.3 * np.sin(np.arange(40))[:, None]
    cube = (spectrum * ripple * (np.abs(columns - 35) < 5)).astype(np.float32)
    imager = sg.CASSI(cube_shape=cube.shape, wavelengths=(450, 650), band_shift=2)
    H = imager.operator(sg.codes.boolean(shots=1, shape=imager.code_shape, seed=0))
    x = sg.solve(sg.EigenTV(), H, sg.noise.awgn(H.forward(cube), snr_db=30, seed=0).astype(np.float32)).x
    profiles = x.mean(axis=1)
    places = profiles @ columns / profiles.sum(axis=1)
    assert np.abs(places - 35).mean() < 1.5
    assert sg.metrics.psnr(x, cube, peak=1.0) > 26


def test_photon_noise_is_seen_where_it_is_bright():
    cube = scene(bands=24, rows=64, columns=64) * np.where(np.arange(64) < 32, 0.1, 1).astype(np.float32)
    H, y = problem(cube, shots=3)
    grain = 0.02
    y = (grain * np.random.default_rng(0).poisson(y / grain)).astype(np.float32)
    known = float(np.sqrt(grain * y.mean()))
    assert noise_level(H, y) < 0.6 * known
    blind, told = (sg.metrics.psnr(sg.solve(sg.EigenTV(noise=one), H, y).x, cube, peak=1.0) for one in (None, known))
    assert blind > told - 0.5


def test_threads_do_not_change_a_bit():
    H, y = problem(scene(bands=5, rows=70), snr_db=30)
    found = []
    for count in (1, 2, 5):
        with sg.threads(count):
            found.append(sg.solve(sg.EigenTV(max_iter=12), H, y))
    for other in found[1:]:
        assert np.array_equal(other.x, found[0].x)
        for name in ("residual", "change", "lambda", "mu"):
            assert other.history[name] == found[0].history[name]


@settings(max_examples=25, deadline=None)
@given(
    st.tuples(st.integers(1, 6), st.integers(1, 12), st.integers(1, 12)),
    st.integers(1, 4),
    st.sampled_from([sg.CASSI, sg.DualCASSI]),
    st.sampled_from([np.float32, np.float64]),
)
def test_any_shape_gives_a_finite_cube(shape, shots, imager, dtype):
    cube = np.random.default_rng(0).random(shape).astype(dtype)
    H, y = problem(cube, shots, imager)
    solution = sg.solve(sg.EigenTV(max_iter=15), H, y)
    assert solution.x.shape == shape
    assert solution.x.dtype == dtype
    assert np.isfinite(solution.x).all()
    assert (solution.x >= 0).all()


def test_one_shot_and_odd_sizes_come_close_to_a_flat_scene():
    spectrum = np.array([0.2, 0.9, 0.5])[:, None, None]
    for imager in (sg.CASSI, sg.DualCASSI):
        cube = np.broadcast_to(spectrum, (3, 7, 9)).astype(np.float32)
        H, y = problem(cube, 1, imager)
        assert sg.metrics.psnr(sg.solve(sg.EigenTV(), H, y).x, cube, peak=1.0) > 25


@pytest.mark.parametrize("operator", [lambda H: H, Times], ids=["direct", "conjugate gradients"])
def test_the_history_is_true(operator):
    H, y = problem(scene(), snr_db=30)
    said = []
    solution = sg.solve(sg.EigenTV(), operator(H), y, callback=lambda i, values: said.append((i, values)))
    assert solution.converged
    assert set(solution.history) == {"residual", "change", "lambda", "mu", "seconds"}
    assert all(len(values) == solution.iterations for values in solution.history.values())
    assert [i for i, _ in said] == list(range(1, solution.iterations + 1))
    assert said[-1][1] == {name: values[-1] for name, values in solution.history.items()}
    assert solution.history["residual"][-1] == pytest.approx(np.linalg.norm(H.forward(solution.x) - y), rel=1e-3)
    assert solution.history["change"][-1] < sg.EigenTV().tol
    stopped = sg.solve(sg.EigenTV(max_iter=7), operator(H), y)
    assert not stopped.converged
    assert stopped.iterations == 7
    assert stopped.history["change"] == solution.history["change"][:7]


def test_an_interrupt_returns_the_estimate_so_far():
    H, y = problem(scene())

    def stop(iteration, _):
        if iteration == 7:
            raise KeyboardInterrupt

    solution = sg.solve(sg.EigenTV(), H, y, callback=stop)
    assert solution.interrupted
    assert not solution.converged
    assert solution.iterations == 7
    assert np.array_equal(solution.x, sg.solve(sg.EigenTV(max_iter=7), H, y).x)


def test_more_noise_is_smoothed_more():
    H, y = problem(scene(), snr_db=25)

    def roughness(x):
        return np.abs(np.diff(x, axis=1)).sum() + np.abs(np.diff(x, axis=2)).sum()

    found = [sg.solve(sg.EigenTV(noise=noise), H, y) for noise in (0.01, 0.03, 0.1)]
    weights = [solution.history["lambda"][-1] for solution in found]
    assert weights[1] / weights[0] == pytest.approx(3**1.25, rel=0.05)
    assert roughness(found[0].x) > roughness(found[1].x) > roughness(found[2].x)


def test_the_noise_found_in_the_data_serves_as_well_as_the_true_one():
    cube = scene(bands=8, rows=64, columns=64)
    for snr_db in (20, 30):
        H, y = problem(cube, shots=4, snr_db=snr_db)
        noise = float(np.std(y - H.forward(cube)))
        quality = [
            sg.metrics.psnr(sg.solve(spec, H, y).x, cube, peak=1.0) for spec in (sg.EigenTV(), sg.EigenTV(noise=noise))
        ]
        assert abs(quality[0] - quality[1]) < 1.0


@pytest.mark.parametrize("imager", [sg.CASSI, sg.DualCASSI])
@pytest.mark.parametrize("shots", [1, 3])
def test_the_noise_level_is_found_in_a_scene_with_flat_parts(imager, shots):
    cube = scene(bands=8, rows=96, columns=120)
    H, y = problem(cube, shots, imager)
    y += 0.05 * np.random.default_rng(0).standard_normal(y.shape).astype(np.float32)
    assert noise_level(H, y) == pytest.approx(0.05, rel=0.15)
    assert noise_level(H, 100 * y) == pytest.approx(100 * noise_level(H, y), rel=1e-3)


def test_the_noise_level_of_a_detector_without_a_window_is_zero():
    H, y = problem(scene(bands=6, rows=2, columns=9))
    assert noise_level(H, y) == 0


def test_values_below_zero_are_for_those_who_ask():
    cube = scene() - np.float32(0.5)
    H, y = problem(cube)
    assert sg.solve(sg.EigenTV(), H, y).x.min() == 0
    signed = sg.solve(sg.EigenTV(nonnegative=False), H, y).x
    assert sg.metrics.psnr(signed, cube, peak=1.0) > 28


def test_nothing_seen_is_nothing_reconstructed():
    H, y = problem(scene())
    dark = sg.solve(sg.EigenTV(), H, np.zeros_like(y))
    assert dark.converged
    assert not dark.x.any()
    imager = sg.DualCASSI(cube_shape=H.in_shape, wavelengths=(450, 650))
    closed = imager.operator(np.zeros((3, *imager.code_shape)))
    assert not sg.solve(sg.EigenTV(), closed, y).x.any()


def test_a_detector_that_is_mostly_dark_does_not_hide_the_noise():
    cube = scene(rows=48, columns=48)
    imager = sg.DualCASSI(cube_shape=cube.shape, wavelengths=(450, 650))
    code = sg.codes.boolean(shots=3, shape=imager.code_shape, seed=0)
    code[:, 20:] = 0
    H = imager.operator(code)
    lit = np.s_[:, :20]
    y = H.forward(cube)
    y[lit] += 0.05 * np.random.default_rng(0).standard_normal(y[lit].shape).astype(np.float32)
    x = sg.solve(sg.EigenTV(), H, y).x
    assert sg.metrics.psnr(x[lit], cube[lit], peak=1.0) > 24


def test_memory_stays_below_twelve_cubes():
    imager = sg.SSCSI(
        detector_shape=(128, 128), detector_pitch=10.0, code_pitch=10.0, mask_position=0.1875, wavelengths=(450, 650)
    )
    cube = sg.scenes.chart(size=128, bands=imager.resolution.bands, seed=0).to_numpy().astype(np.float32)
    H = imager.operator(sg.codes.boolean(shots=6, shape=imager.code_shape, seed=0))
    y = H.forward(cube)
    sg.solve(sg.EigenTV(max_iter=6), H, y)  # compile first
    tracemalloc.start()
    try:
        sg.solve(sg.EigenTV(max_iter=6), H, y)
        assert tracemalloc.get_traced_memory()[1] < 12 * cube.nbytes
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"noise": -1.0}, "noise is a standard deviation"),
        ({"noise": np.nan}, "noise is a standard deviation"),
        ({"max_iter": 0}, "max_iter must be a whole number"),
        ({"max_iter": 2.5}, "max_iter must be a whole number"),
        ({"tol": 1.0}, "tol is a relative change"),
    ],
)
def test_settings_are_checked(keywords, message):
    with pytest.raises(ValueError, match=message):
        sg.EigenTV(**keywords)


def test_snapshots_are_checked():
    H, y = problem(scene())
    with pytest.raises(ValueError, match="shape"):
        sg.solve(sg.EigenTV(), H, y[:2])
    with pytest.raises(ValueError, match="NaN"):
        sg.solve(sg.EigenTV(), H, np.full_like(y, np.nan))
    with pytest.raises(ValueError, match=r"cubes \(band, y, x\)"):
        sg.solve(sg.EigenTV(), Flat(), np.ones((4, 4)))


class Flat(LinearOperator):
    """Takes and gives images."""

    in_shape = (4, 4)
    out_shape = (4, 4)

    def _forward(self, x, out):
        out[:] = x

    def _adjoint(self, y, out):
        out[:] = y


def lego(data):
    scipy_io = pytest.importorskip("scipy.io")
    values = scipy_io.loadmat(data / "uis_lego" / "lego.mat")["hyperimg"]
    return np.ascontiguousarray(np.moveaxis(values, 2, 0), np.float32) / 255


def toy(data):
    file = np.load(data / "cave_toy" / "cave_toy_left_512x256x31_u16.npz")
    chosen = (file["wavelength_nm"] >= 420) & (file["wavelength_nm"] <= 650)
    return np.ascontiguousarray(np.moveaxis(file["cube"][:256, :, chosen], 2, 0), np.float32) / 65535


@pytest.mark.parametrize(
    ("read", "shots", "snr_db", "at_least"),
    [
        (lego, 2, None, 32.2),
        (lego, 2, 30, 30.9),
        (lego, 3, None, 33.5),
        (lego, 6, None, 34.8),
        (lego, 6, 30, 33.9),
        (toy, 6, None, 50.0),
        (toy, 3, 30, 38.5),
    ],
)
def test_quality_on_real_cubes_through_sscsi(data, read, shots, snr_db, at_least):
    cube = read(data)
    imager = sg.SSCSI(
        detector_shape=(256, 256), detector_pitch=10.0, code_pitch=10.0, mask_position=0.09375, wavelengths=(420, 650)
    )
    assert imager.resolution.cube_shape == cube.shape
    H = imager.operator(sg.codes.boolean(shots=shots, shape=imager.code_shape, seed=0))
    y = H.forward(cube)
    if snr_db is not None:
        y = sg.noise.awgn(y, snr_db=snr_db, seed=0)
    solution = sg.solve(sg.EigenTV(), H, y)
    assert solution.converged
    assert sg.metrics.psnr(solution.x, cube, peak=1.0) > at_least


def test_quality_on_a_real_cube_through_cassi(data):
    cube = lego(data)
    H, y = problem(cube, 3, sg.CASSI)
    assert sg.metrics.psnr(sg.solve(sg.EigenTV(), H, y).x, cube, peak=1.0) > 29.5
