#!/usr/bin/env python3
"""LagrangeBench's own GNS and training step on the flow of `hydrograd bench surrogate`, timed in this process; prints one row.

    python scripts/peers/surrogate_lagrangebench.py --rounds 10 --latent 128 --radius 3 --kind training

Its case (noise, neighbour list, features), its model, its update function, compiled by jax; compiling is not timed. The
package imports more than it needs here: what is only for logging, downloads and pictures is left out.
"""
import sys
from functools import partial
from unittest import mock

import surrogate_row

for name in ("torch", "torch.utils", "torch.utils.data"):
    sys.modules[name] = mock.MagicMock(name=name)

import lagrangebench_imports  # noqa: F401

import jax
import jax.numpy as jnp

jax.config.update("jax_platforms", "cpu")

import haiku as hk
import numpy as np
import optax

import surrogate_graph as flow
from lagrangebench.case_setup.case import case_builder
from lagrangebench.models.gns import GNS
from lagrangebench.train.trainer import _mse, _update
from lagrangebench.utils import LossConfig


def main():
    a = surrogate_row.arguments(__doc__)
    metadata = flow.metadata(a.radius)
    noise = 0.01 * flow.SPACING
    case = case_builder(flow.BOX, metadata, 6, noise_std=noise)
    model = hk.without_apply_rng(hk.transform_with_state(lambda x: GNS(2, a.latent, 2, a.rounds, 16)(x)))
    positions = np.asarray(flow.positions(), dtype=np.float32).transpose(1, 0, 2)
    kinds = np.zeros(len(positions), dtype=np.int64)
    key, features, _, neighbours = case.allocate(jax.random.PRNGKey(0), (positions, kinds))
    params, state = model.init(key, (features, kinds))
    apply = jax.jit(model.apply)
    loss_weight = LossConfig()
    schedule = optax.exponential_decay(5e-4, 100_000, 0.1, end_value=1e-6)
    opt_init, opt_update = optax.adamw(learning_rate=schedule, weight_decay=1e-8)
    opt_state = opt_init(params)
    update = partial(_update, loss_fn=partial(_mse, model_fn=apply, loss_weight=loss_weight), opt_update=opt_update)
    batch = (jnp.array(positions[None]), jnp.array(kinds[None]))
    preprocess = jax.vmap(case.preprocess, in_axes=(0, 0, None, 0, None))
    now = {"keys": jax.random.split(key, 1), "neighbours": jax.tree_util.tree_map(lambda x: x[None], neighbours),
           "params": params, "state": state, "opt": opt_state}

    def training():
        now["keys"], features, target, now["neighbours"] = preprocess(now["keys"], batch, noise, now["neighbours"], 0)
        loss, now["params"], now["state"], now["opt"] = update(
            params=now["params"], state=now["state"], features_batch=features, target_batch=target,
            particle_type_batch=batch[1], opt_state=now["opt"])
        loss.block_until_ready()

    current = jnp.array(positions[:, :6])

    def forward():
        features, now["single"] = case.preprocess_eval((current, kinds), now.get("single", neighbours))
        prediction, _ = apply(params, state, (features, kinds))
        case.integrate(prediction, current).block_until_ready()

    surrogate_row.measure(a, "lagrangebench", training if a.kind == "training" else forward, len(positions),
                          int((neighbours.idx[0] < len(positions)).sum()),
                          f"lagrangebench 0.0.1, jax {jax.__version__}; list of {neighbours.idx.shape[1]} edges")


if __name__ == "__main__":
    main()
