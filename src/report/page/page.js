"use strict";
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const root = getComputedStyle(document.documentElement);
  const color = (name) => root.getPropertyValue("--" + name).trim();
  const escaped = (text) => String(text).replace(/[&<>"']/g, (c) => "&#" + c.charCodeAt(0) + ";");
  // Seventeen samples of matplotlib's "viridis" (CC0): even steps of lightness, whatever colours one sees.
  const stops = [[68, 1, 84], [72, 24, 106], [71, 45, 123], [66, 64, 134], [59, 82, 139], [51, 99, 141], [44, 114, 142], [38, 130, 142], [33, 145, 140], [31, 160, 136], [40, 174, 128], [63, 188, 115], [94, 201, 98], [132, 212, 75], [173, 220, 48], [216, 226, 25], [253, 231, 37]];
  const shades = Array.from({ length: 256 }, (_, k) => {
    const at = (k / 255) * (stops.length - 1), i = Math.min(stops.length - 2, Math.floor(at));
    return "rgb(" + stops[i].map((from, c) => Math.round(from + (at - i) * (stops[i + 1][c] - from))).join(",") + ")";
  });
  // What must be drawn anew when the width or the colours change.
  const drawn = [];

  function number(x, digits = 6) {
    if (x === null || x === undefined || Number.isNaN(x)) return "none";
    const size = Math.abs(x);
    if (size !== 0 && (size >= 1e6 || size < 1e-4)) return x.toExponential(Math.min(digits - 1, 3));
    return String(Number(x.toPrecision(digits)));
  }

  // ---- axes

  function axis(values, log, count = 5, least = 0) {
    let low = Infinity, high = -Infinity;
    for (const v of values) if (v !== null && Number.isFinite(v) && (!log || v > 0)) { low = Math.min(low, v); high = Math.max(high, v); }
    if (low > high) { low = log ? 0.1 : 0; high = 1; }
    if (log) {
      let a = Math.log10(low), b = Math.log10(high);
      if (b - a < 1e-9) { a -= 0.5; b += 0.5; }
      const margin = 0.04 * (b - a);
      a -= margin; b += margin;
      const every = Math.max(1, Math.ceil((b - a) / 6)), ticks = [];
      for (let k = Math.ceil(a); k <= b; k += every) ticks.push([Math.pow(10, k), "1e" + k]);
      if (ticks.length < 2) {
        // Less than two decades: halves and fifths as well.
        ticks.length = 0;
        for (let k = Math.floor(a); k <= b; k++) for (const m of [1, 2, 5]) {
          const v = m * Math.pow(10, k);
          if (Math.log10(v) >= a && Math.log10(v) <= b) ticks.push([v, m + "e" + k]);
        }
      }
      if (ticks.length < 2) {
        // Not even these: round numbers, as on a linear axis.
        const other = linear(Math.pow(10, a), Math.pow(10, b), 0);
        ticks.splice(0, ticks.length, ...other.ticks.filter((t) => t[0] > 0));
      }
      return { low: a, high: b, ticks, part: (v) => (Math.log10(v) - a) / (b - a) };
    }
    if (high - low < least) { const d = 0.5 * (least - (high - low)); low -= d; high += d; }
    if (high === low) { const d = Math.abs(low) * 0.05 || 0.5; low -= d; high += d; }
    return linear(low, high, 0.06, count);
  }

  function linear(low, high, margin, count = 5) {
    const d = margin * (high - low);
    low -= d; high += d;
    const raw = (high - low) / count, base = Math.pow(10, Math.floor(Math.log10(raw)));
    const step = [1, 2, 5, 10].map((k) => k * base).find((s) => s >= raw);
    const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9)), ticks = [];
    const wide = Math.max(Math.abs(low), Math.abs(high)), is_far = wide >= 1e5 || wide < 1e-3;
    for (let k = Math.ceil(low / step); k * step <= high + 1e-9 * step; k++) {
      const v = k * step, more = v === 0 ? 0 : Math.max(0, Math.floor(Math.log10(Math.abs(v)) + 1e-9) - Math.floor(Math.log10(step) + 1e-9));
      ticks.push([v, is_far ? (v === 0 ? "0" : v.toExponential(more)) : v.toFixed(digits)]);
    }
    return { low, high, ticks, part: (v) => (v - low) / (high - low) };
  }

  // A frame with ticks; its inside, and where a place of it is.
  function frame(width, height, xs, ys, xName, yName) {
    const widest = Math.max(...ys.ticks.map((t) => t[1].length), 1);
    const left = 12 + 7.2 * widest, top = 24, right = width - 12, bottom = height - 40;
    const x = (v) => left + (right - left) * xs.part(v), y = (v) => bottom - (bottom - top) * ys.part(v);
    let svg = "";
    for (const [v, text] of ys.ticks) {
      svg += `<line x1="${left}" x2="${right}" y1="${y(v)}" y2="${y(v)}" stroke="var(--rule)"/>`;
      svg += `<text x="${left - 6}" y="${y(v) + 4}" text-anchor="end">${text}</text>`;
    }
    const room = Math.max(1, Math.floor((right - left) / (9 + 7.2 * Math.max(...xs.ticks.map((t) => t[1].length), 1))));
    const every = Math.ceil(xs.ticks.length / room);
    xs.ticks.forEach(([v, text], k) => {
      if (k % every) return;
      svg += `<line x1="${x(v)}" x2="${x(v)}" y1="${bottom}" y2="${bottom + 5}" stroke="var(--quiet)"/>`;
      svg += `<text x="${x(v)}" y="${bottom + 18}" text-anchor="middle">${text}</text>`;
    });
    svg += `<rect x="${left}" y="${top}" width="${right - left}" height="${bottom - top}" fill="none" stroke="var(--quiet)"/>`;
    svg += `<text class="name" x="${right}" y="${height - 6}" text-anchor="end">${escaped(xName)}</text>`;
    svg += `<text class="name" x="${left}" y="14">${escaped(yName)}</text>`;
    return { svg, x, y, left, right, top, bottom };
  }

  const whole = (axis) => { axis.ticks = axis.ticks.filter((t) => Number.isInteger(Number(t[0].toFixed(9)))).map((t) => [t[0], String(Math.round(t[0]))]); return axis; };
  const svg = (width, height, label, inside) =>
    `<svg viewBox="0 0 ${width} ${height}" role="img" aria-label="${escaped(label)}">${inside}</svg>`;

  // ---- lines over numbers: told apart by colour, dash and marker as in the pictures, eight in a frame at most

  const most = 8, dashes = ["", "8 4", "2.5 3.5", "15 5"];
  const shapes = [
    (x, y) => `<circle cx="${x}" cy="${y}" r="3.4"/>`,
    (x, y) => `<rect x="${x - 3.2}" y="${y - 3.2}" width="6.4" height="6.4"/>`,
    (x, y) => `<path d="M${x} ${y - 4.4}l4.2 7.4h-8.4z"/>`,
    (x, y) => `<path d="M${x} ${y - 4.6}l4.6 4.6l-4.6 4.6l-4.6 -4.6z"/>`,
  ];
  const marks = (k, inside) => `<g fill="var(--${k % most < 4 ? "s" + k : "card"})" stroke="var(--s${k})" stroke-width="1.6">${inside}</g>`;
  const style = (k) => `stroke="var(--s${k})" stroke-dasharray="${dashes[k % 4]}"`;
  const sample = (k, x, y) => `<line x1="${x}" x2="${x + 30}" y1="${y}" y2="${y}" stroke-width="2" ${style(k)}/>` + marks(k, shapes[k % 4](x + 15, y));

  function chart(element, spec) {
    const points = (s) => s.points.filter((p) => p[1] !== null && (!spec.log || p[1] > 0));
    const all = spec.series.flatMap(points), frames = Math.max(1, Math.ceil(spec.series.length / most));
    const each = Math.ceil(spec.series.length / frames) || 1;
    const state = { at: null, draw };
    function draw() {
      element.innerHTML = Array.from({ length: frames }, (_, k) => part(spec.series.slice(k * each, (k + 1) * each))).join("");
    }
    function part(series) {
      const width = Math.max(260, element.clientWidth), height = Math.round(Math.min(340, Math.max(230, 0.56 * width)));
      // Names stand where lines end, if there is room beside the frame; else below it.
      const named = series.map((s, k) => [s, k]).filter(([s]) => series.length > 1 && points(s).length);
      const room = named.length ? 56 + 6.4 * Math.max(...named.map(([s]) => s.name.length)) : 0, is_beside = room < 0.4 * width;
      const counts = spec.by_epoch || ["epoch", "step"].includes(spec.x);
      let xs = all.length ? axis(all.map((p) => p[0]), false, counts ? 8 : 5) : linear(0, 1, 0);
      if (counts) xs = whole(xs);
      const ys = axis(all.map((p) => p[1]), spec.log), f = frame(is_beside ? width - room : width, height, xs, ys, spec.x, spec.y);
      let inside = f.svg;
      if (state.at !== null) inside += `<line class="at" x1="${f.x(state.at)}" x2="${f.x(state.at)}" y1="${f.top}" y2="${f.bottom}" stroke="var(--ink)" stroke-dasharray="3 3"/>`;
      series.forEach((s, k) => {
        let path = "", is_open = false;
        for (const p of s.points) {
          if (p[1] === null || (spec.log && p[1] <= 0)) { is_open = false; continue; }
          path += `${is_open ? "L" : "M"}${f.x(p[0]).toFixed(1)} ${f.y(p[1]).toFixed(1)}`;
          is_open = true;
        }
        inside += `<path d="${path}" fill="none" stroke-width="2" ${style(k)}/>`;
        // A line of many points has its marker at some of them, each line at others.
        const shown = points(s), every = shown.length > 45 ? Math.ceil(shown.length / 10) : 1, first = Math.floor(every * k / most);
        if (every === 1 || series.length > 1) inside += marks(k, shown.filter((_, i) => i % every === first % every).map((p) => {
          const title = `${s.name ? s.name + ": " : ""}${number(p[0])}, ${number(p[1])}`;
          return `<g><title>${escaped(title)}</title>${shapes[k % 4](f.x(p[0]), f.y(p[1]))}</g>`;
        }).join(""));
      });
      if (is_beside) {
        const ends = named.map(([s, k]) => { const p = points(s).reduce((a, b) => (b[0] >= a[0] ? b : a)); return { s, k, x: f.x(p[0]), y: f.y(p[1]) }; });
        ends.sort((a, b) => a.y - b.y).forEach((e, i) => { e.at = Math.max(e.y, i ? ends[i - 1].at + 15 : f.top); });
        for (let i = ends.length - 1, low = f.bottom; i >= 0; i--, low -= 15) ends[i].at = Math.min(ends[i].at, low);
        for (const e of ends) {
          inside += `<line x1="${e.x}" y1="${e.y}" x2="${f.right + 8}" y2="${e.at}" stroke="var(--s${e.k})" stroke-width=".8"/>` + sample(e.k, f.right + 8, e.at);
          inside += `<text x="${f.right + 43}" y="${e.at + 4}">${escaped(e.s.name)}</text>`;
        }
      }
      const ends = series.map((s) => { const p = points(s); return p.length ? `${s.name || spec.y} from ${number(p[0][1], 4)} to ${number(p[p.length - 1][1], 4)}` : ""; });
      const html = svg(width, height, `${spec.title}: ${ends.filter(Boolean).join("; ")}`, inside);
      if (is_beside || !named.length) return html;
      return html + `<ul class="legend">` + named.map(([s, k]) => `<li><svg viewBox="0 0 42 14" aria-hidden="true">${sample(k, 6, 7)}</svg>${escaped(s.name)}</li>`).join("") + "</ul>";
    }
    drawn.push(state);
    return state;
  }

  const charts = [...document.querySelectorAll("[data-chart]")].map((element) => {
    const spec = data.charts[Number(element.dataset.chart)];
    return { spec, state: chart(element, spec) };
  });

  // ---- walls by epoch

  if (data.walls) walls(data.walls);

  function walls(w) {
    const slider = document.getElementById("epoch"), now = document.getElementById("epoch-now");
    const place = document.getElementById("wall"), note = document.getElementById("wall-note");
    const epochs = w.sides[0].offsets.length, is_map = w.across !== null;
    // Of a data set: a wall of each trajectory, none of them the best.
    const is_named = w.names.length > 0, item = is_named ? "trajectory" : "epoch";
    const values = w.sides.map((side) => side.offsets.map((offsets) => offsets.map((o) => side.base + side.sign * o)));
    const state = { draw: is_map ? drawMap : drawLines };
    let k = w.best;

    function drawLines() {
      const width = Math.max(260, place.clientWidth), xs = linear(w.nodes[0], w.nodes[w.nodes.length - 1], 0.01);
      let html = "", stretch = 1;
      // The top wall is above.
      for (let s = w.sides.length - 1; s >= 0; s--) {
        const side = w.sides[s], all = values[s], height = Math.round(Math.min(300, Math.max(200, 0.34 * width)));
        // A flat wall is not the whole picture: a twentieth of its length is shown of heights.
        const ys = axis(all.flat().concat([side.base]), false, 5, 0.05 * (w.nodes[w.nodes.length - 1] - w.nodes[0])), f = frame(width, height, xs, ys, "x (scene units)", `${side.name}: y (scene units)`);
        stretch = ((f.bottom - f.top) / (ys.high - ys.low)) / ((f.right - f.left) / (xs.high - xs.low));
        const path = (offsets) => offsets.map((v, i) => `${i ? "L" : "M"}${f.x(w.nodes[i]).toFixed(1)} ${f.y(v).toFixed(1)}`).join("");
        const edge = side.sign > 0 ? f.bottom : f.top, first = f.x(w.nodes[0]), last = f.x(w.nodes[w.nodes.length - 1]);
        let inside = `<path class="solid" d="${path(all[k])}L${last} ${edge}L${first} ${edge}Z" fill="var(--fluid)"/>` + f.svg;
        const every = Math.max(1, Math.ceil(epochs / 60));
        for (let e = 0; e < epochs; e += every) inside += `<path d="${path(all[e])}" fill="none" stroke="var(--wall)" stroke-width="1" opacity="0.45"/>`;
        if (!is_named) {
          inside += `<path d="${path(all[0])}" fill="none" stroke-width="2" stroke="var(--s1)" stroke-dasharray="8 4"/>`;
          inside += `<path d="${path(all[w.best])}" fill="none" stroke-width="2" stroke="var(--s2)" stroke-dasharray="2 3"/>`;
        }
        inside += `<path class="wall-now" d="${path(all[k])}" fill="none" stroke-width="3" stroke="var(--s0)"/>`;
        if (all[k].length <= 60) inside += `<g fill="var(--s0)">${all[k].map((v, i) => shapes[0](f.x(w.nodes[i]), f.y(v))).join("")}</g>`;
        html += svg(width, height, `${side.name} in ${item} ${k + 1}, from ${number(Math.min(...all[k]), 3)} to ${number(Math.max(...all[k]), 3)}`, inside);
      }
      const line = (text, more) => `<li><svg viewBox="0 0 42 14" aria-hidden="true"><line x1="0" x2="42" y1="7" y2="7" ${more}/></svg>${text}</li>`;
      const marked = is_named ? "" : line("first", `stroke="var(--s1)" stroke-width="2" stroke-dasharray="8 4"`) +
        line(`best (epoch ${w.best + 1})`, `stroke="var(--s2)" stroke-width="2" stroke-dasharray="2 3"`);
      html += `<ul class="legend">` + line(is_named ? escaped(w.names[k]) : `epoch ${k + 1}`, `stroke="var(--s0)" stroke-width="3"`) + marked +
        line(is_named && epochs > 60 ? "some of the others" : `every ${item}`, `stroke="var(--wall)" stroke-width="1"`) + "</ul>";
      place.innerHTML = html;
      note.textContent = stretch > 1.5 ? `Heights are drawn ${number(stretch, 2)} times as tall as lengths.` : "";
    }

    function drawMap() {
      const along = [...new Set(w.nodes)].sort((a, b) => a - b), across = [...new Set(w.across)].sort((a, b) => a - b);
      const all = values[0].flat(), low = Math.min(...all), high = Math.max(...all);
      // Heights are at the middles of cells.
      const ends = (v) => { const half = v.length > 1 ? 0.5 * (v[1] - v[0]) : 0.5; return [v[0] - half, v[v.length - 1] + half]; };
      const [x0, x1] = ends(along), [z0, z1] = ends(across);
      let canvas = place.querySelector("canvas");
      if (!canvas) { place.innerHTML = `<canvas role="img"></canvas>`; canvas = place.querySelector("canvas"); }
      const width = Math.max(260, place.clientWidth), left = 48, top = 22, inner = width - left - 96;
      const tall = Math.min(380, Math.max(60, inner * (z1 - z0) / (x1 - x0))), c = sized(canvas, width, top + tall + 38);
      values[0][k].forEach((v, i) => {
        const a = along.indexOf(w.nodes[i]), b = across.indexOf(w.across[i]);
        c.fillStyle = shades[Math.round(255 * (v - low) / (high - low || 1))];
        c.fillRect(left + a * inner / along.length, top + tall - (b + 1) * tall / across.length, inner / along.length + 0.5, tall / across.length + 0.5);
      });
      const bar = left + inner + 16;
      for (let y = 0; y < tall; y++) { c.fillStyle = shades[Math.round(255 * (1 - y / tall))]; c.fillRect(bar, top + y, 14, 1.5); }
      axes(c, { left, top, inner, tall }, [x0, x1], [z0, z1]);
      c.textAlign = "left";
      for (const [v, text] of axis([low, high], false).ticks) if (v >= low && v <= high) c.fillText(text, bar + 19, top + tall * (1 - (v - low) / (high - low || 1)) + 4);
      c.fillText("height", bar, top - 8);
      c.fillText("z (scene units)", left, top - 8);
      c.textAlign = "right";
      c.fillText("x (scene units)", left + inner, top + tall + 32);
      canvas.setAttribute("aria-label", `Height of the wall over x (to the right) and z (up) in epoch ${k + 1}`);
      note.textContent = `Heights of all epochs: ${number(low, 3)} to ${number(high, 3)}; here ${number(Math.min(...values[0][k]), 3)} to ${number(Math.max(...values[0][k]), 3)}.`;
    }

    function show() {
      k = Number(slider.value) - 1;
      const value = w.values[k];
      now.textContent = `${k + 1} of ${epochs}: ` + (is_named ? w.names[k] : value === null || value === undefined ? "rejected" : `${w.symbol} ${number(value)}`) + (k === w.best && !is_named ? ", the best" : "");
      slider.setAttribute("aria-valuetext", now.textContent);
      state.draw();
      for (const { spec, state: other } of charts) if (spec.by_epoch) { other.at = k + 1; other.draw(); }
    }
    drawn.push(state);
    slider.addEventListener("input", show);
    for (const button of document.querySelectorAll("[data-epoch]")) {
      button.addEventListener("click", () => { slider.value = button.dataset.epoch; show(); });
    }
    requestAnimationFrame(show);
  }

  // ---- particles over time

  if (data.fields) fields(data.fields);

  // The frame of a canvas with ticks below and on the left.
  function axes(c, l, [x0, x1], [y0, y1]) {
    c.font = "11px system-ui, sans-serif";
    c.fillStyle = c.strokeStyle = color("quiet");
    c.lineWidth = 1;
    c.textAlign = "right";
    for (const [v, text] of linear(y0, y1, 0, Math.max(2, Math.min(5, l.tall / 40))).ticks) {
      c.fillText(text, l.left - 5, l.top + l.tall * (1 - (v - y0) / (y1 - y0)) + 4);
    }
    c.textAlign = "center";
    for (const [v, text] of linear(x0, x1, 0, Math.max(2, Math.min(8, l.inner / 70))).ticks) {
      c.fillText(text, l.left + l.inner * (v - x0) / (x1 - x0), l.top + l.tall + 16);
    }
    c.strokeRect(l.left, l.top, l.inner, l.tall);
  }

  function sized(canvas, width, height) {
    const ratio = Math.min(window.devicePixelRatio || 1, 3);
    canvas.style.height = height + "px";
    if (canvas.width !== Math.round(width * ratio)) canvas.width = Math.round(width * ratio);
    if (canvas.height !== Math.round(height * ratio)) canvas.height = Math.round(height * ratio);
    const c = canvas.getContext("2d");
    c.setTransform(ratio, 0, 0, ratio, 0, 0);
    c.clearRect(0, 0, width, height);
    return c;
  }

  function fields(all) {
    const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
    const panels = all.panels.map((panel) => {
      let tag = new Uint8Array();
      return panel.frames.map((f) => {
        if (f.tag) tag = bytes(f.tag);
        const raw = bytes(f.position), view = new DataView(raw.buffer), count = raw.length / 4;
        const x = new Float32Array(count), y = new Float32Array(count);
        for (let i = 0; i < count; i++) { x[i] = view.getUint16(4 * i, true) / 65535; y[i] = view.getUint16(4 * i + 2, true) / 65535; }
        return { time: f.time, tag, x, y, values: f.values.map(bytes) };
      });
    });
    const longest = panels.reduce((a, b) => (b.length > a.length ? b : a));
    const slider = document.getElementById("time"), choice = document.getElementById("quantity"), play = document.getElementById("play");
    const canvases = [...document.querySelectorAll("canvas[data-panel]")], probe = document.getElementById("probe");
    const [x0, x1] = all.x, [y0, y1] = all.y;
    slider.max = longest.length - 1;
    slider.value = longest.length - 1;
    // The frame of a panel at the time of the slider.
    const at = (panel) => {
      const time = longest[Number(slider.value)].time;
      return panel.reduce((best, f) => (Math.abs(f.time - time) < Math.abs(best.time - time) ? f : best));
    };
    const layout = (canvas) => {
      const width = Math.max(220, canvas.parentElement.clientWidth), left = 42, bottom = 24, top = 6, right = 12;
      let scale = (width - left - right) / (x1 - x0);
      scale = Math.min(scale, Math.max(360, 0.7 * window.innerHeight) / (y1 - y0));
      return { width, height: top + bottom + scale * (y1 - y0), left, top, scale, inner: scale * (x1 - x0), tall: scale * (y1 - y0) };
    };

    function draw() {
      const quantity = Number(choice.value), q = all.quantities[quantity];
      canvases.forEach((canvas, p) => {
        const f = at(panels[p]), l = layout(canvas), c = sized(canvas, l.width, l.height);
        const radius = Math.max(0.6, 0.5 * all.diameter * l.scale), values = f.values[quantity];
        c.save();
        c.beginPath();
        c.rect(l.left, l.top, l.inner, l.tall);
        c.clip();
        c.fillStyle = color("ground");
        c.fillRect(l.left, l.top, l.inner, l.tall);
        const ring = color("wall");
        for (let i = 0; i < f.x.length; i++) {
          const x = l.left + f.x[i] * l.inner, y = l.top + (1 - f.y[i]) * l.tall, tag = f.tag[i];
          c.beginPath();
          if (tag === 0) {
            c.fillStyle = shades[values[i]];
            c.arc(x, y, radius, 0, 6.2832);
            c.fill();
          } else {
            const is_hot = tag === 3 || tag === 5, is_point = tag >= 4;
            c.lineWidth = is_hot ? Math.max(1, 0.45 * radius) : Math.max(0.5, 0.18 * radius);
            c.strokeStyle = is_hot ? color("ink") : ring;
            c.arc(x, y, Math.max(0.4, (is_point ? 0.4 : 1) * radius - 0.5 * c.lineWidth), 0, 6.2832);
            c.stroke();
          }
        }
        c.restore();
        axes(c, l, all.x, all.y);
        canvas.setAttribute("aria-label", `Particles ${all.panels[p].title} by ${q.name} at time ${number(f.time, 4)}`);
      });
      const last = longest[Number(slider.value)].time;
      document.getElementById("time-now").textContent = number(last, 4);
      slider.setAttribute("aria-valuetext", `time ${number(last, 4)}`);
      const bar = document.getElementById("bar"), width = Math.max(60, bar.clientWidth), c = sized(bar, width, 16);
      for (let x = 0; x < width; x++) { c.fillStyle = shades[Math.round(255 * x / Math.max(1, width - 1))]; c.fillRect(x, 0, 1.5, 16); }
      for (const [id, value] of [["bar-low", q.low], ["bar-high", q.high]]) {
        const end = document.getElementById(id);
        end.value = value;
        end.textContent = number(value, 4);
      }
      document.getElementById("bar-name").textContent = q.unit ? `${q.name} (${q.unit})` : q.name;
    }

    // What a particle under the pointer has.
    canvases.forEach((canvas, p) => canvas.addEventListener("pointermove", (event) => {
      const f = at(panels[p]), l = layout(canvas), box = canvas.getBoundingClientRect(), q = all.quantities[Number(choice.value)];
      const x = (event.clientX - box.left - l.left) / l.inner, y = 1 - (event.clientY - box.top - l.top) / l.tall;
      let best = -1, least = Infinity;
      for (let i = 0; i < f.x.length; i++) {
        const d = Math.hypot((f.x[i] - x) * l.inner, (f.y[i] - y) * l.tall);
        if (f.tag[i] === 0 && d < least) { least = d; best = i; }
      }
      if (least > 20) { probe.textContent = ""; return; }
      const value = q.low + f.values[Number(choice.value)][best] / 255 * (q.high - q.low);
      const there = [x0 + f.x[best] * (x1 - x0), y0 + f.y[best] * (y1 - y0)];
      probe.textContent = `${all.panels[p].title}: ${q.name} ${number(value, 3)} at (${there.map((v) => number(v, 3)).join(", ")})`;
    }));

    let timer = null;
    const stop = () => { clearInterval(timer); timer = null; play.textContent = "Play"; play.setAttribute("aria-pressed", "false"); };
    // Never by itself: who wants to see it move says so.
    play.addEventListener("click", () => {
      if (timer !== null) return stop();
      play.textContent = "Pause";
      play.setAttribute("aria-pressed", "true");
      const calm = matchMedia("(prefers-reduced-motion: reduce)").matches;
      timer = setInterval(() => { slider.value = (Number(slider.value) + 1) % longest.length; draw(); }, calm ? 1000 : 160);
    });
    slider.addEventListener("input", () => { if (timer !== null) stop(); draw(); });
    choice.addEventListener("change", () => { probe.textContent = ""; draw(); });
    if (longest.length < 2) play.disabled = slider.disabled = true;
    drawn.push({ draw });
  }

  // ---- when the page's width or colours change

  let width = 0;
  const all = () => drawn.forEach((it) => it.draw());
  new ResizeObserver(() => { if (document.body.clientWidth !== width) { width = document.body.clientWidth; all(); } }).observe(document.body);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", all);
})();
