/* The values under the pointer, and zoom, for the plots of a report.

   The page is complete without this script. A plot names its panels in `data-panels` (box, limits
   and scale of the axes, columns of the curves); the values are those of the CSV below it.
   Lengths are in units of the drawing. */
"use strict";
(() => {
  const NEAR = 12;          // other curves are read off this close to the nearest sample
  const DRAG = 8;           // a shorter drag is a click, or zooms one axis alone
  const DEEPEST = 1e-3;     // smallest part of an axis that fills the panel
  const TICKS = 5;          // at most so many spaces between ticks
  const MANTISSAS = [[1], [1, 2, 5], [1, 2, 3, 4, 5, 6, 7, 8, 9]];

  const make = (parent, name, attributes) => {
    const made = parent.appendChild(document.createElementNS(parent.namespaceURI, name));
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    return made;
  };
  const rounded = length => +length.toFixed(2);
  const signed = text => text.replaceAll("-", "−");

  /** Columns of a CSV text, blank cells as "". */
  const columns = text => {
    const rows = text.trimEnd().split("\n").map(line =>
      [...`,${line}`.matchAll(/,("(?:[^"]|"")*"|[^,]*)/g)].map(
        found => found[1].replace(/^"|"$/g, "").replaceAll('""', '"')));
    return rows[0].map((_, column) => rows.map(row => row[column]));
  };

  /** An axis: `part` is where a value lies on the whole axis, from 0 to 1, and `shown` where that
      part is drawn as the axis is zoomed. */
  class Axis {
    constructor({limits, scale, words}, start, length) {
      this.words = words;
      this.key = JSON.stringify([limits, scale]);
      this.log = scale === "log";
      [this.low, this.high] = limits.map(limit => this.log ? Math.log10(limit) : limit);
      [this.start, this.length] = [start, length];
      this.view = [0, 1];
    }
    part(cell) {
      const value = cell === "" ? NaN : +(this.words?.[cell] ?? cell);
      return ((this.log ? Math.log10(value) : value) - this.low) / (this.high - this.low);
    }
    shown(part) {
      const [from, to] = this.view;
      return this.start + this.length * (part - from) / (to - from);
    }
    moved(length) { return this.shown((length - this.start) / this.length); }
    partAt(length) {
      const [from, to] = this.view;
      return from + (to - from) * (length - this.start) / this.length;
    }
    inside(part) { return part >= this.view[0] - 1e-9 && part <= this.view[1] + 1e-9; }
    get whole() { return this.view[0] === 0 && this.view[1] === 1; }
    get ends() { return this.view.map(part => this.low + part * (this.high - this.low)); }

    zoom(from, to) {
      if (this.words || to - from < DEEPEST) return;
      this.view = [Math.max(0, from), Math.min(1, to)];
    }
    /** Values and texts of the ticks in view. */
    ticks() {
      let [low, high] = this.ends;
      if (this.log) {
        for (const mantissas of MANTISSAS) {
          const found = [];
          for (let decade = Math.floor(low); decade <= high; decade++)
            found.push(...mantissas.map(each => each * 10 ** decade));
          const seen = found.filter(each => Math.log10(each) >= low && Math.log10(each) <= high);
          if (seen.length > 2)
            return seen.map(each => [each, signed(String(+each.toPrecision(8)))]);
        }
        [low, high] = [10 ** low, 10 ** high];
      }
      const least = (high - low) / TICKS, power = 10 ** Math.floor(Math.log10(least));
      const step = power * [1, 2, 5, 10].find(each => each * power >= least);
      const decimals = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
      const found = [];
      for (let count = Math.ceil(low / step); count * step <= high; count++)
        found.push([count * step, signed((count * step).toFixed(decimals))]);
      return found;
    }
  }

  class Curve {
    constructor([id, x, y], table, panel) {
      this.drawn = document.getElementById(id);
      this.order = y;
      this.cells = {x: table[x].slice(1), y: table[y].slice(1)};
      this.across = table[x][0];
      this.up = table[y][0];
      this.points = this.cells.x.map(
        (cell, i) => [panel.x.part(cell), panel.y.part(this.cells.y[i])]);
      this.seen = this.points.map((_, i) => i).filter(i => this.points[i].every(Number.isFinite));
      this.runs = this.seen.length > 1 && this.seen.every(
        (i, place) => !place || this.points[i][0] >= this.points[this.seen[place - 1]][0]);
    }
    get path() { return this.drawn?.querySelector(":scope > path"); }
    get colour() {
      const mark = this.drawn?.querySelector("path, use");
      return mark ? getComputedStyle(mark).stroke : "currentColor";
    }
  }

  class Panel {
    constructor({id, box: [left, top, width, height], x, y, curves}, table) {
      this.group = document.getElementById(id);
      this.box = [left, top, width, height];
      this.x = new Axis(x, left, width);
      this.y = new Axis(y, top + height, -height);
      this.curves = curves.map(each => new Curve(each, table, this)).filter(c => c.seen.length);
      this.runs = this.curves.every(curve => curve.runs);
      this.shapes = null;
    }
    holds([x, y]) {
      const [left, top, width, height] = this.box;
      return x >= left - 4 && x <= left + width + 4 && y >= top - 4 && y <= top + height + 4;
    }
    place(curve, i) {
      const [x, y] = curve.points[i];
      return [this.x.shown(x), this.y.shown(y)];
    }
    /** Sample of each curve nearest to a point: along the abscissa where every curve runs along
        it, else in the plane, and then of one curve. The nearest of all comes first. */
    nearest([x, y]) {
      const found = [];
      for (const curve of this.curves) {
        let best = null;
        for (const i of curve.seen) {
          if (!this.x.inside(curve.points[i][0])) continue;
          const [across, up] = this.place(curve, i);
          const far = this.runs ? Math.abs(across - x) + 1e-3 * Math.abs(up - y)
            : Math.hypot(across - x, up - y);
          if (!best || far < best.far) best = {curve, i, far, across};
        }
        if (best) found.push(best);
      }
      const first = found.reduce((a, b) => b.far < a.far ? b : a, found[0]);
      const others = found.filter(each => each !== first && this.runs
                                  && Math.abs(each.across - first.across) < NEAR);
      return first ? [first, ...others] : [];
    }

    /** Draw the panel as its axes are zoomed. Lines are drawn from their samples, since their
        paths leave out what the whole plot cannot show. */
    draw() {
      this.shapes ??= this.collect();
      for (const shape of this.shapes) shape();
      for (const axis of ["x", "y"]) this.drawTicks(axis);
    }
    /** What there is to move: lines and markers, bands and bars. The grid follows the ticks. */
    collect() {
      const lines = new Map(this.curves.map(curve => [curve.path, curve]));
      const moved = (d, [dx, dy] = [0, 0]) => d.replace(/(-?[\d.]+) (-?[\d.]+)/g, (_, x, y) => [
        this.x.moved(+x + dx) - dx, this.y.moved(+y + dy) - dy].map(rounded).join(" "));
      const parts = [...this.group.querySelectorAll("path[clip-path][d], [clip-path] use")];
      return parts.filter(part => !part.closest("[id$='-x'], [id$='-y']")).map(part => {
        const [d, ...at] = ["d", "x", "y"].map(name => part.getAttribute(name));
        if (lines.has(part))
          return () => part.setAttribute("d", this.zoomed ? this.line(lines.get(part)) : d);
        if (part.localName === "path") return () => part.setAttribute("d", moved(d));
        const drawn = document.getElementById(part.getAttribute("href").slice(1));
        const whole = drawn.getAttribute("d");
        return part.closest("[id*='Collection']")       // a band: a path of its own, set off
          ? () => drawn.setAttribute("d", moved(whole, at.map(Number)))
          : () => ["x", "y"].forEach((name, i) =>
              part.setAttribute(name, rounded(this[name].moved(+at[i]))));
      });
    }
    line(curve) {
      let pen = "M";
      return curve.points.map((point, i) => {
        const drawn = point.every(Number.isFinite)
          ? pen + this.place(curve, i).map(rounded).join(" ") : "";
        pen = drawn ? "L" : "M";
        return drawn;
      }).join("");
    }
    get zoomed() { return !this.x.whole || !this.y.whole; }

    drawTicks(name) {
      const axis = this[name], group = document.getElementById(`${this.group.id}-${name}`);
      for (const old of group.querySelectorAll(".zoomed")) old.remove();
      const ticks = [...group.children].filter(each => each.querySelector("use"));
      for (const tick of ticks) tick.style.display = axis.whole ? "" : "none";
      if (axis.whole) return;
      const model = ticks.find(each => each.querySelector("text")) ?? ticks[0];
      for (const [value, text] of model ? axis.ticks() : []) {
        const tick = group.appendChild(model.cloneNode(true));
        const by = axis.shown(axis.part(value)) - model.querySelector("use").getAttribute(name);
        tick.setAttribute("class", "zoomed");
        tick.setAttribute("transform", `translate(${name === "x" ? `${by},0` : `0,${by}`})`);
        tick.style.display = "";
        for (const each of tick.querySelectorAll("defs")) each.remove();
        for (const each of [tick, ...tick.querySelectorAll("[id]")]) each.removeAttribute("id");
        for (const each of tick.querySelectorAll("path")) each.removeAttribute("clip-path");
        for (const each of tick.querySelectorAll("text")) each.textContent = text;
      }
    }
  }

  class Plot {
    constructor(frame) {
      this.frame = frame;
      this.svg = frame.querySelector("svg");
      this.size = this.svg.viewBox.baseVal;
      const href = frame.closest("figure").querySelector("a.csv").href;
      const table = columns(decodeURIComponent(href.slice(href.indexOf(",") + 1)));
      this.panels = JSON.parse(this.svg.dataset.panels).map(each => new Panel(each, table));
      this.readout = frame.appendChild(document.createElement("output"));
      this.readout.className = "readout";
      this.cross = make(this.svg, "g", {class: "cross"});
      this.frame.addEventListener("pointermove", event => this.move(event));
      this.frame.addEventListener("pointerleave", event => {
        if (!this.from && event.pointerType === "mouse") this.leave();
      });
      this.frame.addEventListener("pointerdown", event => this.press(event));
      this.frame.addEventListener("dblclick", () => this.reset());
      this.frame.addEventListener("keydown", event => this.key(event));
      window.addEventListener("pointerup", event => this.release(event));
      window.addEventListener("pointercancel", () => { this.from = null; this.leave(); });
    }
    point(event) {
      const box = this.svg.getBoundingClientRect(), scale = this.size.width / box.width;
      return [(event.clientX - box.left) * scale, (event.clientY - box.top) * scale];
    }
    move(event) {
      const point = this.point(event);
      if (this.from) return this.select(point);
      const panel = this.panels.find(each => each.holds(point));
      const found = panel?.nearest(point) ?? [];
      if (found.length) this.show(panel, found); else this.leave();
    }
    leave() {
      this.readout.replaceChildren();
      this.cross.replaceChildren();
      this.read = null;
    }

    show(panel, found) {
      this.leave();
      this.read = {panel, ...found[0]};
      const [left, top, , height] = panel.box;
      const [x] = panel.place(found[0].curve, found[0].i);
      make(this.cross, "line", {x1: x, x2: x, y1: top, y2: top + height});
      this.say(found[0].curve.across, found[0].curve.cells.x[found[0].i]);
      for (const {curve, i} of found.sort((a, b) => a.curve.order - b.curve.order)) {
        const [cx, cy] = panel.place(curve, i);
        if (panel.y.inside(curve.points[i][1]))
          make(this.cross, "circle", {cx, cy, r: 3.2, stroke: curve.colour});
        this.say(curve.up, curve.cells.y[i], curve.colour);
      }
      this.say(panel.zoomed ? "double click: all" : "drag: zoom", "");
      const right = x > this.size.width / 2;
      Object.assign(this.readout.style, {
        left: right ? "auto" : `calc(${100 * x / this.size.width}% + .6rem)`,
        right: right ? `calc(${100 - 100 * x / this.size.width}% + .6rem)` : "auto",
        top: `${100 * top / this.size.height}%`});
    }
    /** A line of the readout: "curve, axis (unit)" and a cell as "curve 1.23 unit". */
    say(name, cell, colour) {
      const line = this.readout.appendChild(document.createElement("div"));
      const [, label, unit] = name.match(/^(.*?)\s*(?:\(([^()]*)\))?$/);
      if (colour) line.appendChild(document.createElement("i")).style.background = colour;
      const value = Number.isNaN(+cell) ? cell : signed(cell);
      line.append(label.replace(/, [^,]*$/, ""), label && value ? " " : "");
      if (value) line.appendChild(document.createElement("b")).textContent =
        unit ? `${value}\u00a0${unit}` : value;
    }

    press(event) {
      const point = this.point(event);
      if (event.button || !this.panels.some(each => each.holds(point))) return;
      this.from = point;
    }
    /** Panel, corners and zoomed axes of the rectangle dragged so far. */
    dragged([x, y]) {
      const panel = this.panels.find(each => each.holds(this.from));
      const [left, top, width, height] = panel.box;
      const within = (value, low, length) => Math.min(Math.max(value, low), low + length);
      const [xs, ys] = [[this.from[0], x].map(each => within(each, left, width)),
                        [this.from[1], y].map(each => within(each, top, height))];
      const wide = Math.abs(xs[1] - xs[0]) > DRAG && !panel.x.words;
      const high = Math.abs(ys[1] - ys[0]) > (wide ? 3 * DRAG : DRAG) && !panel.y.words;
      return {panel, xs: wide && xs.sort((a, b) => a - b), ys: high && ys.sort((a, b) => b - a)};
    }
    select(point) {
      this.leave();
      const {panel: {box: [left, top, width, height]}, xs, ys} = this.dragged(point);
      if (xs || ys) make(this.cross, "rect", {
        x: xs ? xs[0] : left, width: xs ? xs[1] - xs[0] : width,
        y: ys ? ys[1] : top, height: ys ? ys[0] - ys[1] : height});
    }
    release(event) {
      if (!this.from) return;
      const {panel, xs, ys} = this.dragged(this.point(event));
      this.from = null;
      this.zoom(panel, xs && xs.map(each => panel.x.partAt(each)),
                ys && ys.map(each => panel.y.partAt(each)));
      this.move(event);
    }
    /** Show parts of the axes; panels above one another over the same abscissa go together. */
    zoom(panel, xs, ys) {
      if (!xs && !ys) return;
      if (xs) for (const each of this.panels) if (each.x.key === panel.x.key) each.x.zoom(...xs);
      if (ys) panel.y.zoom(...ys);
      for (const each of this.panels) each.draw();
    }
    reset() {
      for (const panel of this.panels) {
        panel.x.view = [0, 1];
        panel.y.view = [0, 1];
        panel.draw();
      }
      this.leave();
    }

    /** Arrows walk along the samples and from panel to panel; Escape shows all. */
    key(event) {
      const panels = this.panels.filter(each => each.curves.length);
      let {panel = panels[0], curve = panel?.curves[0], i} = this.read ?? {};
      if (!panel || event.ctrlKey || event.altKey || event.metaKey) return;
      const along = {ArrowLeft: -1, ArrowRight: 1}[event.key];
      const down = {ArrowUp: -1, ArrowDown: 1}[event.key];
      if (event.key === "Escape") this.reset();
      if (!along && !down) return;
      event.preventDefault();
      if (down) {
        panel = panels[Math.min(Math.max(panels.indexOf(panel) + down, 0), panels.length - 1)];
        [curve, i] = [panel.curves[0]];
      }
      const seen = curve.seen.filter(each => panel.x.inside(curve.points[each][0]));
      const next = i === undefined ? seen.length >> 1 : seen.indexOf(i) + along;
      i = seen[Math.min(Math.max(next, 0), seen.length - 1)];
      if (i !== undefined) this.show(panel, panel.nearest(panel.place(curve, i)));
    }
  }

  for (const frame of document.querySelectorAll(".plot")) {
    const svg = frame.querySelector("svg[data-panels]");
    if (!svg) continue;
    frame.classList.add("live");
    svg.setAttribute("tabindex", "0");
    let plot = null;        // the values are read when somebody looks at the plot
    const begin = event => {
      if (plot) return;
      plot = new Plot(frame);
      if (event.type === "pointermove") plot.move(event);
    };
    frame.addEventListener("pointermove", begin);
    frame.addEventListener("pointerdown", begin, {capture: true});
    svg.addEventListener("focus", begin);
  }
})();
