"use strict";
(() => {
  const NS = "http://www.w3.org/2000/svg";
  const DEEPEST = 500; // times the whole range

  // ---- scales: value = low + share * (high - low), by decades where the axis is logarithmic
  const scaleOf = (text) => {
    const [low, high, start, end, kind] = text.split("|");
    return { low: +low, high: +high, start: +start, end: +end, log: kind === "log" };
  };
  const value = ({ low, high, start, end, log }, at) => {
    const share = end === start ? 0 : (at - start) / (end - start);
    return log ? low * Math.pow(high / low, share) : low + share * (high - low);
  };
  const place = ({ low, high, start, end }, number) =>
    start + ((number - low) / (high - low)) * (end - start);
  const signed = (text) => text.replace("-", "\u2212");
  const text = (number) => signed(String(Number(number.toPrecision(4))));
  const ticks = (low, high, count) => {
    const raw = (high - low) / count, power = 10 ** Math.floor(Math.log10(raw));
    const step = [1, 2, 5, 10].map((k) => k * power).find((size) => size >= raw * (1 - 1e-9));
    const decimals = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
    const found = [];
    for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++)
      found.push([k * step, decimals > 6 ? text(k * step) : signed((k * step).toFixed(decimals))]);
    return found;
  };

  // ---- one pair of axes; its marks lie in a drawing of their own, whose view is what is zoomed
  class Panel {
    constructor(element) {
      const [name, unit, ...scale] = element.dataset.x.split("|");
      Object.assign(this, { name, unit, x: scaleOf(scale.join("|")), y: scaleOf(element.dataset.y) });
      this.marks = element.querySelector(".marks");
      this.axes = ["x", "y"].map((axis) => {
        const group = element.querySelector(".ticks-" + axis);
        return { axis, group, whole: Array.from(group.childNodes) };
      });
    }
    show(from, to) {
      const whole = from <= this.x.start && to >= this.x.end;
      const [top, bottom] = whole || this.y.log ? [this.y.end, this.y.start] : this.reach(from, to);
      this.marks.setAttribute("viewBox", [from, top, to - from, bottom - top].join(" "));
      this.label(this.axes[0], this.x, from, to, whole);
      this.label(this.axes[1], this.y, bottom, top, whole || this.y.log);
    }
    reach(from, to) { // of what is drawn between two places
      let top = Infinity, bottom = -Infinity;
      for (const shape of this.marks.querySelectorAll("polyline, polygon"))
        for (const { x, y } of shape.points)
          if (x >= from && x <= to) [top, bottom] = [Math.min(top, y), Math.max(bottom, y)];
      if (!(bottom >= top)) return [this.y.end, this.y.start];
      const room = Math.max(0.06 * (bottom - top), 0.01);
      return [top - room, bottom + room];
    }
    label({ axis, group, whole }, scale, first, last, unzoomed) {
      group.replaceChildren(...whole);
      const samples = ["line", "text"].map((name) => group.querySelector(name));
      if (unzoomed || !samples[0]) return;
      const count = group.querySelectorAll("line").length + 1;
      const view = { low: value(scale, first), high: value(scale, last), start: scale.start, end: scale.end };
      group.replaceChildren();
      for (const [number, written] of ticks(view.low, view.high, count)) {
        const at = place(view, number);
        for (const sample of samples.filter(Boolean)) {
          const mark = sample.cloneNode();
          const moved = mark.tagName === "text" ? [axis] : [axis + "1", axis + "2"];
          for (const key of moved) mark.setAttribute(key, axis === "y" && key === "y" ? at + 4 : at);
          if (mark.tagName === "text") mark.textContent = written;
          group.append(mark);
        }
      }
    }
    read(at, reach) {
      return Array.from(this.marks.querySelectorAll("[data-name]"), (line) => {
        const point = nearest(line.points, at);
        const shown = text(value(this.y, point.y)) + "\u2009" + line.dataset.unit;
        return { name: line.dataset.name, off: Math.abs(point.x - at), shown };
      }).filter((item) => item.off <= reach);
    }
  }
  const nearest = (points, x) => {
    let low = 0, high = points.numberOfItems - 1;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (points.getItem(middle).x <= x) low = middle; else high = middle;
    }
    const a = points.getItem(low), b = points.getItem(high);
    return Math.abs(a.x - x) <= Math.abs(b.x - x) ? a : b;
  };

  // ---- panels one above the other: one cursor, one zoom. `at` and `view` are places unzoomed
  class Column {
    constructor(svg, panels) {
      const { start, end } = panels[0].x;
      Object.assign(this, { svg, panels, start, end, view: [start, end], at: (start + end) / 2 });
      this.top = Math.min(...panels.map((panel) => panel.y.end));
      this.bottom = Math.max(...panels.map((panel) => panel.y.start));
      this.output = svg.closest("figure").querySelector("output");
    }
    get share() { return (this.view[1] - this.view[0]) / (this.end - this.start); }
    unzoomed(x) { return this.view[0] + (x - this.start) * this.share; }
    look(from, to) {
      const all = this.end - this.start;
      const width = Math.min(Math.max(to - from, all / DEEPEST), all);
      const first = Math.min(Math.max((from + to - width) / 2, this.start), this.end - width);
      this.view = [first, first + width];
      for (const panel of this.panels) panel.show(...this.view);
      this.svg.classList.toggle("zoomed", this.share < 1);
    }
    zoom(factor, about = this.at) {
      const [from, to] = this.view;
      this.look(about + (from - about) * factor, about + (to - about) * factor);
    }
    pan(by) { this.look(this.view[0] + by, this.view[1] + by); }
    point(at) {
      this.at = Math.min(Math.max(at, this.start), this.end);
      const width = this.view[1] - this.view[0];
      if (this.at < this.view[0]) this.look(this.at, this.at + width);
      if (this.at > this.view[1]) this.look(this.at - width, this.at);
      const x = this.start + (this.at - this.view[0]) / this.share;
      this.cursor ??= document.createElementNS(NS, "line");
      const corners = { class: "cursor", x1: x, x2: x, y1: this.top, y2: this.bottom };
      for (const [key, item] of Object.entries(corners)) this.cursor.setAttribute(key, item);
      this.svg.append(this.cursor);
      const found = new Map();
      for (const panel of this.panels)
        for (const item of panel.read(this.at, 12 * this.share))
          if (!(found.get(item.name)?.off <= item.off)) found.set(item.name, item);
      const { name, unit, x: scale } = this.panels[0];
      const head = name + " = " + text(value(scale, this.at)) + "\u2009" + unit;
      const values = Array.from(found.values(), (item) => item.name + " " + item.shown);
      this.output.textContent = [head, ...values].join("  \u00b7  ");
    }
    hide() {
      this.cursor?.remove();
      this.output.textContent = "";
    }
    frame(a, b) { // what the pointer is about to choose
      this.chosen?.remove();
      if (a === null) return;
      this.chosen = document.createElementNS(NS, "rect");
      const corners = { class: "chosen", x: Math.min(a, b), width: Math.abs(b - a), y: this.top, height: this.bottom - this.top };
      for (const [key, item] of Object.entries(corners)) this.chosen.setAttribute(key, item);
      this.svg.append(this.chosen);
    }
  }

  // ---- pointer: drag chooses, with Shift or a finger it pans; keys; buttons
  const KEYS = {
    ArrowLeft: (column, step) => column.point(column.at - step),
    ArrowRight: (column, step) => column.point(column.at + step),
    Home: (column) => column.point(column.start),
    End: (column) => column.point(column.end),
    "+": (column) => column.zoom(0.5),
    "=": (column) => column.zoom(0.5),
    "-": (column) => column.zoom(2),
    0: (column) => column.look(column.start, column.end),
  };
  const listen = (svg) => {
    const panels = Array.from(svg.querySelectorAll(".panel[data-x]"), (item) => new Panel(item));
    const starts = Array.from(new Set(panels.map((panel) => panel.x.start)));
    const columns = starts.map((at) => new Column(svg, panels.filter((panel) => panel.x.start === at)));
    let active = columns[0], drag = null;
    const where = (event) =>
      new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse()).x;
    const under = (x) => columns.findLast((column) => column.start <= x + 12) ?? columns[0];
    svg.addEventListener("pointerdown", (event) => {
      if (event.button) return;
      const x = where(event);
      active = under(x);
      drag = { from: x, last: x, pans: event.shiftKey || event.pointerType === "touch" };
      svg.setPointerCapture(event.pointerId);
    });
    svg.addEventListener("pointermove", (event) => {
      const x = where(event);
      if (!drag && under(x) !== active) { active.hide(); active = under(x); }
      if (drag?.pans) active.pan((drag.last - x) * active.share);
      else if (drag) active.frame(...[drag.from, x].map((at) => Math.min(Math.max(at, active.start), active.end)));
      if (drag) drag.last = x;
      active.point(active.unzoomed(Math.min(Math.max(x, active.start), active.end)));
    });
    const drop = (event) => {
      if (event.type === "pointerup" && drag && !drag.pans && Math.abs(drag.last - drag.from) > 6)
        active.look(...[drag.from, drag.last].sort((a, b) => a - b).map((x) => active.unzoomed(x)));
      active.frame(null);
      drag = null;
    };
    svg.addEventListener("pointerup", drop);
    svg.addEventListener("pointercancel", drop);
    svg.addEventListener("dblclick", () => active.look(active.start, active.end));
    svg.addEventListener("wheel", (event) => {
      if (!event.ctrlKey && !event.metaKey) return; // else the page scrolls
      active.zoom(2 ** (event.deltaY / 200), active.unzoomed(where(event)));
      event.preventDefault();
    }, { passive: false });
    svg.addEventListener("pointerleave", () => { if (document.activeElement !== svg) active.hide(); });
    svg.addEventListener("focus", () => active.point(active.at));
    svg.addEventListener("blur", () => active.hide());
    svg.addEventListener("keydown", (event) => {
      if (event.key === "Escape") svg.blur();
      if (!(event.key in KEYS) || event.ctrlKey || event.metaKey || event.altKey) return;
      KEYS[event.key](active, (event.shiftKey ? 20 : 2) * active.share);
      active.point(active.at);
      event.preventDefault();
    });
    const buttons = document.createElement("span");
    buttons.className = "zoom";
    for (const [sign, key, said] of [["+", "+", "Zoom in"], ["\u2212", "-", "Zoom out"], ["\u21ba", "0", "Whole range"]]) {
      const button = document.createElement("button");
      Object.assign(button, { type: "button", textContent: sign, title: said, ariaLabel: said });
      button.addEventListener("click", () => columns.forEach((column) => KEYS[key](column)));
      buttons.append(button);
    }
    svg.closest("figure").querySelector("figcaption").append(buttons);
  };
  document.querySelectorAll("svg.readable").forEach(listen);

  // ---- the joint to look at
  // Groups about one joint, and figures about one joint in groups about several.
  const parts = Array.from(document.querySelectorAll("[data-joint]"));
  const names = Array.from(new Set(parts.map((part) => part.dataset.joint)));
  if (names.length < 2) return;
  const item = document.createElement("li"), label = document.createElement("label");
  const select = document.createElement("select");
  item.className = "choice";
  select.append(new Option("all joints", ""), ...names.map((name) => new Option(name)));
  label.append("Joint ", select);
  item.append(label);
  document.querySelector(".nav ul").append(item);
  const choose = () => {
    for (const part of parts) part.hidden = Boolean(select.value) && part.dataset.joint !== select.value;
  };
  select.addEventListener("change", choose);
  addEventListener("hashchange", () => {
    const target = document.getElementById(decodeURIComponent(location.hash.slice(1)));
    if (!target?.hidden) return;
    select.value = "";
    choose();
    target.scrollIntoView();
  });
})();
