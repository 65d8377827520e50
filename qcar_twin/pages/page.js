// Draws the charts and explorers of a page from the data beside them; colours by name, so that light and dark share all.
"use strict";
(() => {
const root = document.documentElement;
const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
const plots = [];  // things that can be drawn again: {draw()}
const explorers = [];
let printing = false;

// ---- colours -----------------------------------------------------------------------------------

const ink = name => getComputedStyle(root).getPropertyValue("--" + name).trim();

function coloured(text) {
  const [name, opacity] = text.slice(1).split("/");
  const hex = ink(name) || "#888888";
  return opacity ? hex + Math.round(255 * Number(opacity)).toString(16).padStart(2, "0") : hex;
}

// A copy in which every "@name" is a colour and "@heat" a scale.
function painted(value) {
  if (typeof value === "string") {
    if (value === "@heat") return [[0, ink("heat-0")], [0.5, ink("heat-1")], [1, ink("heat-2")]];
    return /^@[a-z]/.test(value) ? coloured(value) : value;
  }
  if (Array.isArray(value)) return value.map(painted);
  if (value && typeof value === "object" && !ArrayBuffer.isView(value)) {
    return Object.fromEntries(Object.entries(value).map(([key, item]) => [key, painted(item)]));
  }
  return value;
}

function frame(height) {
  const axis = {gridcolor: "@grid", linecolor: "@rule", zerolinecolor: "@rule", tickcolor: "@rule", automargin: true,
    title: {standoff: 6}};
  return {
    height, autosize: true, paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
    font: {family: getComputedStyle(document.body).fontFamily, size: 12, color: "@ink"},
    margin: {l: 56, r: 16, t: 34, b: 44}, hoverlabel: {bgcolor: "@raised", bordercolor: "@rule", font: {color: "@ink"}},
    legend: {orientation: "h", x: 1, xanchor: "right", y: 1, yanchor: "bottom", bgcolor: "rgba(0,0,0,0)"},
    template: {layout: {xaxis: axis, yaxis: axis}}, modebar: {color: "@note", activecolor: "@twin",
      bgcolor: "rgba(0,0,0,0)", orientation: "v"},
  };
}

const config = {displaylogo: false, responsive: true, showTips: false, showSendToCloud: false,
  displayModeBar: "hover",
  modeBarButtonsToRemove: ["select2d", "lasso2d", "autoScale2d", "zoomIn2d", "zoomOut2d"]};

// Draws or draws again; a newer drawing of the same place waits for the older one.
function plot(node, traces, layout) {
  const draw = () => Plotly.react(node, painted(traces), painted(layout), config);
  node.drawn = (node.drawn || Promise.resolve()).then(draw, draw);
  return node.drawn;
}

// ---- data --------------------------------------------------------------------------------------

function numbers(packed) {
  if (!packed) return null;
  const raw = Uint8Array.from(atob(packed.bdata), c => c.charCodeAt(0));
  return packed.dtype === "f8" ? new Float64Array(raw.buffer) : new Float32Array(raw.buffer);
}

function element(tag, parent, text, attributes) {
  const made = document.createElement(tag);
  if (text) made.textContent = text;
  Object.assign(made, attributes || {});
  return parent.appendChild(made);
}

const nearest = (times, t) => {
  let best = 0;
  for (let i = 1; i < times.length; i++) if (Math.abs(times[i] - t) < Math.abs(times[best] - t)) best = i;
  return best;
};

// ---- charts ------------------------------------------------------------------------------------

function chart(node, data) {
  plots.push({draw: () => plot(node, data.traces, {...frame(data.height), ...data.layout})});
}

// ---- the explorer ------------------------------------------------------------------------------

class Explorer {
  constructor(node, data) {
    this.node = node;
    this.data = data;
    this.run = 0;
    this.moment = -1;
    this.errors = false;
    this.span = null;  // seconds shown
    this.at = null;  // second marked
    for (const run of data.runs) this.unpack(run);
    this.comparable = data.comparable;
    this.build();
  }

  unpack(run) {
    const clocks = run.clocks.map(numbers);
    for (const panel of run.panels) {
      for (const line of panel.lines) {
        line.t = clocks[line.clock];
        line.y = numbers(line.value);
        line.band = numbers(line.spread);
      }
    }
    if (run.route) for (const key of ["t", "x", "y", "level"]) run.route[key] = numbers(run.route[key]);
  }

  build() {
    const tools = element("div", this.node, "", {className: "tools"});
    this.choice = element("select", tools, "", {title: "recording"});
    this.choice.setAttribute("aria-label", "recording");
    this.data.runs.forEach((run, i) =>
      element("option", this.choice, run.note ? `${run.name} (${run.note})` : run.name, {value: i}));
    this.choice.onchange = () => this.show(Number(this.choice.value));
    if (this.data.moments.length) {
      element("button", tools, "‹ moment", {type: "button", title: "previous moment (p)"}).onclick = () => this.step(-1);
      element("button", tools, "moment ›", {type: "button", title: "next moment (n)"}).onclick = () => this.step(1);
    }
    if (this.comparable) {
      this.toggle = element("button", tools, "errors", {type: "button", title: "signals or errors (e)"});
      this.toggle.onclick = () => this.switchErrors();
      this.toggle.setAttribute("aria-pressed", "false");
    }
    element("button", tools, "whole recording", {type: "button", title: "zoom out (0)"}).onclick = () => this.look(null);
    this.said = element("span", tools, "", {className: "said"});
    this.said.setAttribute("role", "status");
    const mapped = this.data.runs.some(run => run.route);
    const views = element("div", this.node, "", {className: mapped ? "views" : "views alone"});
    this.map = mapped ? element("div", views, "", {className: "map"}) : null;
    this.channels = element("div", views, "", {className: "channels"});
    plots.push({draw: () => this.draw()});
  }

  // The title of a panel in lines short enough for its height.
  heading(panel) {
    const [name, unit] = panel.title.split(" [");
    const short = name.length > 16 ? name.replace(/ (?=[^ ]*$)/, "<br>") : name;
    return unit ? `${short}<br>[${unit}` : short;
  }

  reference(panel) {
    return panel.lines.length > 1 && panel.lines.find(line => line.who === "measured");
  }

  show(run) {
    this.run = run;
    this.moment = -1;
    this.span = this.at = null;
    this.said.textContent = "";
    return this.draw();
  }

  // Moves the channels to a moment of a run; what a click on the map does.
  jump(run, time, span) {
    this.run = run;
    this.at = span ? null : time;
    this.span = span || this.around(time);
    this.choice.value = run;
    return this.draw();
  }

  // Four seconds about a time, within the current run.
  around(time) {
    const ends = this.data.runs[this.run].panels.flatMap(panel => panel.lines).flatMap(line => {
      const known = line.t.filter(Number.isFinite);
      return known.length ? [known[0], known[known.length - 1]] : [];
    });
    const low = Math.max(Math.min(...ends), Math.min(time - 2, Math.max(...ends) - 4));
    return [low, low + 4];
  }

  look(span) {
    this.span = span;
    return this.draw();
  }

  step(by) {
    const moments = this.data.moments;
    if (!moments.length) return;
    this.moment = this.moment < 0 ? (by > 0 ? 0 : moments.length - 1) : (this.moment + by + moments.length) % moments.length;
    const one = moments[this.moment];
    const room = Math.max(0.5, 0.25 * (one.end - one.start));
    this.said.textContent = `moment ${this.moment + 1} of ${moments.length}: ${one.text}`;
    this.node.scrollIntoView({block: "nearest", behavior: still ? "auto" : "smooth"});
    return this.jump(one.run, 0.5 * (one.start + one.end), [one.start - room, one.end + room]);
  }

  switchErrors() {
    if (!this.comparable) return;
    this.errors = !this.errors;
    this.toggle.setAttribute("aria-pressed", String(this.errors));
    return this.draw();
  }

  draw() {
    this.choice.value = this.run;
    const drawn = [this.drawChannels()];
    if (this.map) drawn.push(this.drawMap());
    return Promise.all(drawn);
  }

  drawChannels() {
    const run = this.data.runs[this.run], traces = [], shapes = [], named = new Set();
    const count = run.panels.length, gap = count > 1 ? 0.022 : 0;
    const height = (1 - gap * (count - 1)) / Math.max(count, 1);
    const layout = {...frame(70 + (printing ? 80 : 124) * Math.max(count, 1)), shapes, hovermode: "x", hoversubplots: "axis",
      dragmode: "zoom", uirevision: "channels"};
    layout.xaxis = {title: {text: "time [s]"}, anchor: count > 1 ? `y${count}` : "y", showspikes: true,
      spikemode: "across", spikethickness: 1, spikecolor: "@note", spikedash: "dot", hoverformat: ".2f"};
    if (this.span) layout.xaxis.range = this.span; else layout.xaxis.autorange = true;
    run.panels.forEach((panel, i) => {
      const top = 1 - i * (height + gap), mark = i ? String(i + 1) : "";
      const reference = this.errors && this.reference(panel);
      layout[`yaxis${mark}`] = {domain: [Math.max(0, top - height), top], autorange: true,
        title: {text: (reference ? "error of<br>" : "") + this.heading(panel), font: {size: 10.5}}};
      for (const line of panel.lines) this.addLine(traces, named, line, reference, mark);
      if (reference && panel.noise > 0) {
        shapes.push({type: "rect", xref: "paper", x0: 0, x1: 1, yref: `y${mark}`, y0: -panel.noise, y1: panel.noise,
          fillcolor: "@noise", opacity: 0.7, line: {width: 0}, layer: "below"});
      }
    });
    for (const [from, to] of run.shaded) {
      shapes.push({type: "rect", yref: "paper", y0: 0, y1: 1, x0: from, x1: to, fillcolor: "@evidence", opacity: 0.4,
        line: {width: 0}, layer: "below"});
    }
    if (this.at !== null) {
      shapes.push({type: "line", yref: "paper", y0: 0, y1: 1, x0: this.at, x1: this.at,
        line: {color: "@bad", width: 1.5}});
    }
    return plot(this.channels, traces, layout).then(() => this.listen());
  }

  addLine(traces, named, line, reference, mark) {
    if (reference === line) return;
    const same = reference && reference.t === line.t;
    if (reference && !same) return;
    const value = same ? line.y.map((y, i) => y - reference.y[i]) : line.y;
    const measured = line.who === "measured";
    const trace = {type: "scatter", x: line.t, y: value, xaxis: "x", yaxis: `y${mark}`, name: line.label,
      legendgroup: line.label, showlegend: !named.has(line.label), mode: line.dots ? "markers" : "lines",
      hovertemplate: `%{y:.4g}<extra>${line.label}</extra>`};
    if (line.dots) trace.marker = {color: `@${line.who}`, size: 3, opacity: 0.6};
    else trace.line = {color: `@${line.who}`, width: measured ? 1.1 : 1.6};
    if (line.band && !reference) this.addBand(traces, line, mark);
    named.add(line.label);
    traces.push(trace);
  }

  addBand(traces, line, mark) {
    const known = Array.from(line.t.keys()).filter(i => Number.isFinite(line.y[i] + line.band[i]));
    const back = [...known].reverse();
    traces.push({type: "scatter", mode: "lines", fill: "toself", fillcolor: `@${line.who}/0.22`, line: {width: 0},
      x: [...known, ...back].map(i => line.t[i]), hoverinfo: "skip", showlegend: false, legendgroup: line.label,
      y: [...known.map(i => line.y[i] + line.band[i]), ...back.map(i => line.y[i] - line.band[i])],
      xaxis: "x", yaxis: `y${mark}`});
  }

  listen() {
    if (this.listening) return;
    this.listening = true;
    this.channels.on("plotly_relayout", change => {
      if (change["xaxis.autorange"]) this.span = null;
      if (change["xaxis.range[0]"] !== undefined) this.span = [change["xaxis.range[0]"], change["xaxis.range[1]"]];
    });
    this.channels.on("plotly_hover", event => {
      if (!this.map || !event.points.length || this.waiting) return;
      this.waiting = requestAnimationFrame(() => {
        this.waiting = 0;
        this.mark(event.points[0].x);
      });
    });
  }

  // Shows on the map where the car was at a time of the current run.
  mark(time) {
    const route = this.data.runs[this.run].route;
    if (!route) return;
    const i = nearest(route.t, time);
    Plotly.restyle(this.map, {x: [[route.x[i]]], y: [[route.y[i]]]}, [this.map.data.length - 1]);
  }

  drawMap() {
    const {runs, level, guides} = this.data, traces = [];
    const tops = runs.flatMap(run => run.route && run.route.level ? Array.from(run.route.level).filter(Number.isFinite) : []);
    tops.sort((a, b) => a - b);
    const top = tops.length ? Math.max(tops[Math.floor(0.98 * (tops.length - 1))], 1e-9) : 1;
    for (const guide of guides) {
      traces.push({type: "scatter", mode: "lines", x: numbers(guide.x), y: numbers(guide.y), name: guide.name,
        line: {color: "@note", width: 1.2, dash: "dash"}, hoverinfo: "skip"});
    }
    const order = runs.map((_, i) => i).filter(i => runs[i].route && i !== this.run);
    if (runs[this.run].route) order.push(this.run);
    for (const i of order) traces.push(this.spots(runs[i], i, i === this.run, level, top));
    const at = this.at === null || !runs[this.run].route ? null : nearest(runs[this.run].route.t, this.at);
    const here = at === null ? [[null], [null]] : [[runs[this.run].route.x[at]], [runs[this.run].route.y[at]]];
    traces.push({type: "scatter", mode: "markers", x: here[0], y: here[1], hoverinfo: "skip", showlegend: false,
      marker: {size: 15, color: "rgba(0,0,0,0)", line: {color: "@ink", width: 2.5}}});
    const layout = {...frame(Math.min(560, 120 + 0.9 * (this.map.clientWidth || 400))), hovermode: "closest",
      showlegend: false, dragmode: "pan", uirevision: "map", xaxis: {title: {text: "x [m]"}},
      yaxis: {title: {text: "y [m]"}, scaleanchor: "x", scaleratio: 1}};
    return plot(this.map, traces, layout).then(() => {
      if (this.clicking) return;
      this.clicking = true;
      this.map.on("plotly_click", event => {
        const [run, time] = event.points[0].customdata || [];
        if (run === undefined) return;
        this.moment = -1;
        this.said.textContent = `${runs[run].name}, ${time.toFixed(1)} s`;
        this.jump(run, time);
      });
    });
  }

  spots(run, i, current, level, top) {
    const route = run.route, sorted = Array.from(route.t.keys()).filter(k => Number.isFinite(route.x[k]));
    if (route.level) sorted.sort((a, b) => route.level[a] - route.level[b]);
    const pick = values => sorted.map(k => values[k]);
    const marker = {size: current ? 7 : 4, opacity: current ? 1 : 0.45, color: "@twin"};
    if (route.level) {
      Object.assign(marker, {color: pick(route.level), colorscale: "@heat", cmin: 0, cmax: top, showscale: current});
      marker.colorbar = {title: {text: level, side: "right"}, thickness: 10, len: 0.8, outlinewidth: 0};
    }
    return {type: "scatter", mode: "markers", x: pick(route.x), y: pick(route.y), marker, name: run.name,
      customdata: sorted.map(k => [i, route.t[k]]), showlegend: false,
      hovertemplate: `${run.name}, %{customdata[1]:.1f} s` + (route.level ? "<br>%{marker.color:.3g} " + level : "") +
        "<extra></extra>"};
  }
}

// ---- the page ----------------------------------------------------------------------------------

function drawAll() {
  return Promise.all(plots.map(one => one.draw()));
}

function setTheme(name) {
  root.dataset.theme = name;
  return drawAll();
}

function isDark() {
  return root.dataset.theme ? root.dataset.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
}

// The one of some elements that is nearest to the middle of the window.
function inView(elements) {
  const middle = innerHeight / 2;
  const far = one => {
    const box = one.getBoundingClientRect();
    return box.top > middle ? box.top - middle : Math.max(0, middle - box.bottom);
  };
  return [...elements].sort((a, b) => far(a) - far(b))[0];
}

function turnPage(by) {
  const parts = [...document.querySelectorAll("main section")];
  const tops = parts.map(part => part.getBoundingClientRect().top);
  const next = by > 0 ? tops.findIndex(top => top > 20) : tops.findLastIndex(top => top < -20);
  const goal = next < 0 ? (by > 0 ? parts[parts.length - 1] : document.body) : parts[next];
  goal.scrollIntoView({behavior: still ? "auto" : "smooth"});
}

function explorer() {
  const node = inView(explorers.map(one => one.node));
  return explorers.find(one => one.node === node);
}

const keys = {
  j: () => turnPage(1),
  k: () => turnPage(-1),
  n: () => explorer()?.step(1),
  p: () => explorer()?.step(-1),
  e: () => explorer()?.switchErrors(),
  0: () => explorer()?.look(null),
  t: () => setTheme(isDark() ? "light" : "dark"),
  f: () => {
    const film = inView(document.querySelectorAll("video"));
    if (film) film.paused ? film.play() : film.pause();
  },
};

document.addEventListener("keydown", event => {
  if (event.ctrlKey || event.metaKey || event.altKey || /^(INPUT|SELECT|TEXTAREA)$/.test(event.target.tagName)) return;
  if (keys[event.key]) {
    event.preventDefault();
    keys[event.key]();
  }
});
document.getElementById("theme").onclick = keys.t;
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawAll);

let before = null;
addEventListener("beforeprint", () => {
  before = {theme: root.dataset.theme, open: [...document.querySelectorAll("details:not([open])")]};
  root.dataset.theme = "light";
  printing = true;
  for (const one of before.open) one.open = true;
  for (const one of plots) one.draw();
  document.querySelectorAll(".js-plotly-plot").forEach(one => Plotly.Plots.resize(one));
});
addEventListener("afterprint", () => {
  if (!before) return;
  if (before.theme) root.dataset.theme = before.theme; else delete root.dataset.theme;
  for (const one of before.open) one.open = false;
  before = null;
  printing = false;
  drawAll();
});

document.querySelectorAll("figure .plot").forEach(node => {
  const data = JSON.parse(node.nextElementSibling.textContent);
  if (data.kind === "chart") chart(node, data);
  else explorers.push(new Explorer(node, data));
});
window.reportReady = drawAll().then(() => true);  // what a test waits for
window.reportExplorers = explorers;
})();
