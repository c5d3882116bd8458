"""`shadowgram xray reconstruct`: what it prints and writes, the verdict, and what it refuses."""

import json

import numpy as np
import pytest
from scipy.io import savemat

from shadowgram.cli import main
from shadowgram.scenes.readers.native import read_dataset
from shadowgram.xray.permutation import permutation_test
from shadowgram.xray.scan import Scan
from shadowgram.xray.scan_file import write_scan
from shadowgram.xray.scene import shipped_scene

SIDE, SHOTS = 16, 180
RNG = np.random.default_rng(0)
STRIP = (RNG.random((SIDE, SIDE + SHOTS - 1)) < 0.5).astype(np.uint8)
CODES = np.stack([STRIP[:, q : q + SIDE] for q in range(SHOTS)])
PICTURE = np.zeros((SIDE, SIDE))
PICTURE[4:9, 3:12] = 60.0
AIR = RNG.poisson(900 + 200 * np.linspace(-1, 1, SHOTS) ** 2).astype(float)
COUNTS = RNG.poisson(900 + 200 * np.linspace(-1, 1, SHOTS) ** 2 + (CODES * PICTURE).sum(axis=(1, 2))).astype(float)


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """An empty working directory but for a scan, in three ways."""
    monkeypatch.chdir(tmp_path)
    cells = np.empty((1, SHOTS), object)
    for number, code in enumerate(CODES):
        cells[0, number] = code
    savemat(tmp_path / "codes.mat", {"codes_bin": cells})
    savemat(tmp_path / "y.mat", {"y": COUNTS})
    savemat(tmp_path / "air.mat", {"air": AIR})
    np.savez(tmp_path / "scan.npz", codes=CODES, y=COUNTS, air=AIR)
    return tmp_path


def run(capsys, command, status=0):
    got = main(["xray", "reconstruct", *command.split()])
    said = capsys.readouterr()
    assert got == status, said.err
    return said


def refused(capsys, command):
    said = run(capsys, command, 2)
    assert said.out == ""
    assert said.err.startswith("shadowgram: ")
    assert said.err.count("\n") == 1
    return said.err


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_help_has_a_runnable_example(capsys):
    assert "Example: shadowgram xray reconstruct y.nc" in " ".join(run(capsys, "--help").out.split())


def test_image_summary_and_picture(capsys, folder):
    before = set(names(folder))
    command = "codes.mat y.mat --background air.mat -o image.nc --png image.png"
    values = json.loads(run(capsys, f"{command} --json").out)
    assert set(names(folder)) - before == {"image.nc", "image.json", "image.png"}
    assert (folder / "image.png").read_bytes().startswith(b"\x89PNG")
    kept = read_dataset("image.nc")
    image = kept["image"].values
    assert np.corrcoef(image.ravel(), PICTURE.ravel())[0, 1] > 0.9
    np.testing.assert_allclose(kept["counts"], COUNTS)
    np.testing.assert_allclose(
        kept["model"] - kept["background"], (CODES * image).sum(axis=(1, 2)), rtol=1e-6, atol=1e-3
    )
    assert kept.attrs["kind"] == "xray-image"
    assert kept.attrs["p_value"] == values["test"]["p_value"]
    assert (values["shape"], values["shots"], values["file"]) == ([SIDE, SIDE], SHOTS, "image.nc")
    assert values["background"] == pytest.approx(AIR.mean(), rel=0.05)
    assert values["background"] + values["image"] == pytest.approx(COUNTS.mean(), rel=0.02)
    wanted = permutation_test(CODES, COUNTS, AIR)
    assert values["test"]["p_value"] == wanted.p_value == values["test"]["least_p"]
    assert values["test"]["significant"]
    assert 0.2 < values["chi_square"] < 5
    settings = json.loads((folder / "image.json").read_text())
    assert (settings["command"], settings["options"]["every"]) == ("xray reconstruct", 1)
    lines = run(capsys, command).out.splitlines()
    assert lines[0].startswith(f"{SIDE} × {SIDE} pixels (y × x) from {SHOTS} shots, {100 * CODES.mean():.1f} % open")
    assert wanted.verdict in lines
    assert lines[-1].startswith("→ image.nc, ")


def test_info_says_what_the_image_is(capsys):
    made = json.loads(run(capsys, "scan.npz -o image.nc --json").out)
    assert main(["info", "image.nc", "--json"]) == 0
    values = json.loads(capsys.readouterr().out)
    image = read_dataset("image.nc")["image"].values
    assert (values["kind"], values["shape"], values["shots"]) == ("xray-image", [SIDE, SIDE], SHOTS)
    assert values["range"] == [image.min(), image.max()]
    assert (values["verdict"], values["p_value"]) == (made["verdict"], made["test"]["p_value"])
    assert main(["info", "image.nc"]) == 0
    assert made["verdict"] in capsys.readouterr().out


def test_a_native_scan_and_npz_give_the_same_image(capsys, folder):
    scan = Scan(
        counts=COUNTS, standard_error=np.sqrt(COUNTS), background=AIR, background_error=np.sqrt(AIR), codes=CODES,
        photons_per_shot=1e7, exposure=0.1, route="direct", noisy=True, seed=0,
        scene=shipped_scene("cxbi-blocks").toml(),
    )  # fmt: skip
    write_scan(scan, folder / "y.nc")
    run(capsys, "y.nc -o a.nc")
    run(capsys, "scan.npz -o b.nc")
    run(capsys, "codes.mat y.mat --background air.mat -o c.nc")
    images = [read_dataset(name)["image"].values for name in ("a.nc", "b.nc", "c.nc")]
    np.testing.assert_array_equal(images[0], images[1])
    np.testing.assert_array_equal(images[0], images[2])


def test_fewer_shots_and_another_prior(capsys):
    values = json.loads(run(capsys, "scan.npz --every 2 -o a.nc --json").out)
    assert values["shots"] == SHOTS // 2
    run(capsys, "scan.npz --denoiser tv -o b.nc")
    run(capsys, "scan.npz -o c.nc")
    images = [read_dataset(name)["image"].values for name in ("a.nc", "b.nc", "c.nc")]
    assert not np.array_equal(images[1], images[2])
    assert np.corrcoef(images[1].ravel(), PICTURE.ravel())[0, 1] > 0.9


def test_counts_without_a_target_are_not_to_be_trusted(capsys, folder):
    np.savez(folder / "none.npz", codes=CODES, y=AIR)
    said = run(capsys, "none.npz -o image.nc").out
    assert "do not trust a picture" in said
    assert "do not trust a picture" in read_dataset("image.nc").attrs["verdict"]


def test_too_few_shots_for_a_verdict_still_give_an_image(capsys):
    values = json.loads(run(capsys, "scan.npz --every 9 -o image.nc --json").out)
    assert values["test"] is None
    assert values["verdict"].startswith("no permutation test: ")


@pytest.mark.parametrize(
    ("command", "message"),
    [
        ("none.mat y.mat -o a.nc", "there is no file none.mat"),
        ("codes.mat -o a.nc", "codes.mat holds no counts"),
        ("codes.mat y.mat -o a.txt", "must end in .nc"),
        ("codes.mat y.mat -o codes.mat", "must end in .nc"),
        ("codes.mat y.mat -o a.nc --png a.jpg", "must end in .png"),
        ("codes.mat y.mat -o nowhere/a.nc", "there is no folder nowhere"),
        ("codes.mat short.mat -o a.nc", "there are 180 codes in codes.mat and 90 counts"),
        ("codes.mat y.mat --background long.mat -o a.nc", "180 codes and 360 values of background"),
        ("codes.mat below.mat -o a.nc", "counts cannot be negative"),
        ("codes.mat cut.mat -o a.nc", "cannot read cut.mat"),
        ("dark.npz -o a.nc", "code 7 of 180 has no open cell"),
        ("objects.npz y.mat -o a.nc", "objects.npz holds no codes"),
        ("codes.mat y.mat -o a.nc --every 0", "--every"),
        ("codes.mat y.mat -o a.nc --every 181", "from 1 to 180; got 181"),
        ("codes.mat y.mat -o a.nc --shape 4", "--shape takes the size y × x"),
        ("codes.mat y.mat -o a.nc --block 40", "from 1 to 16 pixels a side"),
        ("codes.mat y.mat -o a.nc --denoiser sharp", "is not one of"),
        ("codes.txt y.mat -o a.nc", "must be a .mat, .npz, .npy or .nc file"),
        ("wrong.nc -o a.nc", "wrong.nc"),
    ],
)
def test_what_cannot_be_is_said_in_a_line(capsys, folder, command, message):
    savemat(folder / "short.mat", {"y": COUNTS[::2]})
    savemat(folder / "long.mat", {"air": np.r_[AIR, AIR]})
    savemat(folder / "below.mat", {"y": COUNTS - 2000})
    (folder / "cut.mat").write_bytes((folder / "y.mat").read_bytes()[:300])
    np.savez(folder / "dark.npz", codes=CODES * (np.arange(SHOTS) != 7)[:, None, None], y=COUNTS)
    np.savez(folder / "objects.npz", codes=np.array([CODES, None], object))
    (folder / "codes.txt").write_text("1 0 1")
    (folder / "wrong.nc").write_bytes(b"\x89HDF\r\n\x1a\nnothing")
    before = names(folder)
    assert message in refused(capsys, command)
    assert names(folder) == before
