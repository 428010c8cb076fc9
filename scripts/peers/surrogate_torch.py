#!/usr/bin/env python3
"""A graph network simulator in PyTorch on the flow of `hydrograd bench surrogate`, timed in this process; prints one row.

    python scripts/peers/surrogate_torch.py --rounds 10 --latent 128 --radius 3 --kind training [--split]

Graph and features are made once and not timed (ours are). --split: the edges' first layer as Ws n_s + Wr n_r + We e, nodes
multiplied once and gathered, as ours; else one product with the concatenated [n_s, n_r, e].
"""
import surrogate_row

import numpy as np
import torch
from torch import nn

import surrogate_graph as flow


def perceptron(inputs, latent, outputs, norm=True):
    layers = [nn.Linear(inputs, latent), nn.ReLU(), nn.Linear(latent, outputs)]
    return nn.Sequential(*layers, *([nn.LayerNorm(outputs)] if norm else []))


class Edges(nn.Module):
    def __init__(self, latent, split):
        super().__init__()
        self.latent, self.split = latent, split
        self.first = nn.Linear(3 * latent, latent)
        self.rest = nn.Sequential(nn.ReLU(), nn.Linear(latent, latent), nn.LayerNorm(latent))

    def forward(self, nodes, edges, senders, receivers):
        if not self.split:
            return self.rest(self.first(torch.cat([nodes[senders], nodes[receivers], edges], -1)))
        of_sender, of_receiver, of_edge = self.first.weight.split(self.latent, dim=1)
        sent = (nodes @ of_sender.T).index_select(0, senders)
        received = nn.functional.linear(nodes, of_receiver, self.first.bias).index_select(0, receivers)
        return self.rest(edges @ of_edge.T + sent + received)


class Network(nn.Module):
    def __init__(self, rounds, latent, split, node_features=10, embedding=16):
        super().__init__()
        self.kinds = nn.Embedding(9, embedding)
        self.node_encoder = perceptron(node_features + embedding, latent, latent)
        self.edge_encoder = perceptron(3, latent, latent)
        self.edges = nn.ModuleList(Edges(latent, split) for _ in range(rounds))
        self.nodes = nn.ModuleList(perceptron(2 * latent, latent, latent) for _ in range(rounds))
        self.decoder = perceptron(latent, latent, 2, norm=False)

    def forward(self, nodes, edges, kinds, senders, receivers):
        n, e = self.node_encoder(torch.cat([nodes, self.kinds(kinds)], -1)), self.edge_encoder(edges)
        for of_edges, of_nodes in zip(self.edges, self.nodes):
            messages = of_edges(n, e, senders, receivers)
            sums = torch.zeros_like(n).index_add(0, receivers, messages)
            n, e = n + of_nodes(torch.cat([n, sums], -1)), e + messages
        return self.decoder(n)


def main():
    a = surrogate_row.arguments(__doc__, split=True)
    torch.manual_seed(0)
    frames = flow.positions()[:7]
    senders, receivers = flow.edges(frames[5], a.radius)
    speed = flow.SPEED * flow.SPACING
    velocities = flow.nearest(np.diff(frames, axis=0)) / speed
    relative = flow.nearest(frames[5][receivers] - frames[5][senders]) / (a.radius * flow.SPACING)
    edges = np.concatenate([relative, np.linalg.norm(relative, axis=-1, keepdims=True)], -1)
    nodes = np.concatenate(list(velocities[:5]), -1)
    tensor = lambda values: torch.tensor(values, dtype=torch.float32)
    inputs = (tensor(nodes), tensor(edges), torch.zeros(len(nodes), dtype=torch.long), torch.tensor(senders),
              torch.tensor(receivers))
    target = tensor((velocities[5] - velocities[4]) / 0.1)
    model = Network(a.rounds, a.latent, a.split)
    optimiser = torch.optim.AdamW(model.parameters(), lr=5e-4, weight_decay=1e-8, fused=True)

    def training():
        optimiser.zero_grad(set_to_none=True)
        (model(*inputs) - target).square().sum(-1).mean().backward()
        optimiser.step()

    def forward():
        with torch.inference_mode():
            model(*inputs)

    code = "pytorch, split edge layer" if a.split else "pytorch"
    surrogate_row.measure(a, code, training if a.kind == "training" else forward, len(nodes), len(senders),
                          f"torch {torch.__version__}")


if __name__ == "__main__":
    main()
