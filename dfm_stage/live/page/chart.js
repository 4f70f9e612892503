"use strict";
// A line chart on a canvas: shared x, fixed scales, gaps where a value is null.
const ROOM = {left: 66, right: 8, top: 6, bottom: 34};

const ticksOf = (low, high, most) => {
  const rough = (high - low) / most, power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map(each => each * power).find(each => each >= rough);
  const found = [];
  for (let k = Math.ceil(low / step); k * step <= high * (1 + 1e-12); k++) found.push(k * step);
  const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  return found.map(value => [value, value.toFixed(digits).replace("-", "−")]);
};

class Chart {
  // lines: [[name, colour], ...]; ink and grid are colours.
  constructor(holder, {height, label, lines, ink, grid}) {
    Object.assign(this, {holder, height, label, lines, ink, grid});
    this.canvas = document.createElement("canvas");
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-label", `${label} over time: ${lines.map(([name]) => name).join(", ")}`);
    this.legend = document.createElement("p");
    this.legend.className = "legend";
    if (lines.length > 1) this.legend.append(...lines.map(([name, colour]) => {
      const entry = document.createElement("span");
      entry.textContent = name;
      entry.style.borderColor = colour;
      return entry;
    }));
    holder.append(this.canvas, this.legend);
    this.resize();
  }

  resize() {
    const sharp = devicePixelRatio || 1;
    this.width = this.holder.clientWidth;
    this.canvas.width = Math.round(this.width * sharp);
    this.canvas.height = Math.round(this.height * sharp);
    Object.assign(this.canvas.style, {width: `${this.width}px`, height: `${this.height}px`});
    this.pen = this.canvas.getContext("2d");
    this.pen.setTransform(sharp, 0, 0, sharp, 0, 0);
  }

  draw(x, columns, [left, right], [low, high]) {
    const {pen, width, height} = this;
    const wide = width - ROOM.left - ROOM.right, tall = height - ROOM.top - ROOM.bottom;
    const across = value => ROOM.left + wide * (value - left) / (right - left);
    const up = value => ROOM.top + tall * (high - value) / (high - low);
    pen.clearRect(0, 0, width, height);
    pen.font = "12px sans-serif";
    pen.lineWidth = 1;
    pen.strokeStyle = this.grid;
    pen.fillStyle = this.ink;
    pen.beginPath();
    pen.textAlign = "center";
    pen.textBaseline = "top";
    for (const [value, text] of ticksOf(left, right, Math.max(2, wide / 90))) {
      pen.moveTo(across(value), ROOM.top);
      pen.lineTo(across(value), ROOM.top + tall);
      pen.fillText(text, across(value), ROOM.top + tall + 4);
    }
    pen.fillText("time (s)", ROOM.left + wide / 2, ROOM.top + tall + 19);
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    for (const [value, text] of ticksOf(low, high, Math.max(2, tall / 28))) {
      pen.moveTo(ROOM.left, up(value));
      pen.lineTo(ROOM.left + wide, up(value));
      pen.fillText(text, ROOM.left - 5, up(value));
    }
    pen.stroke();
    pen.save();
    pen.translate(9, ROOM.top + tall / 2);
    pen.rotate(-Math.PI / 2);
    pen.textAlign = "center";
    pen.fillText(this.label, 0, 0);
    pen.restore();
    pen.save();
    pen.beginPath();
    pen.rect(ROOM.left, ROOM.top, wide, tall);
    pen.clip();
    pen.lineWidth = 1.3;
    pen.lineJoin = "round";
    columns.forEach((column, k) => {
      pen.strokeStyle = this.lines[k][1];
      pen.beginPath();
      let down = false;
      for (let i = 0; i < x.length; i++) {
        if (column[i] === null) { down = false; continue; }
        if (down) pen.lineTo(across(x[i]), up(column[i])); else pen.moveTo(across(x[i]), up(column[i]));
        down = true;
      }
      pen.stroke();
    });
    pen.restore();
  }

  destroy() { this.canvas.remove(); this.legend.remove(); }
}
