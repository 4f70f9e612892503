"use strict";
// Frames come 30 times a second: {axes: {name: {rows: [[t, position, reference, V, A], ...]}}}.
const byId = id => document.getElementById(id);
const axes = new Map();
const GAP_S = 0.05;      // where nothing was heard for so long no line is drawn
let socket = null, held = false, watchOnly = false;

const PREFIXES = [[1, ""], [1e-3, "m"], [1e-6, "µ"], [1e-9, "n"]];
const scaleOf = values => {
  let most = 0;
  for (const v of values) if (v !== null && Math.abs(v) > most) most = Math.abs(v);
  return PREFIXES.find(([size]) => most >= size) || (most > 0 ? PREFIXES[3] : PREFIXES[1]);
};
const shown = (value, unit) => {
  if (value === null || value === undefined) return "–";
  const [size, prefix] = scaleOf([value]);
  return `${(value / size).toPrecision(4).replace("-", "−")} ${prefix}${unit}`;
};
const colour = name => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

const PANELS = [
  {title: "position", unit: "m", height: 210, lines: [["reference", 2, "c1"], ["position", 1, "c2"]]},
  {title: "error", unit: "m", height: 170, lines: [["reference − position", 5, "c1"]]},
  {title: "output", unit: "V", height: 150, lines: [["voltage", 3, "c1"]]},
  {title: "current", unit: "A", height: 150, lines: [["current", 4, "c3"]]},
];

class Axis {
  constructor(name) {
    this.name = name;
    this.data = [[], [], [], [], [], []];
    this.section = byId("axis").content.firstElementChild.cloneNode(true);
    this.section.querySelector("h2").textContent = name;
    for (const button of this.section.querySelectorAll("[data-do]")) {
      button.disabled = watchOnly && button.dataset.do !== "disarm";
      button.onclick = () => ask(button.dataset.do, [name]);
    }
    byId("axes").append(this.section);
    this.numbers = {};
    for (const each of ["reference", "position", "error", "output", "current", "rate"]) {
      const box = document.createElement("div"), dt = document.createElement("dt");
      this.numbers[each] = document.createElement("dd");
      dt.textContent = each;
      box.append(dt, this.numbers[each]);
      this.section.querySelector(".numbers").append(box);
    }
    this.plots = PANELS.map(panel => ({panel, plot: null, prefix: ""}));
  }

  add(said) {
    for (const [t, position, reference, volts, amperes] of said.rows) {
      const last = this.data[0].at(-1);
      if (t < last) this.data = [[], [], [], [], [], []];          // begun anew
      if (t - last > GAP_S) [t, null, null, null, null, null].forEach((v, i) => this.data[i].push(v));
      const error = reference === null ? null : reference - position;
      [t, position, reference, volts, amperes, error].forEach((v, i) => this.data[i].push(v));
    }
    const window = Number(byId("window").value), last = this.data[0].at(-1);
    let old = 0;
    while (old < this.data[0].length && this.data[0][old] < last - window) old++;
    if (old > 500 || (old && window < 3)) this.data = this.data.map(column => column.slice(old));
    const armed = this.section.querySelector(".armed");
    const [word, tone] = said.silent ? ["silent", "warn"] : said.enabled === null ? ["no amplifier", "warn"]
      : said.enabled ? ["armed", "good"] : ["disarmed", "bad"];
    armed.textContent = word;
    armed.className = `badge armed ${tone}`;
    this.section.querySelector(".faults").textContent = said.faults.join(", ");
    const now = this.data.map(column => column.length ? column.at(-1) : null);
    const texts = {reference: shown(now[2], "m"), position: shown(now[1], "m"), error: shown(now[5], "m"),
                   output: shown(now[3], "V"), current: shown(now[4], "A"),
                   rate: `${said.rate_hz.toFixed(0)} Hz${said.every > 1 ? `, 1 of ${said.every} shown` : ""}`};
    for (const [key, text] of Object.entries(texts)) this.numbers[key].textContent = text;
  }

  draw() {
    const t = this.data[0];
    if (t.length < 2) return;
    const end = t.at(-1), window = Number(byId("window").value);
    const seconds = t.map(each => each - end);
    for (const entry of this.plots) {
      const {panel} = entry;
      const columns = panel.lines.map(([, index]) => this.data[index]);
      if (!columns.some(column => column.some(v => v !== null))) continue;
      const [size, prefix] = scaleOf(columns.flat());
      if (!entry.plot || entry.prefix !== prefix) {
        entry.plot?.destroy();
        entry.holder ||= this.section.querySelector(".plots").appendChild(document.createElement("div"));
        entry.prefix = prefix;
        entry.plot = this.make(entry.holder, panel, `${panel.title} (${prefix}${panel.unit})`);
      }
      const scaled = columns.map(column => column.map(v => v === null ? null : v / size));
      let low = Infinity, high = -Infinity;
      for (const column of scaled) for (let i = 0; i < column.length; i++) {
        if (seconds[i] < -window || column[i] === null) continue;
        low = Math.min(low, column[i]); high = Math.max(high, column[i]);
      }
      if (low > high) continue;
      const room = 0.06 * (high - low) || 0.05 * Math.abs(high) || 1;
      entry.plot.draw(seconds, scaled, [-window, 0], [low - room, high + room]);
    }
  }

  make(holder, panel, label) {
    return new Chart(holder, {height: panel.height, label, ink: colour("ink"), grid: colour("grid"),
      lines: panel.lines.map(([name, , c]) => [name, colour(c)])});
  }

  resize() {
    for (const {plot} of this.plots) plot?.resize();
  }

  restyle() {
    for (const entry of this.plots) { entry.plot?.destroy(); entry.plot = null; }
  }
}

const ask = (what, names) => socket?.readyState === 1 &&
  socket.send(JSON.stringify({do: what, axes: names}));
const disarmAll = () => ask("disarm", [...axes.keys()]);

const LEVELS = [["ok", "good"], ["warning", "warn"], ["error", "bad"], ["stale", "warn"]];
let statuses = "";
const showNodes = nodes => {
  const text = JSON.stringify(nodes);
  if (text === statuses) return;
  statuses = text;
  byId("statuses").replaceChildren(...nodes.map(node => {
    const row = document.createElement("tr"), [word, tone] = LEVELS[node.level] || LEVELS[3];
    const cells = [node.name, node.message === "running" ? word : `${word}: ${node.message}`,
                   node.values.map(([key, value]) => `${key} ${value}`).join(", ")];
    row.append(...cells.map(each => Object.assign(document.createElement("td"), {textContent: each})));
    row.children[1].className = tone;
    return row;
  }));
};

let forget = 0;
const connect = () => {
  socket = new WebSocket(`ws://${location.host}/live`);
  const state = byId("state");
  socket.onopen = () => { state.textContent = "live"; state.className = "badge good"; };
  socket.onclose = () => {
    state.textContent = "not connected";
    state.className = "badge bad";
    setTimeout(connect, 1000);
  };
  socket.onmessage = ({data}) => {
    const frame = JSON.parse(data);
    if ("watch_only" in frame) { watchOnly = frame.watch_only; return; }
    if ("answer" in frame) {
      byId("answer").textContent = frame.answer;
      byId("answer").hidden = false;
      clearTimeout(forget);
      forget = setTimeout(() => { byId("answer").hidden = true; }, 8000);
      return;
    }
    for (const [name, said] of Object.entries(frame.axes)) {
      if (!axes.has(name)) { byId("none")?.remove(); axes.set(name, new Axis(name)); }
      axes.get(name).add(said);
    }
    showNodes(frame.nodes);
    dirty = true;
  };
};

let dirty = false;
const draw = () => {
  if (dirty && !held) { for (const axis of axes.values()) axis.draw(); dirty = false; }
  requestAnimationFrame(draw);
};
byId("hold").onclick = () => {
  held = !held;
  byId("hold").textContent = held ? "Go on" : "Hold";
};
byId("disarm-all").onclick = disarmAll;
addEventListener("keydown", event => { if (event.key === "Escape") disarmAll(); });
addEventListener("resize", () => { for (const axis of axes.values()) axis.resize(); });
matchMedia("(prefers-color-scheme: dark)").onchange =
  () => { for (const axis of axes.values()) axis.restyle(); dirty = true; };
connect();
draw();
