#!/usr/bin/env python3
"""LagrangeBench's own training of its own GNS on one of our data sets; writes weights that `hydrograd evaluate --model` reads.

    python scripts/peers/train_lagrangebench.py --data data/ldc --steps 10000 --pushforward --out runs/ldc-lagrangebench.safetensors
    python scripts/peers/train_lagrangebench.py --data data/rpf --steps 10000 --pushforward --force --out runs/rpf-lagrangebench.safetensors

Its data set class, case, model, trainer and rollouts, version 0.0.1, on the device that jax chooses. Prints the times and, for
windows of the test split, the MSE over 1, 5 and 20 steps, over all particles and over those that move. Not its own: torch's loader
(windows are drawn here, from memory), and what it imports for logging, downloads and pictures, which is left out.
"""
import argparse
import dataclasses
import json
import math
import sys
import time
import warnings
from pathlib import Path

import numpy as np
from lagrangebench_imports import stand_in

warnings.filterwarnings("ignore", category=SyntaxWarning)


class Loader:
    """torch's DataLoader as far as LagrangeBench uses it: batches of a data set, drawn in this process."""

    def __init__(self, dataset, batch_size=1, shuffle=False, collate_fn=None, generator=None, **_):
        self.dataset, self.batch_size, self.collate, self.random = dataset, batch_size, collate_fn, generator if shuffle else None

    def __len__(self):
        return int(len(self.dataset)) // self.batch_size

    def __iter__(self):
        order = np.arange(len(self) * self.batch_size) if self.random is None else self.random.permutation(int(len(self.dataset)))
        for batch in range(len(self)):
            yield self.collate([self.dataset[int(k)] for k in order[batch * self.batch_size:][:self.batch_size]])


class Generator:
    """torch's generator of random numbers, which LagrangeBench seeds for its loader."""

    def manual_seed(self, seed):
        self.permutation = np.random.default_rng(seed).permutation


stand_in("torch.utils.data", Dataset=object, DataLoader=Loader)
stand_in("torch.utils", data=sys.modules["torch.utils.data"])
stand_in("torch", utils=sys.modules["torch.utils"], Generator=Generator, Tensor=type("Tensor", (), {}), manual_seed=lambda _: None)

import haiku as hk
import h5py
import jax
import jax.monitoring
import jax.numpy as jnp
from lagrangebench import GNS, H5Dataset, PushforwardConfig, case_builder, infer
from lagrangebench.train import trainer
from safetensors.numpy import save_file

FRAMES = 6
ROLLOUT = 20
LEAST_RATE = 1e-6
# When, how many and how often steps are unrolled, as in our trainings: `pushforward.*` of hydrograd.
PUSHFORWARD = {"steps": [-1, 3000, 6000], "unrolls": [0, 1, 2], "probs": [3.0, 1.0, 1.0]}


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="folder of a data set: train.h5, test.h5, metadata.json")
    parser.add_argument("--out", type=Path, required=True, help="file for the weights, .safetensors")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--latent", type=int, default=64)
    parser.add_argument("--steps", type=int, default=10000, help="updates")
    parser.add_argument("--noise", type=float, default=3e-4)
    parser.add_argument("--learning-rate", type=float, default=5e-4)
    parser.add_argument("--decay-steps", type=int, default=10000, help="updates over which the learning rate falls to a tenth")
    parser.add_argument("--pushforward", action="store_true", help="unroll one step from update 3000 on, two from 6000 on")
    parser.add_argument("--force", action="store_true", help="the external force of the flow is a feature")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--windows", type=int, help="windows of the test split, spread evenly, 0 for none (default: all)")
    return parser.parse_args()


class Clock:
    """Tells compiling from updating: what passes before the end of the first update, and what jax compiles later."""

    def __init__(self, update):
        self.update, self.updates, self.compiled, self.start = update, 0, [], time.perf_counter()
        jax.monitoring.register_event_duration_secs_listener(self.hear)

    def hear(self, event, seconds, **_):
        if event.startswith("/jax/core/compile/"):
            now = time.perf_counter()
            self.compiled.append((now - seconds, now))

    def __call__(self, **inputs):
        result = self.update(**inputs)
        if self.updates == 0:
            jax.block_until_ready(result)
            self.first = time.perf_counter()
        self.updates += 1
        return result

    def seconds(self):
        """Of compiling and of the updates after the first, now."""
        now, until, later = time.perf_counter(), self.first, 0.0
        # Times of nested functions overlap.
        for begin, end in sorted(self.compiled):
            later += max(0.0, end - max(begin, until))
            until = max(until, end)
        return self.first - self.start + later, now - self.first - later


def data_set(split, folder, frames, windows=None):
    """A split as LagrangeBench's class reads it, with the trajectories in memory: windows for training, or rollouts."""
    rollouts = windows is not None
    data = H5Dataset(split, str(folder), input_seq_length=frames, is_rollout=rollouts)
    with h5py.File(data.file_path) as file:
        data.db_hdf5 = {name: {part: file[name][part][:] for part in ("position", "particle_type")} for name in file}
    if rollouts:
        # The windows of `hydrograd evaluate`: without overlap, all or a number of them spread evenly.
        data.subsequence_length = FRAMES + ROLLOUT
        data.split_valid_traj_into_n = data.sequence_length // data.subsequence_length
        every = data.split_valid_traj_into_n * len(data.traj_keys)
        chosen = [k * every // min(windows, every) for k in range(min(windows, every))]
        data.num_samples, data.getter = len(chosen), lambda k: data.get_trajectory(chosen[k])
    return data


def box_of(metadata):
    """LagrangeBench has all directions periodic or none: an open one is longer by a radius, so that nothing meets around its end."""
    periodic = metadata["periodic_boundary_conditions"][:metadata["dim"]]
    longer = metadata["default_connectivity_radius"] if any(periodic) else 0.0
    return [high - low + (0.0 if around else longer) for (low, high), around in zip(metadata["bounds"], periodic)]


def external_force(metadata):
    """The function that hydrograd's `features.force` has, for the flows that have a force."""
    magnitude, case = metadata.get("g_ext_magnitude", 0.0), metadata.get("case", "")
    others = [0.0] * (metadata["dim"] - 1)
    along_x, down = jnp.array([magnitude, *others]), jnp.array([0.0, -magnitude, *others[1:]])
    if magnitude > 0.0 and case in ("RPF", "reverse-poiseuille", "reverse-poiseuille-3d"):
        middle = 0.5 * sum(metadata["bounds"][1])
        return lambda position: jnp.where(position[1] > middle, -along_x, along_x)
    if magnitude > 0.0 and case in ("DAM", "dam-break", "dam-break-3d"):
        return lambda position: down
    raise SystemExit("--force: these data have no external force (`case` and `g_ext_magnitude` of metadata.json)")


def weights(params, rounds, dim):
    """The parameters by hydrograd's names, each weight `[in, out]`."""
    tensors = {"param.embed.weight": params["gns/~/embed"]["embeddings"]}

    def add(name, stage, k, norm=True):
        number = f"_{k}" if k else ""
        for layer in range(2):
            linear = params[f"gns/~_{stage}/MLP{number}/~/linear_{layer}"]
            tensors.update({f"param.{name}.{layer}.weight": linear["w"], f"param.{name}.{layer}.bias": linear["b"]})
        if norm:
            of_norm = params[f"gns/~_{stage}/layer_norm{number}"]
            tensors.update({f"param.{name}.ln.{part}": of_norm[part] for part in ("scale", "offset")})

    add("enc.node", "encoder", 0)
    add("enc.edge", "encoder", 1)
    for k in range(rounds):
        add(f"proc.{k}.edge", "processor", 2 * k)
        add(f"proc.{k}.node", "processor", 2 * k + 1)
    add("dec", "decoder", 0, norm=False)
    tensors = {name: np.array(tensor, dtype=np.float32) for name, tensor in tensors.items()}
    # Version 0.0.1 has the displacement from receiver to sender, later ones and hydrograd that from sender to receiver.
    tensors["param.enc.edge.0.weight"][:dim] *= -1.0
    assert sum(t.size for t in tensors.values()) == sum(p.size for p in jax.tree.leaves(params)), "parameters without a name"
    return tensors


def header(a, metadata):
    """What hydrograd reads beside the weights."""
    features = {"speed": False, "boundary": not any(metadata["periodic_boundary_conditions"][:metadata["dim"]]), "force": a.force}
    return {"noise_std": repr(a.noise), "features": json.dumps(features), "step": str(a.steps), "origin": f"LagrangeBench 0.0.1, jax {jax.__version__}"}


def evaluate(model, case, test, params, state):
    """Prints the errors of LagrangeBench's rollouts of a split."""
    def preprocess(sample, neighbours):
        features, neighbours = case.preprocess_eval(sample, neighbours)
        # Its rollout does not notice a list that is too short (it compares an array with True by `is`).
        return case.allocate_eval(sample) if neighbours.did_buffer_overflow else (features, neighbours)

    noticing = dataclasses.replace(case, preprocess_eval=preprocess)
    scores = infer(model, noticing, test, params, state, metrics=["mse"], eval_n_trajs=len(test), n_rollout_steps=ROLLOUT)
    errors = np.array([score["mse"] for score in scores.values()])
    # Walls have their true positions in a rollout, so they add nothing to the sum.
    share = np.array([np.mean(~np.isin(test[k][1], (-1, 1, 2))) for k in range(len(test))])[:, None]
    for particles, values in (("all", errors), ("moving", errors / share)):
        print(f"{len(test)} windows, {particles} particles:", ", ".join(f"MSE_{n} {values[:, :n].mean():.6e}" for n in (1, 5, ROLLOUT)))


def main():
    a = arguments()
    metadata = json.loads((a.data / "metadata.json").read_text())
    dim = metadata["dim"]
    force = external_force(metadata) if a.force else None
    case = case_builder(box_of(metadata), metadata, FRAMES, noise_std=a.noise, external_force_fn=force)
    model = hk.without_apply_rng(hk.transform_with_state(lambda x: GNS(dim, a.latent, 2, a.rounds, 16)(x)))

    # Version 0.0.1 does not look at the pushforward that its trainer is given, and its windows are too short for one.
    pushforward = PushforwardConfig(**PUSHFORWARD) if a.pushforward else PushforwardConfig()
    trainer.PushforwardConfig = lambda: pushforward
    unrolled = max(pushforward["unrolls"])
    # Its noise is spread over all frames of a window, ours (and that of its later versions) over those that the model sees.
    noise = a.noise * math.sqrt((FRAMES + unrolled) / (FRAMES - 1))
    train = data_set("train", a.data, FRAMES + unrolled)
    test = data_set("test", a.data, FRAMES, sys.maxsize if a.windows is None else max(1, a.windows))
    clock = trainer._update = Clock(trainer._update)
    run = trainer.Trainer(model, case, train, test, lr_start=a.learning_rate, noise_std=noise, seed=a.seed, lr_final=LEAST_RATE, lr_decay_rate=0.1,
                          lr_decay_steps=a.decay_steps, log_steps=max(1, a.steps // 20), eval_steps=a.steps + 1)
    params, state, _ = jax.block_until_ready(run(step_max=a.steps))
    compiling, updating = clock.seconds()

    a.out.parent.mkdir(parents=True, exist_ok=True)
    save_file(weights(params, a.rounds, dim), a.out, header(a, metadata))
    later = clock.updates - 1
    print(f"lagrangebench 0.0.1, jax {jax.__version__}, {jax.devices()[0].device_kind}")
    print(f"compiling and the first update {compiling:.2f} s; {later} more updates {updating:.2f} s, {1e3 * updating / max(1, later):.3f} ms per update")
    print("weights:", a.out, flush=True)
    if a.windows != 0:
        evaluate(model, case, test, params, state)


if __name__ == "__main__":
    main()
