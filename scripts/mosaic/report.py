"""The tables and pictures of what run.sh has measured: `python report.py runs/mosaic`, which has a CSV file for each solver.

Prints the tables, and writes them to table.md. Pictures: error against seconds of processor time, and of the gradient.
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

NAMES = {
    "hydrograd": "hydrograd",
    "warp_ns": "Warp-NS",
    "jax_cfd": "JAX-CFD",
    "xlb": "XLB",
    "phiflow": "PhiFlow",
    "exponax": "Exponax",
}
MISSING = float("nan")


def read(folder: Path) -> dict[tuple[str, str, str, str], str]:
    """Values by task, parameters, solver and figure."""
    found = {}
    for file in sorted(folder.glob("*.csv")):
        with file.open() as lines:
            for row in csv.DictReader(lines):
                found[row["task"], row["parameters"], row["solver"], row["figure"]] = row["value"]
    return found


class Rows:
    """What was measured."""

    def __init__(self, folder: Path) -> None:
        self.all = read(folder)
        present = {key[2] for key in self.all}
        self.solvers = [key for key in NAMES if key in present]

    def number(self, solver: str, task: str, parameters: str, figure: str) -> float:
        value = self.all.get((task, parameters, solver, figure))
        return MISSING if value is None else float(value)

    def several(self, solver: str, task: str, parameters: list[str], figure: str) -> str:
        values = [self.number(solver, task, p, figure) for p in parameters]
        return "-" if all(x != x for x in values) else " ".join("-" if x != x else f"{x:.1e}" for x in values)


def table(header: list[str], rows: list[list[str]]) -> str:
    lines = ["| " + " | ".join(header) + " |", "|" + " --- |" * len(header)]
    return "\n".join(lines + ["| " + " | ".join(row) + " |" for row in rows if any(x != "-" for x in row[1:])])


def tables(rows: Rows) -> str:
    nus = [f"N=64 nu={nu}" for nu in (0.001, 0.01, 0.05)]
    forward = [
        [
            NAMES[s],
            rows.several(s, "forward/baseline", [f"N={n}" for n in (16, 32, 64, 128)], "error"),
            rows.several(s, "forward/agreement/tgv", nus, "error"),
            rows.several(s, "forward/tgv_nu_sweep", ["N=64"], "ranking_mean_error"),
            rows.several(s, "forward/agreement/multimode", nus, "error"),
            rows.several(s, "forward/physical_laws", ["N=64"], "error"),
            rows.several(s, "forward/physical_laws", ["N=64"], "divergence_rms"),
        ]
        for s in rows.solvers
    ]
    cost = [
        [NAMES[s]]
        + [
            rows.several(s, "cost", [f"N={n} steps=100"], figure)
            for figure in ("forward_first_s", "forward_min_cpu_s", "vjp_first_s", "vjp_min_cpu_s")
            for n in (64, 128)
        ]
        for s in rows.solvers
    ]
    fd = ("gradient/fd_check", ["N=16 steps=20"])
    fd3 = ("3d/gradient/fd_check", ["N=16 steps=10"])
    gradient = [
        [NAMES[s]] + [rows.several(s, *check, figure) for check in (fd, fd3) for figure in ("best_cosine", "best_median_rel_err")]
        for s in rows.solvers
    ]
    three = [
        [
            NAMES[s],
            rows.several(s, "3d/forward/baseline", [f"N={n}" for n in (8, 16, 32)], "error"),
            rows.several(s, "3d/forward/agreement", [f"N=16 nu={nu}" for nu in (0.001, 0.01, 0.05)], "error"),
        ]
        + [
            rows.several(s, "3d/cost", [f"N={n} steps=50" for n in (16, 32)], figure)
            for figure in ("forward_min_cpu_s", "vjp_min_cpu_s")
        ]
        for s in rows.solvers
    ]
    one = ["one step, N 16 32 64 128", "vortices, nu .001 .01 .05", "mean (Mosaic's ranking)"]
    return "\n\n".join(
        [
            table(["2D: error"] + one + ["multimode, nu .001 .01 .05 (true)", "laws, N 64", "divergence"], forward),
            table(
                ["2D: seconds"]
                + [f"{what}, N {n}" for what in ("forward, first", "again (cpu)", "VJP, first", "again (cpu)") for n in (64, 128)],
                cost,
            ),
            table(["gradient", "2D cosine", "2D error", "3D cosine", "3D error"], gradient),
            table(["3D", "one step, N 8 16 32", "50 steps, N 16, nu .001 .01 .05", "forward cpu, N 16 32", "VJP cpu, N 16 32"], three),
        ]
    )


def pictures(rows: Rows, folder: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    error = ("forward/agreement/multimode", "N=64 nu=0.01", "error")
    cosine = ("gradient/fd_check", "N=16 steps=20", "best_median_rel_err")
    for stem, (task, parameters, figure), seconds, label in (
        ("error", error, "forward_min_cpu_s", "error of the velocity, multimode, N = 64"),
        ("gradient", cosine, "vjp_min_cpu_s", "median relative error of the gradient, N = 16"),
    ):
        drawing, axes = plt.subplots(figsize=(5, 3.6))
        for solver in rows.solvers:
            x, y = rows.number(solver, "cost", "N=64 steps=100", seconds), rows.number(solver, task, parameters, figure)
            if x == x and y == y:
                axes.loglog(x, y, "o")
                axes.annotate(NAMES[solver], (x, y), textcoords="offset points", xytext=(5, 4))
        axes.set_xlabel("seconds of processor time, 100 steps, N = 64")
        axes.set_ylabel(label)
        axes.margins(0.25)
        drawing.tight_layout()
        drawing.savefig(folder / f"{stem}.png", dpi=150)
        plt.close(drawing)


def main() -> None:
    folder = Path(sys.argv[1])
    rows = Rows(folder)
    if not rows.solvers:
        sys.exit(f"report.py: no rows in {folder}; scripts/mosaic/run.sh makes them")
    text = tables(rows)
    print(text)
    (folder / "table.md").write_text(text + "\n")
    pictures(rows, folder)


main()
