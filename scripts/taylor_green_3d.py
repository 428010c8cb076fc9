#!/usr/bin/env python3
"""Kinetic energy of the three-dimensional Taylor-Green vortices by a Fourier-Galerkin method: data/reference/taylor-green-3d.csv.

    python3 scripts/taylor_green_3d.py [MODES] > data/reference/taylor-green-3d.csv

Incompressible, Re = 50, box of 2 pi, u = sin x cos y cos z, v = -cos x sin y cos z (Brachet et al. 1983). Rotational form,
dealiased by the 2/3 rule, exact viscosity, fourth-order Runge-Kutta; needs numpy only. 48 and 64 modes agree to 2e-7.
"""
import sys

import numpy as np

n = int(sys.argv[1]) if len(sys.argv) > 1 else 48
nu, dt, end, every = 1.0 / 50.0, 0.02, 10.0, 25
x = 2 * np.pi * np.arange(n) / n
X, Y, Z = np.meshgrid(x, x, x, indexing="ij")
k1 = np.fft.fftfreq(n, 1.0 / n)
K = np.array(np.meshgrid(k1, k1, np.abs(np.fft.rfftfreq(n, 1.0 / n)), indexing="ij"))
K2 = (K**2).sum(0)
keep = (np.abs(K) < n / 3).all(0)
inverse = np.where(K2 > 0, 1.0 / np.maximum(K2, 1), 0.0)


def to(f):
    return np.array([np.fft.rfftn(c) for c in f])


def back(f):
    return np.array([np.fft.irfftn(c, s=(n, n, n), axes=(0, 1, 2)) for c in f])


def rate(u):
    """u x omega, projected onto fields without divergence."""
    omega = 1j * np.cross(K, u, axis=0)
    f = to(np.cross(back(u), back(omega), axis=0)) * keep
    return f - K * ((K * f).sum(0) * inverse)


u = to([np.sin(X) * np.cos(Y) * np.cos(Z), -np.cos(X) * np.sin(Y) * np.cos(Z), 0 * X])
half, whole = np.exp(-nu * K2 * dt / 2), np.exp(-nu * K2 * dt)
print("# Taylor-Green 3D, Re = 50: mean of u.u/2 over the box; scripts/taylor_green_3d.py, %d modes" % n)
print("time,kinetic_energy")
for step in range(int(round(end / dt)) + 1):
    if step % every == 0:
        print("%.2f,%.9f" % (step * dt, 0.5 * (back(u) ** 2).sum(0).mean()), flush=True)
    a = rate(u)
    b = rate(half * (u + dt / 2 * a))
    c = rate(half * u + dt / 2 * b)
    d = rate(whole * u + dt * half * c)
    u = whole * u + dt / 6 * (whole * a + 2 * half * (b + c) + d)
