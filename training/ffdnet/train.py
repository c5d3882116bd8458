"""Train the network: ``python train.py --photographs FOLDER --work FOLDER --minutes 100``. Started again, it goes on."""

from __future__ import annotations

import argparse
import copy
import csv
import math
import time
from pathlib import Path

import numpy as np
import torch

import data
from network import Muon, Network

SCHEDULE = ((0.0, 16, 48), (0.45, 16, 64), (0.88, 8, 96))  # share of the time from which, patches, their side
CHOOSE_EVERY = 45  # s
LEVELS = (15, 25, 50)
ADAM_RATE, MUON_RATE, WARM_UP = 1e-3, 0.01, 50  # at the start; steps until they are reached
AVERAGE = 0.999  # of the weights, over steps


def main() -> None:
    """Read the command line and train."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--photographs", type=Path, required=True, help="folder of those that data.COPIED names")
    parser.add_argument("--work", type=Path, required=True, help="folder for checkpoints, weights and the log")
    parser.add_argument("--minutes", type=float, default=100.0, help="when the learning rate has come down to 0")
    parser.add_argument("--clock", choices=("wall", "process"), default="wall", help="what counts the minutes")
    parser.add_argument("--report", type=float, default=4.0, help="minutes between two measurements and checkpoints")
    parser.add_argument("--threads", type=int, default=1, help="most threads")
    parser.add_argument("--width", type=int, default=64)
    parser.add_argument("--depth", type=int, default=15)
    options = parser.parse_args()
    options.work.mkdir(parents=True, exist_ok=True)
    Training(options).run()


class Training:
    """A run: what it needs to go on is in one checkpoint."""

    def __init__(self, options: argparse.Namespace) -> None:
        torch.manual_seed(0)
        torch.set_num_threads(1)
        self.options = options
        self.clock = time.monotonic if options.clock == "wall" else time.process_time
        self.network = Network(options.width, options.depth).to(memory_format=torch.channels_last)
        self.average = copy.deepcopy(self.network)
        first, *hidden, last = self.network.parameters()
        self.optimizers = [
            (torch.optim.Adam([first, last], betas=(0.9, 0.99)), ADAM_RATE),
            (Muon(hidden), MUON_RATE),
        ]
        self.step, self.elapsed, self.best = 0, 0.0, 0.0
        self.checkpoint = options.work / "checkpoint.pt"
        if self.checkpoint.exists():
            self._load()
        self.sampler = data.Sampler(self._images(), np.random.default_rng((1, self.step)))
        self.held_out = _held_out()

    def run(self) -> None:
        """Train until the time is over; the learning rate ends at zero then."""
        total = self.options.minutes * 60
        last, reported = self.clock(), self.elapsed
        chosen = -math.inf
        while self.elapsed < total:
            if self.elapsed - chosen > CHOOSE_EVERY:
                chosen = self.elapsed
                self._choose_threads(self.elapsed / total)
            self._one_step(self.elapsed / total)
            now = self.clock()
            self.elapsed, last = self.elapsed + now - last, now
            if self.elapsed - reported > self.options.report * 60:
                self._report()
                reported, last = self.elapsed, self.clock()
        self._report()

    def _choose_threads(self, share: float) -> None:
        """Two threads are slower than one while other programs are at work."""
        if self.options.threads == 1:
            return
        seconds = {}
        for threads in (1, self.options.threads):
            torch.set_num_threads(threads)
            self._one_step(share)
            start = time.monotonic()
            for _ in range(4):
                self._one_step(share)
            seconds[threads] = time.monotonic() - start
        torch.set_num_threads(min(seconds, key=seconds.__getitem__))

    def _one_step(self, share: float) -> None:
        _, count, side = next(s for s in reversed(SCHEDULE) if share >= s[0])
        clean, noisy, sigma = (torch.from_numpy(a) for a in self.sampler.batch(count, side))
        rate = min(1.0, self.step / WARM_UP) * 0.5 * (1 + math.cos(math.pi * share))
        for optimizer, lr in self.optimizers:
            optimizer.zero_grad(set_to_none=True)
            for group in optimizer.param_groups:
                group["lr"] = lr * rate
        with torch.autocast("cpu", torch.bfloat16):
            noise = self.network(noisy, sigma.expand_as(noisy))
        # The error that is left grows about as sigma: divided by it, every level counts the same in decibels.
        loss = ((noisy - noise - clean) ** 2 / (sigma + 0.01)).mean()
        loss.backward()
        for optimizer, _ in self.optimizers:
            optimizer.step()
        self.step += 1
        keep = min(AVERAGE, self.step / (self.step + 10))
        with torch.no_grad():
            torch._foreach_lerp_(list(self.average.parameters()), list(self.network.parameters()), 1 - keep)

    def _report(self) -> None:
        """Measure the averaged weights on the held-out photographs, and save everything."""
        values = [self._psnr(level) for level in LEVELS]
        line = [self.step, f"{self.elapsed / 60:.2f}", *(f"{v:.3f}" for v in values)]
        print(*line, flush=True)
        with (self.options.work / "log.csv").open("a", newline="") as file:
            csv.writer(file).writerow(line)
        if sum(values) > self.best:
            self.best = sum(values)
            torch.save(self.average.state_dict(), self.options.work / "best.pt")
        self._save()

    def _psnr(self, level: int) -> float:
        sigma = torch.full((1, 1, 256, 256), level / 255)
        values = []
        for clean, noise in self.held_out:
            noisy = clean + noise * level / 255
            mean = noisy.mean()
            with torch.no_grad():
                result = noisy - self.average(noisy - mean, sigma)
            values.append(-10 * float(torch.log10(((result - clean) ** 2).mean())))
        return float(np.mean(values))

    def _save(self) -> None:
        state = {
            "network": self.network.state_dict(),
            "average": self.average.state_dict(),
            "optimizers": [o.state_dict() for o, _ in self.optimizers],
            "progress": [self.step, self.elapsed, self.best],
        }
        part = self.checkpoint.with_suffix(".part")
        torch.save(state, part)
        part.replace(self.checkpoint)

    def _load(self) -> None:
        state = torch.load(self.checkpoint, weights_only=True)
        self.network.load_state_dict(state["network"])
        self.average.load_state_dict(state["average"])
        for (optimizer, _), saved in zip(self.optimizers, state["optimizers"], strict=True):
            optimizer.load_state_dict(saved)
        self.step, self.elapsed, self.best = state["progress"]

    def _images(self) -> dict[str, list[np.ndarray]]:
        """The training set, kept in the work folder once it has been built."""
        kept = self.options.work / "images.npz"
        if not kept.exists():
            built = data.build(self.options.photographs)
            np.savez(
                kept, **{f"{kind} {n:04}": image for kind, images in built.items() for n, image in enumerate(images)}
            )
        with np.load(kept) as arrays:
            return {kind: [arrays[name] for name in arrays.files if name.startswith(kind)] for kind in data.SHARES}


def _held_out() -> list[tuple[torch.Tensor, torch.Tensor]]:
    """Photographs (1, 1, y, x) to measure on, and noise of unit variance for each."""
    rng = np.random.default_rng(7)
    images = [torch.from_numpy(image[None, None]).float() for image in data.held_out()]
    return [(image, torch.from_numpy(rng.standard_normal(image.shape, np.float32))) for image in images]


if __name__ == "__main__":
    main()
