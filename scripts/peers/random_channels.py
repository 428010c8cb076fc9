#!/usr/bin/env python3
"""Heated channels at random beside finite elements: does the error of Q, and that of the gain of `optimize`, hold?

    python=~/.cache/hydrograd/channel-fem/bin/python                 made as in channel_fem.py
    $python scripts/peers/random_channels.py q --count 40            `simulate --error`: fixed particles, and every fourth with moving ones
    $python scripts/peers/random_channels.py gain --count 40         `optimize` over the flat wall
    ... --set time.end=7                                             with settings for all of them

Height, viscosity, conductivity, body force and the hot section are drawn by --seed and number, and for `q` a flat, sine, cosine or rough wall;
with and without a reference velocity that fits. Some flows are far from steady at the end of their run, as those of users are. One line for
each channel: how far the figure is from finite elements (channel_fem.py, on its coarsest mesh: 0.01 %) and its error, in per cent of Q; then how
many hold, and how much larger than the true error the error is in the middle.
"""
import argparse
import os
import shutil
import sys
import tempfile

import channel_fem as fem
import numpy as np

sys.path.insert(0, os.path.join(fem.ROOT, "scripts"))
from random_bodies import conclude, run

# Reynolds number above which a flow is left out.
FASTEST = 70


class Channel:
    """Numbers of a channel, its settings, and finite elements of it."""

    def __init__(self, seed, with_wall, settings):
        r = np.random.default_rng(seed)
        number = lambda least, most, digits: float(np.round(r.uniform(least, most), digits))
        self.height = float(r.choice([0.16, 0.2, 0.24, 0.26, 0.3]))
        self.viscosity, self.conductivity, self.force = number(0.006, 0.026, 4), number(3, 13, 2), number(0.8, 3.3, 2)
        self.hot = (0.25, 0.75) if r.random() < 0.4 else (number(0.2, 0.32, 2), number(0.62, 0.78, 2))
        self.speed = self.force * self.height**2 / (8 * self.viscosity)
        self.settings = [
            f"channel.height={self.height}", f"fluid.viscosity={self.viscosity}", f"fluid.conductivity={self.conductivity}",
            f"fluid.body_force={self.force}", f"channel.hot_from={self.hot[0]}", f"channel.hot_to={self.hot[1]}",
        ]
        if r.random() < 0.6:
            self.settings.append(f"fluid.reference_velocity={max(self.speed, 0.05):.3f}")
        shape, amplitude = str(r.choice(["flat", "sine", "cosine", "rough"])), number(0.004, 0.02, 4)
        if with_wall and shape == "rough":
            # A polygon through nine heights.
            x, y = np.linspace(*self.hot, 9), np.r_[0, amplitude * r.uniform(-1, 1, 7), 0]
            nodes = np.arange(self.hot[0] + 0.01, self.hot[1], 0.02)
            self.settings += [f"design.nodes={[round(float(v), 6) for v in nodes]}", f"design.offsets={[round(float(v), 5) for v in np.interp(nodes, x, y)]}"]
        elif with_wall:
            self.settings += [f"design.shape={shape}", f"design.amplitude={amplitude}", f"design.periods={int(r.integers(1, 4))}"]
        self.shape = shape if with_wall else "searched"
        self.settings += settings

    def run(self, folder, *words):
        """The summary of a run, or none."""
        shutil.rmtree(folder, ignore_errors=True)
        sets = [word for setting in self.settings for word in ("--set", setting)]
        return run(words[0], "heated-channel", *words[1:], "--out", folder, *sets)

    def finite_elements(self, folder):
        """Q over the flat wall and over that of a run."""
        nodes, offsets = fem.read_wall(os.path.join(folder, "shape.csv"))
        fem.VISCOSITY, fem.DIFFUSIVITY, fem.FORCE = self.viscosity, self.conductivity / 305.27, self.force
        fem.HOT_FROM, fem.HOT_TO = self.hot
        mesh = fem.Channel(self.height, nodes, 0)
        return mesh.solve(0 * offsets), mesh.solve(offsets)

    def told(self):
        return f"H {self.height} Re {self.speed * self.height / self.viscosity:.0f} u {self.speed:.2f} hot {self.hot[0]} {self.hot[1]} {self.shape}"


def q(channel, folder, turn):
    for method in ["fixed"] + ["consistent"] * (turn % 4 == 0):
        found = channel.run(folder, "simulate", "--error", "--method", method)
        if found:
            _, truth = channel.finite_elements(folder)
            yield ("moving" if method == "consistent" else method), found["q"] / truth - 1, found["q_error"] / truth


def gain(channel, folder, _):
    found = channel.run(folder, "optimize")
    if found and found.get("gain") is not None:
        flat, best = channel.finite_elements(folder)
        yield "gain", found["gain"] - (best / flat - 1), found["gain_error"]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["q", "gain"])
    parser.add_argument("--count", type=int, default=40)
    parser.add_argument("--seed", type=int, default=9000)
    parser.add_argument("--set", action="append", default=[])
    options = parser.parse_args()
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        for turn in range(options.count):
            channel = Channel(options.seed + turn, options.what == "q", options.set)
            if channel.speed * channel.height / channel.viscosity > FASTEST:
                continue
            for name, off, error in {"q": q, "gain": gain}[options.what](channel, os.path.join(folder, "run"), turn):
                found.setdefault(name, []).append((abs(off), error, 1.0))
                print(f"{turn:3d} {channel.told()}: {name} {100 * off:+.3f} error {100 * error:.3f}{'' if abs(off) <= error else ' OUT'}", flush=True)
    conclude(found)


if __name__ == "__main__":
    main()
