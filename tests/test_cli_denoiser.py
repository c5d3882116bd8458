"""`shadowgram denoiser import`: weights of other programs, in files made here without those programs."""

import io
import itertools
import json
import os
import pickle
import struct
import zipfile

import numpy as np
import pytest
from scipy.io import savemat

from shadowgram.cli import main
from shadowgram.priors import FFDNet, ffdnet

MAGIC = 0x1950A86A20F9469CFC6C


def shipped():
    """Weights of the network in the package, from the raw numbers in its file: (out, in, 3, 3), and no biases."""
    content = ffdnet.SHIPPED.read_bytes()
    sizes = [5, *[64] * 14, 4]
    found = []
    for number, (a, b) in enumerate(itertools.pairwise(sizes), 1):
        name = f"w{number}".encode()
        count = 4 * a * b * 9
        length, rest = b"", count
        while rest > 0x7F:
            length, rest = length + bytes([rest & 0x7F | 0x80]), rest >> 7
        head = b"\x42" + bytes([len(name)]) + name + b"\x4a" + length + bytes([rest])
        start = content.index(head) + len(head)
        found.append(np.frombuffer(content[start : start + count], "<f4").reshape(b, a, 3, 3))
    return found


def _text(value):
    return b"X" + struct.pack("<I", len(value)) + value.encode()


def _whole(value):
    return b"J" + struct.pack("<i", value)


def _sizes(values):
    return b"(" + b"".join(map(_whole, values)) + b"t"


def dictionary(arrays, *, legacy=False):
    """Pickle of an ordered dictionary of tensors, by hand."""
    out = [b"\x80\x02ccollections\nOrderedDict\n)R("]
    for key, (name, values) in enumerate(arrays.items()):
        strides = [s // values.itemsize for s in np.ascontiguousarray(values).strides]
        place = [_text("storage"), b"ctorch\nFloatStorage\n", _text(str(key)), _text("cpu"), _whole(values.size)]
        place = b"(" + b"".join([*place, b"N" if legacy else b""]) + b"tQ"
        kind = b"ctorch._utils\n_rebuild_tensor_v2\n"
        out += [_text(name), kind, b"(", place, _whole(0), _sizes(values.shape), _sizes(strides), b"\x89"]
        out += [b"ccollections\nOrderedDict\n)RtR"]
    return b"".join([*out, b"u."])


def numbers(values):
    return np.ascontiguousarray(values, "<f4").tobytes()


def zipped(arrays, records=None):
    """A .pth file of torch 1.6 and later."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr("archive/data.pkl", dictionary(arrays) if records is None else records)
        for key, values in enumerate(arrays.values()):
            archive.writestr(f"archive/data/{key}", numbers(values))
        archive.writestr("archive/version", "3\n")
    return stream.getvalue()


def legacy(arrays):
    """A .pth file of torch before 1.6."""
    keys = [str(key) for key in range(len(arrays))]
    parts = [pickle.dumps(MAGIC, 2), pickle.dumps(1001, 2), pickle.dumps({"little_endian": True}, 2)]
    parts += [dictionary(arrays, legacy=True), pickle.dumps(keys, 2)]
    parts += [struct.pack("<q", values.size) + numbers(values) for values in arrays.values()]
    return b"".join(parts)


def named(weights, biases=None):
    """Tensors by name, as a sequence of convolutions and ReLU has them."""
    given = {}
    for number, weight in enumerate(weights):
        given[f"model.{2 * number}.weight"] = weight
        if biases is not None:
            given[f"model.{2 * number}.bias"] = biases[number]
    return given


def matlab(weights):
    """A .mat file of MatConvNet: weights (y, x, in, out), the pixels of a square in columns."""
    order = [0, 2, 1, 3]
    weights = list(weights)
    weights[0] = weights[0][:, [*order, 4]]
    weights[-1] = weights[-1][order]
    layers = [{"type": "SubP", "scale": 0.5}, {"type": "concat"}]
    for weight in weights:
        pair = np.empty((1, 2), object)
        pair[0, 0], pair[0, 1] = weight.transpose(2, 3, 1, 0), np.zeros((len(weight), 1), np.float32)
        layers += [{"type": "conv", "weights": pair, "pad": 1}, {"type": "relu"}]
    layers[-1] = {"type": "SubP", "scale": 2.0}
    cells = np.empty((1, len(layers)), object)
    cells[0, :] = layers
    stream = io.BytesIO()
    savemat(stream, {"net": {"layers": cells}}, do_compression=False)
    return stream.getvalue()


@pytest.fixture(scope="module")
def weights():
    return shipped()


@pytest.fixture(scope="module")
def image():
    rng = np.random.default_rng(2)
    return np.kron(rng.uniform(size=(6, 5)), np.ones((7, 9))) + 0.1 * rng.standard_normal((42, 45))


def imported(tmp_path, name, content):
    """Result of the command on a file, once it has gone well."""
    (tmp_path / name).write_bytes(content)
    assert main(["denoiser", "import", str(tmp_path / name), "-o", str(tmp_path / "out.onnx")]) == 0
    return FFDNet(path=tmp_path / "out.onnx")


def refused(tmp_path, capsys, name, content):
    """What the command says about a file that it refuses."""
    (tmp_path / name).write_bytes(content)
    assert main(["denoiser", "import", str(tmp_path / name), "-o", str(tmp_path / "out.onnx")]) == 2
    assert not (tmp_path / "out.onnx").exists()
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    return said


@pytest.mark.parametrize(("name", "write"), [("new.pth", zipped), ("old.pth", legacy), ("new.pt", zipped)])
def test_pytorch_files_give_the_same_network(tmp_path, weights, image, name, write):
    found = imported(tmp_path, name, write(named(weights)))
    assert np.array_equal(found(image, 0.1), FFDNet()(image, 0.1))


def test_a_matlab_file_gives_the_same_network(tmp_path, weights, image):
    assert np.array_equal(imported(tmp_path, "net.mat", matlab(weights))(image, 0.1), FFDNet()(image, 0.1))


def test_a_noise_map_that_comes_first_is_found(tmp_path, weights, image, capsys):
    first = [weights[0][:, [4, 0, 1, 2, 3]], *weights[1:]]
    found = imported(tmp_path, "first.pth", zipped(named(first)))
    assert (
        "15 layers of 64 features; the network gives the noise and takes the noise map first" in capsys.readouterr().out
    )
    assert np.array_equal(found(image, 0.1), FFDNet()(image, 0.1))


def test_batch_normalisation_is_folded_into_the_weights(tmp_path, weights, image):
    rng = np.random.default_rng(0)
    given = {"net.0.weight": weights[0]}
    for number, weight in enumerate(weights[1:-1], 1):
        factor, mean, variance = (rng.uniform(0.5, 2, 64).astype(np.float32) for _ in range(3))
        scale = factor / np.sqrt(variance + 1e-5)
        given[f"net.{3 * number}.weight"] = weight / scale[:, None, None, None]
        norm = {"weight": factor, "bias": mean * scale, "running_mean": mean, "running_var": variance}
        given |= {f"net.{3 * number + 1}.{key}": value for key, value in norm.items()}
    given["net.45.weight"] = weights[-1]
    given = {key: value.astype(np.float32) for key, value in given.items()}
    found = imported(tmp_path, "norm.pth", legacy(given))
    low, high = np.percentile(image.astype(np.float32).astype(float), (1, 99))
    middle = (low + high - max(high - low, 0.1 * 255 / 75)) / 2
    # The biases cancel, but only to rounding, so the network is run in the range 0..1 and not about the mean.
    expected = without_mean(image, middle)
    np.testing.assert_allclose(found(image, 0.1), expected, rtol=0, atol=2e-4)


def without_mean(image, middle):
    """What the shipped network gives for the image less a number that is not its mean."""
    session = ffdnet.start_session(ffdnet.SHIPPED.read_bytes(), "shipped")
    padded = np.pad(image - middle, [(0, size % 2) for size in image.shape], "reflect").astype(np.float32)
    levels = np.full((1, 1, padded.shape[0] // 2, padded.shape[1] // 2), 0.1, np.float32)
    found = session.run(["denoised"], {"image": padded[None, None], "sigma": levels})[0]
    return np.asarray(found)[0, 0, : image.shape[0], : image.shape[1]] + middle


def test_json_says_what_was_found(tmp_path, weights, capsys):
    (tmp_path / "net.pth").write_bytes(zipped(named(weights)))
    arguments = ["denoiser", "import", str(tmp_path / "net.pth"), "-o", str(tmp_path / "out.onnx"), "--json"]
    assert main(arguments) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["layers"] == 15
    assert found["features"] == 64
    assert found["gives"] == "noise"
    assert found["noise_map"] == "last"
    assert found["gain_db"] > 10


class Attack:
    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return os.mkdir, (self.path,)


@pytest.mark.parametrize("where", ["zip", "legacy"])
def test_a_file_that_wants_to_run_something_is_refused(tmp_path, capsys, where, weights):
    bomb = pickle.dumps(Attack(str(tmp_path / "made")), 2)
    content = zipped(named(weights[:1]), bomb) if where == "zip" else bomb
    assert "asks for posix.mkdir, which is more than weights; nothing of it was run" in refused(
        tmp_path, capsys, "bad.pth", content
    )
    assert not (tmp_path / "made").exists()


@pytest.mark.parametrize(
    "bomb", [b"\x80\x02Nr\xff\xff\xff\x7f.", b"\x80\x02Np4000000000\n.", b"\x80\x05\x96" + b"\xff" * 7 + b"\x0f."]
)
def test_a_file_that_asks_for_much_memory_is_refused(tmp_path, capsys, bomb):
    assert "it is not a" in refused(tmp_path, capsys, "bad.pth", bomb)
    assert "it is not a" in refused(tmp_path, capsys, "zip.pth", zipped({}, bomb))


def test_attributes_that_a_file_sets_change_nothing(tmp_path, capsys):
    records = b"\x80\x02ctorch._utils\n_rebuild_tensor\n}X\x04\x00\x00\x00nameX\x01\x00\x00\x00xsb."
    assert "it is not a dictionary of tensors" in refused(tmp_path, capsys, "bad.pth", zipped({}, records))


@pytest.mark.parametrize("write", [zipped, legacy])
@pytest.mark.parametrize("share", [0.0, 0.0005, 0.1, 0.7, 0.9999])
def test_a_file_that_is_cut_short_is_refused(tmp_path, capsys, weights, write, share):
    content = write(named(weights))
    said = refused(tmp_path, capsys, "cut.pth", content[: int(share * len(content))])
    assert "cut.pth: it is not a whole file of weights" in said or "cut.pth: it is cut short" in said


@pytest.mark.parametrize("share", [0.0, 0.001, 0.5, 0.98])
def test_a_matlab_file_that_is_cut_short_is_refused(tmp_path, capsys, weights, share):
    content = matlab(weights)
    said = refused(tmp_path, capsys, "cut.mat", content[: int(share * len(content))])
    assert "cut.mat: it is not a whole MATLAB file with net.layers of MatConvNet" in said


def test_a_tensor_that_reaches_beyond_its_numbers_is_refused(tmp_path, capsys):
    records = dictionary({"model.0.weight": np.zeros((2, 2), np.float32)}).replace(_sizes((2, 2)), _sizes((2, 9)))
    content = zipped({"model.0.weight": np.zeros((2, 2), np.float32)}, records)
    assert "reaches beyond its numbers" in refused(tmp_path, capsys, "reach.pth", content)


def test_other_networks_are_refused(tmp_path, capsys, weights):
    rng = np.random.default_rng(0)
    wide = np.zeros((64, 13, 3, 3), np.float32)
    assert "colour" in refused(tmp_path, capsys, "rgb.pth", zipped(named([wide, *weights[1:]])))
    assert "takes 5 channels" in refused(tmp_path, capsys, "cut.pth", zipped(named(weights[1:])))
    lost = [rng.standard_normal(w.shape).astype(np.float32) for w in weights]
    assert "does not remove noise" in refused(tmp_path, capsys, "lost.pth", zipped(named(lost)))
    other = {"fc.weight": np.zeros((3, 3), np.float32)}
    assert "a layer that an FFDNet does not have, with weight" in refused(tmp_path, capsys, "fc.pth", zipped(other))
    assert "it has no convolutions" in refused(tmp_path, capsys, "none.mat", matlab_without_layers())


def matlab_without_layers():
    stream = io.BytesIO()
    cells = np.empty((1, 2), object)
    cells[0, :] = [{"type": "relu"}, {"type": "relu"}]
    savemat(stream, {"net": {"layers": cells}})
    return stream.getvalue()


def test_endings_and_folders_are_checked_first(tmp_path, capsys):
    (tmp_path / "net.h5").write_bytes(b"")
    assert main(["denoiser", "import", str(tmp_path / "net.h5"), "-o", str(tmp_path / "out.onnx")]) == 2
    assert "weights are read from .pth, .pt and .mat files" in capsys.readouterr().err
    assert main(["denoiser", "import", str(tmp_path / "net.pth"), "-o", str(tmp_path / "out.pth")]) == 2
    assert "must end in .onnx" in capsys.readouterr().err
    assert main(["denoiser", "import", str(tmp_path / "absent.pth"), "-o", str(tmp_path / "out.onnx")]) == 2
    assert "absent.pth" in capsys.readouterr().err
    (tmp_path / "new.mat").write_bytes(b"MATLAB 7.3 MAT-file, Platform: GLNXA64" + bytes(512))
    assert main(["denoiser", "import", str(tmp_path / "new.mat"), "-o", str(tmp_path / "out.onnx")]) == 2
    assert "save it again in MATLAB with the option '-v7'" in capsys.readouterr().err
