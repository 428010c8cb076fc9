"""The pictures and tables of time_error.py, from its rows."""
import math
import os
import sys

HERE = os.path.dirname(os.path.abspath(__file__))
sys.path[:0] = [os.path.dirname(HERE)]
from pages import table

# Colour, marker and line of each contestant; the order is that of the tables.
LOOKS = {
    "fixed particles": ("#1b5fb4", "o", "-"), "fixed particles, fits": ("#7fb0e6", "o", "--"), "moving particles": ("#138d75", "s", "-"),
    "standard SPH": ("#8a8a8a", "v", "-"), "finite elements": ("#d35400", "D", "-"), "finite elements, graded mesh": ("#f0a060", "D", "--"),
    "JAX-SPH": ("#7d3c98", "^", "-"),
}
QUESTIONS = {
    "a": ("Q of a curved wall", {"Q": "relative error"}),
    "b": ("Gradient of Q by the wall", {"gradient": "all nodes", "ends in pairs": "two nodes at each end summed"}),
    "c": ("The whole optimisation", {}),
    "d": ("Vortices of Taylor and Green", {"nu 0.05": "nu 0.05", "nu 0.005": "nu 0.005"}),
    "e": ("A cylinder in a channel", {"drag": "drag", "lift": "lift"}),
}
# Errors below are drawn there; what is above is not drawn.
FLOOR, ROOF = {"d": 1e-6}, 3.0
POSSIBLE = 1.63
# What the picture of the optimisation shows: the usual and the finest run of each contestant.
PICTURED = ("dx 1/50", "dx 1/100", "h 0.04", "h 0.01")


def of_contestants(rows):
    """(contestant, rows) in the order of the tables."""
    for name in LOOKS:
        some = [row for row in rows if row["contestant"] == name]
        if some:
            yield name, some


def draw(question, rows, folder):
    """The picture of a question; returns its path."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    pyplot.rcParams.update({"font.size": 11, "axes.spines.top": False, "axes.spines.right": False})
    title, panels = QUESTIONS[question]
    count = max(1, len(panels))
    figure, axes = pyplot.subplots(1, count, figsize=(9, 4.6 if count == 1 else 4.3), squeeze=False, sharey=count > 1)
    if question == "c":
        ends = [paths(axes[0][0], rows)]
        axes[0][0].set_title(f"{title}: what its best wall so far truly gains", loc="left", fontsize=12)
    else:
        ends = []
        for axis, (key, name) in zip(axes[0], panels.items()):
            ends.append(points(axis, question, key, rows))
            axis.set_title(f"{title}: {name}" if count == 1 or axis is axes[0][0] else name, loc="left", fontsize=12)
        axes[0][0].set_ylabel("relative error")
    for axis in axes[0]:
        axis.grid(True, which="major", color="#e6e6e6", linewidth=0.8)
        axis.set_axisbelow(True)
    figure.supxlabel("processor seconds, one thread, with start-up", fontsize=11)
    figure.tight_layout(pad=0.6)
    figure.canvas.draw()
    for axis, some in zip(axes[0], ends):
        label(figure, axis, some)
    os.makedirs(folder, exist_ok=True)
    path = os.path.join(folder, f"time-error-{question}.png")
    figure.savefig(path, dpi=100)
    pyplot.close(figure)
    return path


def points(axis, question, key, rows):
    """Errors over seconds, a line for each contestant; returns the lines' names and points."""
    floor, ends = FLOOR.get(question, 0.0), []
    for name, some in of_contestants(rows):
        colour, marker, line = LOOKS[name]
        found = [(row["seconds"], max(row["errors"][key], floor)) for row in some if row["errors"].get(key) is not None]
        found = [(x, y) for x, y in found if y <= ROOF]
        if not found:
            continue
        axis.loglog(*zip(*found), line, color=colour, marker=marker, markersize=6, linewidth=1.8)
        ends.append((name if found[0][1] > floor else f"{name}: exact to rounding", colour, found))
    low, high = axis.get_xlim()
    axis.set_xlim(low / 1.3, high * 2.0)
    return ends


def paths(axis, rows):
    """True gains over seconds, of the finest and the usual run of each contestant."""
    ends = []
    for name, some in of_contestants(rows):
        colour, _, line = LOOKS[name]
        for row in some:
            if not row.get("path") or row["at"] not in PICTURED:
                continue
            found = [(seconds, 100 * gain) for seconds, gain in row["path"]]
            axis.step(*zip(*found), line, where="post", color=colour, linewidth=1.6, marker=".", markersize=5)
            corners = [found[0]] + [point for (_, y), (x, top) in zip(found, found[1:]) for point in ((x, y), (x, top))]
            ends.append((f"{name}, {row['at']}", colour, corners))
    axis.set_xscale("log")
    axis.set_ylabel("gain of Q, % (by sharp finite elements)")
    low, high = axis.get_xlim()
    axis.set_xlim(low / 1.2, high * 4.0)
    axis.set_ylim(-0.05, 1.8)
    for share in (0.5, 0.9, 0.99):
        axis.axhline(share * POSSIBLE, color="#999999", linewidth=0.8, linestyle=":")
        axis.annotate(f"{100 * share:.0f} % of what is possible", (axis.get_xlim()[0], share * POSSIBLE), xytext=(4, -3), textcoords="offset points",
                      va="top", fontsize=9, color="#777777")
    return ends


# Where a name may stand beside a point: shift in points, alignment.
PLACES = ((9, 0, "left"), (9, 9, "left"), (9, -9, "left"), (0, 12, "center"), (0, -13, "center"), (-9, 0, "right"), (-9, 10, "right"),
          (-9, -10, "right"), (9, 18, "left"), (9, -18, "left"), (0, 24, "center"), (0, -26, "center"), (14, 30, "left"), (14, -30, "left"))


def label(figure, axis, ends):
    """Names beside their lines where there is room."""
    renderer, taken = figure.canvas.get_renderer(), []
    frame = axis.get_window_extent(renderer)
    dots = [axis.transData.transform(point) for _, _, found in ends for point in between(axis, found)]
    for name, colour, found in ends:
        text = axis.annotate(name, found[-1], xytext=(0, 0), textcoords="offset points", color=colour, fontsize=10, fontweight="bold")
        best = None
        for k, point in enumerate(reversed(found)):
            for dx, dy, ha in PLACES:
                text.xy = point
                text.set_position((dx, dy))
                text.set_ha(ha)
                text.set_va("center")
                box = text.get_window_extent(renderer)
                wrong = sum(box.x0 - 5 < x < box.x1 + 5 and box.y0 - 6 < y < box.y1 + 6 for x, y in dots)
                wrong += 40 * sum(box.overlaps(other) for other in taken)
                wrong += 40 * (box.x1 > frame.x1 + 6 or box.x0 < frame.x0 or box.y0 < frame.y0 or box.y1 > frame.y1 + 4)
                score = wrong + 0.2 * k + 0.02 * (abs(dx) + abs(dy))
                if best is None or score < best[0]:
                    best = score, point, dx, dy, ha
        _, text.xy, dx, dy, ha = best
        text.set_position((dx, dy))
        text.set_ha(ha)
        taken.append(text.get_window_extent(renderer))


def between(axis, found):
    """Points along a line, where the axes have it."""
    out = [found[0]]
    logs = (axis.get_xscale() == "log", axis.get_yscale() == "log")
    to = lambda p: [math.log(v) if log else v for v, log in zip(p, logs)]
    back = lambda p: [math.exp(v) if log else v for v, log in zip(p, logs)]
    for p, q in zip(found, found[1:]):
        a, b = to(p), to(q)
        out += [back([u + t * (v - u) for u, v in zip(a, b)]) for t in [k / 8 for k in range(1, 9)]]
    return out


def number(value):
    """A figure of three digits, or an error."""
    return "-" if value is None else f"{value:.2g}" if value < 10 else f"{value:.0f}"


def shown_error(value):
    if value is None:
        return "-"
    if value < 1e-9:
        return "rounding"
    return f"{100 * value:.2g} %" if value < 0.995 else f"{100 * value:.0f} %" if value < 10 else f"{value:.0e} times"


def full_table(rows):
    """All rows."""
    lines = []
    for question in QUESTIONS:
        for name, some in of_contestants([row for row in rows if row["question"] == question]):
            for row in some:
                seconds = lambda key: number(row.get(key))
                error = lambda key, value: f"{key} {number(value)} s" if key.startswith("to ") else f"{key} {shown_error(value)}"
                what = row.get("failed") or ", ".join(error(key, value) for key, value in row["errors"].items())
                what += f" ({row['note']})" if row.get("note") and not row.get("failed") else ""
                lines.append([question, name, row["at"], row.get("unknowns") or "", *map(seconds, ("seconds", "wall", "start", "compile")), what])
    return table(["", "contestant", "resolution", "unknowns", "processor seconds", "by the clock", "of it start-up", "compiling", "errors"], lines)


def page_table(rows):
    """What the page shows: a line for each question and contestant."""
    lines = []
    for question, (_, panels) in QUESTIONS.items():
        for key in list(panels) if question != "b" else ["gradient"]:
            for name, some in of_contestants([row for row in rows if row["question"] == question]):
                some = [row for row in some if key in row["errors"] or (row.get("failed") and (question != "d" or key in row["at"]))]
                if not some:
                    continue
                errors = ", ".join("failed" if row.get("failed") else shown_error(row["errors"][key]) for row in some)
                at = ", ".join(row["at"].removeprefix(f"{key}, ") for row in some)
                parts = [max((row.get(part) or 0 for row in some), default=0) for part in ("start", "compile")]
                seconds = [", ".join(number(row[key]) for row in some) for key in ("seconds", "wall")]
                lines.append([f"{question}: {key}", name, at, *seconds, number(parts[0]) + (f" + {number(parts[1])}" if parts[1] else ""), errors])
        if question == "c":
            for name, some in of_contestants([row for row in rows if row["question"] == "c"]):
                for row in some:
                    if row.get("failed"):
                        what = row["failed"]
                    else:
                        what = ", ".join(f"{share} %: {number(row['errors'][f'to {share} %'])} s" for share in (50, 90, 99)).replace("- s", "never")
                        what += f"; in the end {100 * (1 - row['errors']['left']):.1f} %" + (f" ({row['note']})" if row.get("note") else "")
                    seconds = [number(row.get(key)) for key in ("seconds", "wall", "start")]
                    lines.append(["c: share of the gain", name, row["at"], *seconds, what])
    return table(["question", "contestant", "resolution", "processor seconds", "by the clock", "of it start-up (+ compiling)", "error"], lines)
