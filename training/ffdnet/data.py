"""What the network is trained on: photographs from packages, and generated scenes. All of it follows from the seed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

# scikit-image and scikit-learn, as installed with the extra "train".
SKIMAGE = (
    "brick.png", "cell.png", "coins.png", "grass.png", "gravel.png", "hubble_deep_field.jpg", "ihc.png", "moon.png",
    "motorcycle_left.png", "page.png", "retina.jpg", "rocket.jpg",
)  # fmt: skip
SKLEARN = ("china.jpg", "flower.jpg")
# Copied into one folder from other packages; photographs.py says how, the model card under which licences.
COPIED = (
    "aero.png", "aero1.jpg", "aero3.jpg", "aloeL.jpg", "apple.jpg", "ascent.png", "baboon.jpg", "basketball1.png",
    "board.jpg", "building.jpg", "butterfly.jpg", "chicky_512.png", "ela_original.jpg", "face.png", "fruits.jpg",
    "grace_hopper.jpg", "graf1.png", "home.jpg", "leuvenA.jpg", "messi5.jpg", "orange.jpg", "plant.jpg",
    "rubberwhale1.png", "scenetext01.jpg", "scenetext02.jpg", "scenetext03.jpg", "scenetext04.jpg", "scenetext05.jpg",
    "scenetext06.jpg", "scenetext_segmented_word01.jpg", "scenetext_segmented_word02.jpg", "squirrel_cls.jpg",
    "starry_night.jpg",
)  # fmt: skip
HELD_OUT = ("camera.png", "astronaut.png", "coffee.png", "chelsea.png")  # of scikit-image, never trained on

SCALES = (1.0, 0.8, 0.64, 0.5)
LEAST_SIDE = 128  # pixels, also of a photograph made smaller
LARGEST_WEIGHT = 512 * 512  # pixels: a larger photograph is not drawn from more often
LEAVES, SIMPLE = 240, 160  # generated scenes
SHARES = {"photographs": 0.65, "leaves": 0.27, "simple": 0.08}
SCENE_SIDE = 256


def gray(path: Path) -> np.ndarray:
    """Luminance of an image file, (y, x) of uint8."""
    return np.asarray(Image.open(path).convert("L"))


def photographs(folder: Path) -> list[np.ndarray]:
    """Every photograph to train on, at every scale."""
    import skimage
    import sklearn.datasets

    sources = [Path(skimage.__file__).parent / "data" / name for name in SKIMAGE]
    sources += [Path(sklearn.datasets.__file__).parent / "images" / name for name in SKLEARN]
    sources += [folder / name for name in COPIED]
    return [scaled for path in sources for scaled in _at_scales(Image.fromarray(gray(path)))]


def held_out(side: int = 256) -> list[np.ndarray]:
    """The photographs that are measured on, made `side` × `side`, float64 in 0..1."""
    images = []
    for image in map(Image.fromarray, held_out_whole(np.uint8)):
        square = min(image.size)
        left, top = (image.width - square) // 2, (image.height - square) // 2
        cut = image.crop((left, top, left + square, top + square)).resize((side, side), Image.Resampling.BICUBIC)
        images.append(np.asarray(cut) / 255)
    return images


def held_out_whole(dtype: type = np.float64) -> list[np.ndarray]:
    """The photographs that are measured on as they are, of uint8 or of float64 in 0..1."""
    import skimage

    images = [gray(Path(skimage.__file__).parent / "data" / name) for name in HELD_OUT]
    return images if dtype is np.uint8 else [image / 255 for image in images]


def _at_scales(image: Image.Image) -> list[np.ndarray]:
    sizes = [(round(image.width * s), round(image.height * s)) for s in SCALES]
    kept = [size for size in sizes if min(size) >= LEAST_SIDE]
    return [np.asarray(image.resize(size, Image.Resampling.BICUBIC)) for size in kept]


def dead_leaves(rng: np.random.Generator, side: int = SCENE_SIDE) -> np.ndarray:
    """Opaque leaves of all sizes, each hiding those behind it, shaded and textured; (y, x) of uint8.

    Radii follow r⁻³, which gives the scale invariance of photographs. Drawn twice as fine and averaged.
    Source: Lee, Mumford & Huang, Int. J. Comput. Vis. 41 (2001) 35.
    """
    fine = 2 * side
    scene = np.zeros((fine, fine), np.float32)
    hidden = np.zeros((fine, fine), bool)
    smallest = rng.choice([2.0, 4.0, 8.0, 16.0])
    centre, spread = rng.uniform(0.2, 0.8), rng.uniform(0.1, 0.45)
    textured = rng.uniform(0, 0.8)
    for _ in range(6000):
        radius = smallest / np.sqrt(1 - rng.uniform() * (1 - (smallest / fine) ** 2))
        _add_leaf(rng, scene, hidden, radius, (centre, spread), textured)
        if hidden.mean() > 0.995:
            break
    scene[~hidden] = centre
    coarse = scene.reshape(side, 2, side, 2).mean((1, 3))
    return np.rint(255 * coarse.clip(0, 1)).astype(np.uint8)


def _add_leaf(rng, scene, hidden, radius, tones, textured) -> None:
    y, x = rng.uniform(0, len(scene), 2)
    top, left = max(0, int(y - radius)), max(0, int(x - radius))
    rows = slice(top, min(len(scene), int(y + radius) + 1))
    columns = slice(left, min(len(scene), int(x + radius) + 1))
    dy = (np.arange(rows.start, rows.stop, dtype=np.float32) - np.float32(y))[:, None]
    dx = np.arange(columns.start, columns.stop, dtype=np.float32) - np.float32(x)
    shown = _shape(rng, dy, dx, radius) & ~hidden[rows, columns]
    if shown.any():
        scene[rows, columns][shown] = _surface(rng, dy, dx, radius, tones, textured)[shown]
        hidden[rows, columns] |= shown


def _shape(rng, dy, dx, radius) -> np.ndarray:
    """Inside of a disc, an ellipse or a rectangle, turned, or of a polygon."""
    kind, angle = rng.integers(4), rng.uniform(0, np.pi)
    along, across = dx * np.cos(angle) + dy * np.sin(angle), dy * np.cos(angle) - dx * np.sin(angle)
    narrow = radius * rng.uniform(0.1, 1)
    if kind == 0:
        return dx**2 + dy**2 < radius**2
    if kind == 1:
        return (along / radius) ** 2 + (across / narrow) ** 2 < 1
    if kind == 2:
        return (np.abs(along) < 0.8 * radius) & (np.abs(across) < 0.6 * narrow)
    inside = np.ones(np.broadcast_shapes(dy.shape, dx.shape), bool)
    for turn in np.sort(rng.uniform(0, 2 * np.pi, rng.integers(3, 7))):
        inside &= dx * np.cos(turn) + dy * np.sin(turn) < radius * 0.6
    return inside


def _surface(rng, dy, dx, radius, tones, textured) -> np.ndarray:
    """Tone of a leaf: flat, with a gradient, or also with stripes or rough."""
    shape = np.broadcast_shapes(dy.shape, dx.shape)
    tone = tones[0] + tones[1] * rng.uniform(-1, 1)
    surface = np.full(shape, tone, np.float32)
    if rng.uniform() < 0.5:
        angle = rng.uniform(0, 2 * np.pi)
        surface += rng.uniform(0, 0.3) * (dx * np.cos(angle) + dy * np.sin(angle)) / np.float32(radius)
    if rng.uniform() < textured and min(shape) > 8:
        strength = rng.uniform(0.01, 0.15)
        surface += strength * (_stripes(rng, dy, dx) if rng.uniform() < 0.3 else _rough(rng, shape))
    return surface


def _stripes(rng, dy, dx) -> np.ndarray:
    period, angle = rng.uniform(4, 40), rng.uniform(0, np.pi)
    wave = np.sin((dx * np.cos(angle) + dy * np.sin(angle)) * np.float32(2 * np.pi / period))
    return np.sign(wave) if rng.uniform() < 0.3 else wave


def _rough(rng, shape) -> np.ndarray:
    """Random texture with a spectrum f^−a, of unit variance."""
    fy, fx = np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1])
    frequency = np.hypot(fy, fx * rng.uniform(0.3, 3))
    frequency[0, 0] = np.inf
    spectrum = np.fft.rfft2(rng.standard_normal(shape)) * frequency ** -rng.uniform(0.4, 1.8)
    texture = np.fft.irfft2(spectrum, shape)
    return (texture / (texture.std() + 1e-9)).astype(np.float32)


def simple_scene(rng: np.random.Generator, side: int = 64) -> np.ndarray:
    """A few bright blocks, letters and discs on a dark ground, as X-ray backscatter images look; (y, x) of uint8."""
    fine = 4 * side
    image = Image.new("L", (fine, fine), int(rng.integers(0, 80)))
    draw = ImageDraw.Draw(image)
    for _ in range(rng.integers(2, 14)):
        tone, size = int(rng.integers(60, 256)), rng.uniform(4, 14) * 4
        x, y = rng.uniform(-size / 2, fine - size / 2, 2)
        kind = rng.integers(3)
        if kind == 0:
            draw.rectangle((x, y, x + size, y + size * rng.uniform(0.4, 1.6)), fill=tone)
        elif kind == 1:
            draw.ellipse((x, y, x + size, y + size), fill=tone)
        else:
            letter = chr(rng.integers(ord("A"), ord("Z") + 1))
            draw.text(
                (x, y), letter, fill=tone, font=ImageFont.load_default(size * 1.5), stroke_width=int(rng.integers(5))
            )
    if rng.uniform() < 0.3:
        image = image.point(lambda v: 255 - v)
    return np.asarray(image.resize((side, side), Image.Resampling.BOX))


def build(folder: Path, seed: int = 0) -> dict[str, list[np.ndarray]]:
    """The whole training set."""
    rng = np.random.default_rng(seed)
    return {
        "photographs": photographs(folder),
        "leaves": [dead_leaves(rng) for _ in range(LEAVES)],
        "simple": [simple_scene(rng, 128) for _ in range(SIMPLE)],
    }


class Sampler:
    """Clean patches and their noise levels, at random."""

    def __init__(self, images: dict[str, list[np.ndarray]], rng: np.random.Generator) -> None:
        self.images, self.rng = images, rng
        self.means = {kind: [float(m.mean()) for m in members] for kind, members in images.items()}
        self.chances = {}
        for kind, members in images.items():
            areas = np.array([min(m.size, LARGEST_WEIGHT) for m in members], float)
            self.chances[kind] = areas / areas.sum()

    def patch(self, side: int) -> np.ndarray:
        """One patch, (side, side) of float32 in 0..1 less the mean of the image that it is from."""
        kind = self.rng.choice(list(SHARES), p=list(SHARES.values()))
        members = self.images[kind]
        chosen = self.rng.choice(len(members), p=self.chances[kind])
        image = members[chosen]
        y, x = self.rng.integers(0, image.shape[0] - side + 1), self.rng.integers(0, image.shape[1] - side + 1)
        cut = image[y : y + side, x : x + side].astype(np.float32)
        if self.rng.uniform() < 0.5:
            cut = cut.T
        cut = cut[:: self.rng.choice([-1, 1]), :: self.rng.choice([-1, 1])]
        # At work the network sees a whole image less its mean; a small image is its own patch.
        middle = cut.mean() if self.rng.uniform() < 0.3 else self.means[kind][chosen]
        return (cut - np.float32(middle)) / 255

    def batch(self, count: int, side: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Clean and noisy patches (count, 1, side, side), and standard deviations (count, 1, 1, 1) from 0 to 75/255."""
        clean = np.stack([self.patch(side) for _ in range(count)])[:, None]
        sigma = self.rng.uniform(0, 75 / 255, (count, 1, 1, 1)).astype(np.float32)
        noise = self.rng.standard_normal(clean.shape, np.float32)
        return clean, clean + sigma * noise, sigma
