"use strict";
(() => {
  const NS = "http://www.w3.org/2000/svg";
  const value = (scale, at) => {
    const [low, high, start, end] = scale.slice(0, 4).map(Number);
    const share = end === start ? 0 : (at - start) / (end - start);
    if (scale[4] !== "log") return low + share * (high - low);
    return low * Math.pow(high / low, share);
  };
  const text = (number) => {
    const shown = Number(number.toPrecision(4));
    return String(shown).replace("-", "\u2212");
  };
  const nearest = (points, x) => {
    let low = 0, high = points.numberOfItems - 1;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (points.getItem(middle).x <= x) low = middle; else high = middle;
    }
    const a = points.getItem(low), b = points.getItem(high);
    return Math.abs(a.x - x) <= Math.abs(b.x - x) ? a : b;
  };
  const read = (svg, x) => {
    const found = new Map();
    let head = "";
    for (const panel of svg.querySelectorAll(".panel[data-x]")) {
      const [name, unit, ...scale] = panel.dataset.x.split("|");
      if (!head) head = name + " = " + text(value(scale, x)) + "\u2009" + unit;
      for (const line of panel.querySelectorAll("[data-name]")) {
        const point = nearest(line.points, x);
        const near = Math.abs(point.x - x);
        const old = found.get(line.dataset.name);
        if (near > 12 || (old && old.near <= near)) continue;
        const y = value(panel.dataset.y.split("|"), point.y);
        found.set(line.dataset.name, { near, text: text(y) + "\u2009" + line.dataset.unit });
      }
    }
    return [head, ...Array.from(found, ([name, item]) => name + " " + item.text)].join("  \u00b7  ");
  };
  for (const svg of document.querySelectorAll("svg.readable")) {
    const output = svg.closest("figure").querySelector("output");
    const panels = Array.from(svg.querySelectorAll(".panel[data-x]"));
    const scale = panels[0].dataset.x.split("|").slice(2).map(Number);
    const [start, end] = [scale[2], scale[3]];
    const bottom = Math.min(...panels.map((p) => Number(p.dataset.y.split("|")[2])));
    const top = Math.min(...panels.map((p) => Number(p.dataset.y.split("|")[3])));
    const lowest = Math.max(...panels.map((p) => Number(p.dataset.y.split("|")[2])), bottom);
    let cursor = null, at = (start + end) / 2;
    const show = (x) => {
      at = Math.min(Math.max(x, start), end);
      if (!cursor) {
        cursor = document.createElementNS(NS, "line");
        cursor.setAttribute("class", "cursor");
        cursor.setAttribute("y1", top);
        cursor.setAttribute("y2", lowest);
        svg.append(cursor);
      }
      cursor.setAttribute("x1", at);
      cursor.setAttribute("x2", at);
      output.textContent = read(svg, at);
    };
    const hide = () => {
      if (cursor) cursor.remove();
      cursor = null;
      output.textContent = "";
    };
    svg.addEventListener("pointermove", (event) => {
      const matrix = svg.getScreenCTM();
      if (matrix) show(new DOMPoint(event.clientX, event.clientY).matrixTransform(matrix.inverse()).x);
    });
    svg.addEventListener("pointerleave", () => { if (document.activeElement !== svg) hide(); });
    svg.addEventListener("focus", () => show(at));
    svg.addEventListener("blur", hide);
    svg.addEventListener("keydown", (event) => {
      const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
      if (step) {
        show(at + step * (event.shiftKey ? 20 : 2));
        event.preventDefault();
      } else if (event.key === "Home" || event.key === "End") {
        show(event.key === "Home" ? start : end);
        event.preventDefault();
      } else if (event.key === "Escape") {
        svg.blur();
      }
    });
  }
})();
