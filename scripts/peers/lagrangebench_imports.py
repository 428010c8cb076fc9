"""Makes LagrangeBench 0.0.1 importable beside a later jax: import this first.

What it imports for logging, downloads and pictures is replaced, jax gets back the names of 2023, and jax_md is a bare folder. The
device is the one that jax chooses.
"""
import importlib.machinery
import importlib.util
import sys
import types
from unittest import mock


def stand_in(name, **contents):
    """A module with these contents."""
    sys.modules[name] = module = types.ModuleType(name)
    module.__dict__.update(__spec__=importlib.machinery.ModuleSpec(name, None), **contents)


for name in ("wandb", "wandb.wandb_run", "gdown", "pyvista", "ott", "ott.tools", "ott.geometry", "ott.geometry.geometry", "ott.tools.sinkhorn_divergence",
             "e3nn_jax", "e3nn_jax._src", "e3nn_jax._src.tensor_products"):
    sys.modules[name] = mock.MagicMock(name=name)

import jax
import jax.extend.backend
import jax.interpreters
import jax.lib

# Names of 2023 that later versions of jax no longer have.
jax.random.KeyArray = jax.Array
for name in ("tree_map", "tree_leaves", "tree_structure", "tree_flatten", "tree_unflatten"):
    if not hasattr(jax, name):
        setattr(jax, name, getattr(jax.tree_util, name))
stand_in("jax.abstract_arrays", ShapedArray=jax.ShapeDtypeStruct)
for package, name, contents in [("jax.lib", "xla_bridge", {"get_backend": jax.extend.backend.get_backend}), ("jax.interpreters", "partial_eval", {})]:
    if importlib.util.find_spec(f"{package}.{name}") is None and not hasattr(sys.modules[package], name):
        stand_in(f"{package}.{name}", **contents)
        setattr(sys.modules[package], name, sys.modules[f"{package}.{name}"])

# jax_md as a bare folder: importing all of it fails with a later jax.
stand_in("jax_md", __path__=list(importlib.util.find_spec("jax_md").submodule_search_locations))
