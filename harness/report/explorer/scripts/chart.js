// The cost along the curve of the pixel, with what each method answered and the truth.

const CHART = { height: 300, left: 58, right: 14, top: 44, bottom: 44 };

class Chart {
  constructor(element, facts) {
    Object.assign(this, { element, facts, svg: element.querySelector("svg") });
  }

  // marks: {label, colour, k, chosen} of each method with an estimate; truth: a sample or null.
  draw(curve, costs, marks, truth) {
    const { height, left, right, top, bottom } = CHART;
    const width = Math.max(this.element.clientWidth, 260);
    this.svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
    const known = costs.filter((cost) => !Number.isNaN(cost));
    const parts = [];
    const text = (x, y, words, anchor, more = "") =>
      parts.push(`<text x="${short(x)}" y="${short(y)}" text-anchor="${anchor}"${more}>${words}</text>`);
    const line = (name, x1, y1, x2, y2, style = "") =>
      parts.push(`<path class="${name}"${style} d="M${short(x1)},${short(y1)}L${short(x2)},${short(y2)}"/>`);
    if (!known.length) {
      text(width / 2, height / 2, "No window on this curve is whole: nothing to compare.", "middle");
      this.svg.innerHTML = parts.join("");
      return;
    }
    const inside = (k) => k >= curve.first - 2 && k <= curve.last + 2;
    const all = [...marks.map((mark) => mark.k), truth].filter((k) => k !== null && inside(k));
    const [low, high] = [Math.min(curve.first, ...all) - 0.5, Math.max(curve.last, ...all) + 0.5];
    const most = Math.max(...known) * 1.06 || 1;
    const x = (k) => left + ((k - low) / (high - low)) * (width - left - right);
    const y = (cost) => height - bottom - (cost / most) * (height - top - bottom);
    this.axes({ curve, low, high, most, x, y, width, text, line });
    for (const { colour, k, chosen } of marks) {
      if (inside(k)) line(chosen ? "estimate chosen" : "estimate", x(k), top, x(k), height - bottom, ` style="stroke:${colour}"`);
    }
    if (truth !== null && inside(truth)) line("truth", x(truth), top, x(truth), height - bottom);
    const points = costs.map((cost, i) => (Number.isNaN(cost) ? null : [x(curve.first + i), y(cost)]));
    parts.push(`<path class="costs" d="${pathOf(points)}"/>`);
    parts.push(`<path class="samples" d="${points.filter(Boolean).map((point) => `M${point.map(short)}h0`).join("")}"/>`);
    this.svg.innerHTML = parts.join("");
  }

  axes({ curve, low, high, most, x, y, width, text, line }) {
    const { height, left, right, top, bottom } = CHART;
    line("axis", left, height - bottom, width - right, height - bottom);
    line("axis", left, top, left, height - bottom);
    line("axis", left, top, width - right, top);
    for (const cost of ticks(0, most, 4)) {
      line("grid", left, y(cost), width - right, y(cost));
      text(left - 6, y(cost) + 4, `${Number(cost.toPrecision(3))}`, "end");
    }
    const angle = (k) => degrees(curve.start + k * curve.step);
    const ends = [angle(low), angle(high)];
    for (const value of ticks(Math.min(...ends), Math.max(...ends), Math.min(7, width / 75))) {
      const k = (value - angle(0)) / degrees(curve.step);
      line("axis", x(k), height - bottom, x(k), height - bottom + 4);
      text(x(k), height - bottom + 17, fixed(degrees(wrapped((value * Math.PI) / 180)), value % 1 ? 1 : 0), "middle");
    }
    let free = -Infinity;
    for (const range of [0.1, 0.2, 0.3, 0.5, 0.7, 1, 1.2, 1.5, 2, 2.5, 3, 4, 5, 7, 10, 15, 20, 30, 50, 100].reverse()) {
      const k = curve.sampleOf(curve.alphaOfRange(range));
      if (!(k >= low && k <= high) || x(k) < free) continue;
      line("axis", x(k), top, x(k), top - 4);
      text(x(k), top - 8, `${range}`, "middle");
      free = x(k) + 34;
    }
    const { cost, window, unit } = this.facts.cost;
    const symbol = curve.byPhi ? "φ" : "α";
    text(left + (width - left - right) / 2, 13, "range (m)", "middle");
    text(left + (width - left - right) / 2, height - 6, `${symbol}₂ (°)`, "middle");
    const middle = (top + height - bottom) / 2;
    const words = `${cost.toUpperCase()}, ${window} × ${window} px (${unit})`;
    text(13, middle, words, "middle", ` transform="rotate(-90 13 ${middle})"`);
  }
}

// Round numbers between two others, about so many.
function ticks(low, high, count) {
  const rough = (high - low) / count;
  const size = 10 ** Math.floor(Math.log10(rough));
  const step = size * [1, 2, 5, 10].find((each) => each * size >= rough);
  const first = Math.ceil(low / step - 1e-9);
  return Array.from({ length: Math.floor(high / step + 1e-9) - first + 1 }, (_, i) => (first + i) * step);
}
