// The cost of every sample of a curve, worked out as the window matchers do: `matching/window/square.py` and
// `column.py`. Images are whole numbers, ABSENT where there is no pixel.

const ABSENT = -32768;

// Sums over a window, of pixels a of view 1 and b of view 2, and what is made of them.
class Window {
  constructor(size) {
    this.size = size;
    this.d = this.d2 = this.a = this.b = this.aa = this.bb = this.ab = 0;
  }

  add(a, b) {
    const d = Math.abs(a - b);
    this.d += d;
    this.d2 += d * d;
    this.a += a;
    this.b += b;
    this.aa += a * a;
    this.bb += b * b;
    this.ab += a * b;
  }

  cost(kind, step) {
    if (kind === "sad") return this.d * step;
    if (kind === "ssd") return this.d2 * step * step;
    const scale = Math.sqrt(this.spread(this.aa, this.a)) * Math.sqrt(this.spread(this.bb, this.b));
    return scale > 0 ? 1 - (this.size * this.ab - this.a * this.b) / scale : 1;
  }

  spread(squares, total) {
    return Math.max(this.size * squares - total * total, 0);
  }
}

class Costs {
  // Of all pixels of the panorama, whatever the other maps have.
  constructor(facts, maps) {
    const panorama = new Panorama(facts.grid);
    Object.assign(this, { panorama, settings: facts.cost, step: facts.steps.grey, t: facts.given.t });
    Object.assign(this, { first: maps.first, second: maps.second });
    this.half = (facts.cost.window - 1) / 2;
    this.signs = Array.from({ length: panorama.columns }, (_, j) =>
      Math.sign(new Curve(panorama, this.t, facts.cost, 0, j).step),
    );
  }

  // The costs of samples curve.first .. curve.last of a pixel; NaN where a window is not whole.
  along(curve, row, column) {
    const of = this.settings.kind === "column" ? (k) => this.columns(k, row, column) : (k) => this.square(k, row, column, curve);
    const costs = [];
    for (let k = curve.first; k <= curve.last; k++) costs.push(of(k));
    return costs;
  }

  // A square around the pixel that is nearest to the sample.
  square(k, row, column, curve) {
    const { rows, columns, zMax, zPitch, pitch } = this.panorama;
    const [phi, z] = curve.pointOf(k);
    const other = Math.floor((zMax - z) / zPitch);
    const there = modulo(Math.floor((phi + Math.PI) / pitch), columns);
    if (Math.min(row, other) < this.half || Math.max(row, other) >= rows - this.half) return NaN;
    const window = new Window((2 * this.half + 1) ** 2);
    for (let j = -this.half; j <= this.half; j++) {
      const [own, its] = [modulo(column + j, columns), modulo(there + j, columns)];
      for (let i = -this.half; i <= this.half; i++) {
        const [a, b] = [this.first[(row + i) * columns + own], this.second[(other + i) * columns + its]];
        if (a === ABSENT || b === ABSENT) return NaN;
        window.add(a, b);
      }
    }
    return window.cost(this.settings.cost, this.step);
  }

  // A square of which each column follows the epipolar map; rows of view 2 in parts of 2^-16, as the matcher has them.
  columns(k, row, column) {
    const { rows, columns, zMax, zPitch, pitch } = this.panorama;
    const [tx, ty, tz] = this.t;
    if (row < this.half || row >= rows - this.half) return NaN;
    const window = new Window((2 * this.half + 1) ** 2);
    for (let j = -this.half; j <= this.half; j++) {
      const own = modulo(column + j, columns);
      const u = Math.abs(wrapped(this.panorama.phi(own) - Math.atan2(ty, tx)));
      const w = k * pitch;
      const g = Math.sin(u + w) / Math.sin(u);
      const h = ((-tz / Math.hypot(tx, ty)) * Math.sin(w)) / Math.sin(u);
      const shift = ((1 - g) * zMax - h) / zPitch + (g - 1) / 2;
      if (!(u + w > 0 && u + w < Math.PI && g < rows && Math.abs(shift) < rows * rows)) return NaN;
      const [gain, offset] = [Math.round(g * 65536), Math.round(shift * 65536)];
      const its = modulo(own + this.signs[own] * k, columns);
      for (let i = row - this.half; i <= row + this.half; i++) {
        const a = this.first[i * columns + own];
        const b = this.between(offset + gain * i, its);
        if (a === ABSENT || b === ABSENT) return NaN;
        window.add(a, b);
      }
    }
    return window.cost(this.settings.cost, this.step);
  }

  between(position, column) {
    const { rows, columns } = this.panorama;
    const row = Math.floor(position / 65536);
    if (row < 0 || position > (rows - 1) * 65536) return ABSENT;
    const here = this.second[row * columns + column];
    const next = this.second[Math.min(row + 1, rows - 1) * columns + column];
    if (here === ABSENT || next === ABSENT) return ABSENT;
    const fraction = (position >>> 8) & 255;
    return here + (((next - here) * fraction + 128) >> 8);
  }
}
