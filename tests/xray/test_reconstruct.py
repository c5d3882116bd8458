"""From counts to an image: the model of the air, the Poisson likelihood, what may go wrong, and the author's scans."""

import numpy as np
import pytest
import scipy.io

import shadowgram as sg
from shadowgram.operators.adapters import as_matrix
from shadowgram.xray import _blind
from shadowgram.xray._background import MOST_ORDER, fit_background, fit_poisson
from shadowgram.xray.walls import through_walls


@pytest.fixture(scope="module")
def scan():
    """Codes of a sliding mask, mean counts and noise of a bright bar, with a bowl-shaped background."""
    rng = np.random.default_rng(1)
    truth = np.zeros((16, 16))
    truth[4:12, 5:9], truth[6:9, 11:14] = 40, 80
    mask = (rng.random((16, 16 + 159)) < 0.2).astype(np.uint8)
    codes = np.stack([mask[:, q : q + 16] for q in range(160)])
    light = np.einsum("qyx,yx->q", codes.astype(float), truth)
    air = 1000 + 6.0 * codes.sum(axis=(1, 2)) + 200 * np.linspace(-1, 1, 160) ** 2
    return mask, codes, truth, rng.poisson(air + light).astype(float), rng.poisson(air).astype(float), air


def correlation(a, b):
    return float(np.corrcoef(a.ravel(), b.ravel())[0, 1])


def test_the_image_is_found_and_history_told(scan):
    _, codes, truth, y, air, _ = scan
    calls = []
    found = sg.xray.reconstruct(codes, y, air, callback=lambda n, values: calls.append((n, values)))
    assert found.x.shape == truth.shape
    assert found.x.dtype == np.float64
    assert (found.x >= 0).all()
    assert correlation(found.x, truth) > 0.97
    assert np.vdot(found.x, truth) / np.vdot(truth, truth) == pytest.approx(1, abs=0.1)  # in counts
    assert 0.4 < found.chi2 < 1.6
    assert found.converged
    assert found.background.shape == found.deviation.shape == (160,)
    assert [n for n, _ in calls] == list(range(1, 101))
    assert {len(values) for values in found.history.values()} == {100}
    assert found.history["sigma"][-1] == found.sigma
    assert found.history["sigma"][0] / found.sigma == pytest.approx(_blind.FIRST / _blind.LAST)
    assert np.all(np.diff(found.history["seconds"]) > 0)


def test_a_sliding_mask_is_its_codes_and_results_repeat(scan):
    mask, codes, _, y, air, _ = scan
    one = sg.xray.reconstruct(codes, y, air, denoiser="ffdnet", iterations=20)
    again = sg.xray.reconstruct(codes, y, air, denoiser="ffdnet", iterations=20)
    sliding = sg.xray.reconstruct(mask, y, air, denoiser="ffdnet", iterations=20)
    assert np.array_equal(one.x, again.x)
    assert sliding.x == pytest.approx(one.x, abs=1e-3 * one.x.max())


def test_the_unit_of_the_counts_does_not_matter(scan):
    _, codes, _, y, air, _ = scan
    plain = sg.xray.reconstruct(codes, y, air, iterations=30)
    divided = sg.xray.reconstruct(codes, y / 1000, air / 1000, iterations=30)
    assert 1000 * divided.x == pytest.approx(plain.x, abs=0.01 * plain.x.max())
    assert divided.dispersion == pytest.approx(plain.dispersion / 1000)


@pytest.mark.parametrize("name", ["tv", "bm3d", "ffdnet"])
def test_each_denoiser_works_alone(scan, name):
    _, codes, truth, y, air, _ = scan
    assert correlation(sg.xray.reconstruct(codes, y, air, denoiser=name).x, truth) > 0.9


def test_a_model_of_the_air_has_less_noise_than_the_air(scan):
    _, codes, _, _, air, mean = scan
    found = fit_background(air, codes.sum(axis=(1, 2)).astype(float))
    assert np.mean((found.values - mean) ** 2) < 0.15 * np.mean((air - mean) ** 2)
    assert found.pedestal == pytest.approx(6, abs=2)
    assert found.dispersion == pytest.approx(1, abs=0.3)
    assert found.terms.shape[1] == 2 + 2  # a parabola and the open area


def test_a_background_without_noise_leaves_that_of_the_counts(scan):
    _, codes, truth, y, _, mean = scan
    for air, counts in ((mean, y), (np.full(160, 1000.0), y), (np.full(160, 1000.0), y + 0.5)):
        found = sg.xray.reconstruct(codes, counts, air)
        assert found.dispersion == 1
        assert correlation(found.x, truth) > 0.9


def test_overdispersed_air_is_seen_and_few_shots_get_few_terms():
    rng = np.random.default_rng(2)
    area = rng.integers(50, 150, 400).astype(float)
    doubled = 4.0 * rng.poisson(500 + area)
    assert fit_background(doubled, area).dispersion == pytest.approx(4, rel=0.2)
    wild = 1000 + 100 * np.cos(np.arange(40.0))
    assert fit_background(wild, np.full(40, 5.0)).terms.shape[1] <= 2
    assert fit_background(rng.poisson(50, 512).astype(float), np.full(512, 5.0)).terms.shape[1] <= MOST_ORDER
    assert fit_background(rng.poisson(50, 512).astype(float), np.full(512, 5.0)).pedestal == 0


def test_the_fit_is_that_of_maximum_likelihood():
    rng = np.random.default_rng(3)
    terms = np.column_stack([np.ones(300), np.linspace(-1, 1, 300)])
    y = rng.poisson(terms @ [20, 15]).astype(float)
    weights, values = fit_poisson(y, terms)
    assert np.abs(terms.T @ (1 - y / values)).max() < 0.02
    plain = terms @ np.linalg.lstsq(terms, y, rcond=None)[0]
    assert np.abs(terms.T @ (1 - y / plain)).max() > 0.5
    assert weights == pytest.approx([20, 15], abs=1.5)


def test_new_weights_lead_to_the_poisson_likelihood():
    # Without a prior the fixed point is where the gradient of the likelihood is 0; that of least squares is elsewhere.
    rng = np.random.default_rng(4)
    codes = (rng.random((800, 8, 8)) < 0.1).astype(np.uint8)
    codes[:, 0, 0] = 1
    truth = np.full((8, 8), 3.0)
    truth[2:5, 2:5] = 100
    rows = codes.reshape(800, 64).astype(float)
    air = np.full(800, 8.0)
    y = rng.poisson(air + rows @ truth.ravel()).astype(float)
    gradients = {}
    for likelihood in ("poisson", "least-squares"):
        found = sg.xray.reconstruct(
            codes, y, air, denoiser=lambda image, _: image, likelihood=likelihood, iterations=400
        )
        x = found.x.ravel()
        gradients[likelihood] = np.abs((rows.T @ (1 - y / (found.background + rows @ x)))[x > 0.5]).max()
    assert gradients["poisson"] < 0.3
    assert gradients["least-squares"] > 3 * gradients["poisson"]


def test_weighted_rows_are_a_diagonal_times_the_operator():
    rng = np.random.default_rng(5)
    codes = (rng.random((11, 5, 9)) < 0.4).astype(np.uint8)
    codes[:, 0, 0] = 1
    A = _blind.Weighted(sg.CXBI(shape=(5, 9)).operator(codes), rng.random(11) + 0.5)
    assert sg.testing.dot_test(A) < 1e-12
    assert np.abs(as_matrix(A) - A.weights[:, None] * codes.reshape(11, -1)).max() < 1e-12
    assert A.adjoint(np.arange(11.0)).ravel() == pytest.approx(as_matrix(A).T @ np.arange(11.0))


@pytest.mark.parametrize("shape", [(6, 6), (5, 8)])
def test_eight_orientations_and_back(shape):
    image = np.arange(float(np.prod(shape))).reshape(shape)
    turned = [_blind._turn(image, k) for k in range(8)]
    assert len({(t.shape, t.tobytes()) for t in turned}) == 8
    for k, one in enumerate(turned):
        assert np.array_equal(_blind._turn_back(one, k), image)


def test_noise_of_a_pixel_is_what_correlation_leaves():
    rng = np.random.default_rng(6)
    codes = (rng.random((4000, 4, 4)) < 0.3).astype(np.uint8)
    noise = 7 * rng.standard_normal((300, 4000))
    centred = codes.reshape(4000, -1) - codes.mean()
    left = noise @ centred / (centred**2).sum(axis=0)
    assert left.std() == pytest.approx(_blind.noise_unit(codes, np.full(4000, 7.0)), rel=0.05)
    assert _blind.noise_unit(codes.astype(float), np.full(4000, 7.0)) == _blind.noise_unit(codes, np.full(4000, 7.0))


def test_leakage_and_a_dark_scan(scan):
    _, codes, truth, y, air, _ = scan
    imager = sg.CXBI(shape=(16, 16), leakage=0.1)
    found = sg.xray.reconstruct(codes, y, air, imager=imager, iterations=20)
    assert correlation(found.x, truth) > 0.9
    dark = sg.xray.reconstruct(codes, np.zeros(160), np.zeros(160), iterations=8)
    assert not dark.x.any()
    alone = sg.xray.reconstruct(codes, np.einsum("qyx,yx->q", codes.astype(float), truth), iterations=40)
    assert alone.pedestal == 0
    assert correlation(alone.x, truth) > 0.95


BAD = [
    ({"codes": np.ones((5, 4, 16), np.uint8), "counts": np.ones(5)}, "fewer than 8×8"),
    ({"counts": np.ones(159)}, "160 codes and 159"),
    ({"counts": np.full(160, -1.0)}, "cannot be negative"),
    ({"counts": np.full(160, np.nan)}, "finite"),
    ({"background": np.ones(161)}, "longer than the scan"),
    ({"background": np.ones(100)}, "shorter than the scan"),
    ({"background": np.full(160, -1.0)}, "background cannot be negative"),
    ({"background": np.full(160, np.nan)}, "background must be finite"),
    ({"codes": np.zeros((160, 16, 16))}, "no open cell"),
    ({"codes": np.full((160, 16, 16), np.nan)}, "NaN"),
    ({"codes": np.full((160, 16, 16), 255)}, "divide 8-bit codes"),
    ({"codes": np.ones(160)}, "sliding mask"),
    ({"codes": np.ones((16, 165))}, "no window"),
    ({"denoiser": "blur"}, "no denoiser 'blur'"),
    ({"likelihood": "cauchy"}, "likelihood is"),
    ({"iterations": 2}, "iterations"),
    ({"imager": sg.CXBI(shape=(8, 8))}, "imager has"),
]


@pytest.mark.parametrize(("changed", "words"), BAD)
def test_what_does_not_fit_is_said_in_one_line(scan, changed, words):
    _, codes, _, y, air, _ = scan
    given = {"codes": codes, "counts": y, "background": air, **changed}
    with pytest.raises(ValueError, match=words) as caught:
        sg.xray.reconstruct(**given)
    assert "\n" not in str(caught.value)


def test_denoisers_that_are_none_are_refused(scan):
    _, codes, _, y, air, _ = scan
    for wrong in ((), 3, ("ffdnet", None)):
        with pytest.raises(TypeError, match="denoiser is a name"):
            sg.xray.reconstruct(codes, y, air, denoiser=wrong)


@pytest.mark.parametrize("shape", [(6, 7), (5, 4)])
def test_walls_are_what_rays_through_two_faces_meet(shape):
    # A ray in a cell's middle part keeps to the cell; what leaves on the far side has to find the next one open.
    code = (np.random.default_rng(7).random(shape) < 0.6).astype(float)
    slope, fine = 0.08, 400
    want = np.zeros(shape)
    places = (np.arange(fine) + 0.5) / fine
    for y in range(shape[0]):
        for x in range(shape[1]):
            dy, dx = slope * (y - (shape[0] - 1) / 2), slope * (x - (shape[1] - 1) / 2)
            for py, share_y in zip(*np.unique(np.floor(places + dy), return_counts=True), strict=True):
                for px, share_x in zip(*np.unique(np.floor(places + dx), return_counts=True), strict=True):
                    cells = {(y, x), (y + int(py), x), (y, x + int(px)), (y + int(py), x + int(px))}
                    inside = all(0 <= i < shape[0] and 0 <= j < shape[1] for i, j in cells)
                    passes = inside and all(code[i, j] for i, j in cells)
                    want[y, x] += passes * share_y * share_x / fine**2
    assert through_walls(code[None], slope)[0] == pytest.approx(want, abs=2 / fine)
    assert np.array_equal(through_walls(code[None], 0.0)[0], code)


def test_walls_that_cannot_be_are_refused():
    with pytest.raises(ValueError, match="shot, y, x"):
        through_walls(np.ones((3, 3)), 0.1)
    with pytest.raises(ValueError, match="slope must be"):
        through_walls(np.ones((1, 32, 32)), 0.1)


@pytest.mark.parametrize(("target", "percent", "least"), [("box", 10, 0.95), ("UD", 50, 0.93), ("UD", 1, 0.85)])
def test_the_authors_scans(data, target, percent, least):
    folder = data / "cxbi" / "gate"
    if not folder.is_dir():
        pytest.skip(f"{folder} is not there")

    def load(name):
        return next(v for k, v in scipy.io.loadmat(folder / name).items() if not k.startswith("_"))

    codes = np.stack(list(load(f"{percent}/code_it1.mat")[0]))
    y, air = (load(f"{percent}/{name}.mat").ravel() for name in (f"y_{target}", "y_air"))
    truth = scipy.io.loadmat(folder / "ground_truth_UD_square.mat")["square" if target == "box" else "UD"]
    found = sg.xray.reconstruct(codes[::2], y[::2], background=air[::2])
    assert correlation(found.x, truth.astype(float)) > least
    assert found.converged
